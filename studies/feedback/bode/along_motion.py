"""The study of `linkplan bode --along`: the frozen feedback loop along a plan, and Floquet multipliers if periodic."""

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from msgspec.structs import asdict

from linkplan.controllers.reference import SampledReference, sample
from linkplan.controllers.sampling import Sampling, sampling
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.settings import Tracking
from linkplan.planner.search.planning import silent
from linkplan.studies.compare.compare import build_tracker
from linkplan.studies.feedback.bode.bode_result import AlongMotion, FrozenMargins
from linkplan.studies.feedback.bode.scan import stability
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop, OperatingPoint, feedback_loop
from linkplan.studies.feedback.frequency.floquet import floquet, frozen_radii, linear_law
from linkplan.studies.feedback.frequency.margins import Margins, margins
from linkplan.studies.feedback.frequency.worst import refined_minima


def along_motion(plan: Plan, law: str, settings: Tracking, say: Callable[[str], None] = silent) -> AlongMotion:
    """Return a tracker's loop along a plan; `settings` replace the plan's gains."""
    plan = replace(plan, problem=plan.problem.varied(tracking=settings))
    mechanism, trajectory = plan.problem.mechanism, plan.require_motion("analyse")
    limit = plan.problem.limits.actuators_effort
    reference = sample(mechanism, trajectory, settings.period_s, trajectory.duration_s, limit)
    tracker = build_tracker(law, plan, reference)
    timing = sampling(mechanism, settings.period_s, settings.delay_periods)
    gains = linear_law(tracker).gains
    say(f"{law} frozen along {plan.problem.name}: {reference.n} control instants")
    radius = frozen_radii(mechanism, reference, gains, timing)
    instants = np.unique(np.linspace(0, reference.n - 1, 25).astype(int))

    @functools.cache
    def worst(k: int) -> tuple[Margins, int]:
        loop = frozen_loop(mechanism, reference, gains, timing, k)
        every = [(margins(loop, channel, refine=False), channel) for channel in mechanism.channels]
        return min(every, key=lambda one: stability(one[0]))

    between = [round(k) for k in refined_minima(lambda k: stability(worst(round(k))[0]), instants)]
    joints, frozen = mechanism.independent_joints, []
    for k in np.unique([*instants, *between]):
        bounds, channel = worst(k)
        frozen.append(FrozenMargins(**asdict(bounds), time_s=float(reference.time_s[k]), joint=joints[channel].name))
    cycle = None
    if reference.cycle is not None:
        say("Floquet multipliers, predicted and measured")
        cycle = floquet(mechanism, reference, tracker, timing, limit)
    return AlongMotion(
        plan=plan.problem.name,
        tracker=law,
        frozen=tuple(frozen),
        largest_frozen_pole=float(radius.max()),
        floquet=cycle,
        n_loops=len(joints),
    )


def frozen_loop(mechanism, reference: SampledReference, gains: np.ndarray, timing: Sampling, k: int) -> FeedbackLoop:
    """Return the loop frozen at instant k: its gain and the motion's state are kept constant."""
    point = OperatingPoint(
        mechanism=mechanism,
        pose=reference.pose_rad[k],
        velocity=reference.velocity_rad_s[k],
        hold=reference.effort[k],
        told=tuple(mechanism.channels),
        forces=tuple(w[k, None] for w in reference.forces),
    )
    return feedback_loop(point, gains[k], timing)
