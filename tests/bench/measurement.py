"""What measuring a frequency response costs, beside raw batch stepping."""

import numpy as np
from mujoco.batch import Batch

from linkplan.controllers.sampling import sampling
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.frequency.feedback_loops import feedback_loop, law_gain, operating_point
from linkplan.studies.feedback.frequency.sinestream import measure
from linkplan.studies.output.text import table
from tests.bench.timing import median_s


def bench_measurement() -> str:
    """Return the simulated steps a second of a frequency response's measurement beside raw batch stepping of as many."""
    mechanism = load_mechanism("optimus-knee", payload="shank")
    settings = Tracking(kp=200.0, kd=20.0)
    timing = sampling(mechanism, settings.period_s)
    points = [operating_point(mechanism, np.radians([angle])) for angle in (-20.0, 20.0)]
    limit = mechanism.effort_limit
    loops = [feedback_loop(point, law_gain(point, "pd", settings, limit), timing) for point in points]
    frequency, n = np.geomspace(20.0, 2000.0, 20), 120
    taken = measure(loops, frequency, limit)
    spent = median_s(lambda: measure(loops, frequency, limit), 2)
    batch = Batch(mechanism.model, nsim=n)
    calls = max(1, taken.simulated_steps // n)
    raw = median_s(lambda: [batch.step() for _ in range(calls)], 2)
    rate, most = taken.simulated_steps / spent, n * calls / raw
    row = [f"sinestream, {n} simulations", taken.simulated_steps, rate, most, rate / most]
    return table(["measurement", "steps", "steps/s", "raw batch steps/s", "ratio"], [row])
