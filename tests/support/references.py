"""References for trackers: of built-in plans, and apart from any plan."""

from functools import cache

import numpy as np

from linkplan.controllers.reference import SampledReference, sample
from linkplan.models.mechanism import Mechanism
from tests.support.motions import motion_along
from tests.support.plans import optimal

# A control period [s].
PERIOD = 1e-3


@cache
def reference_of(name: str, period_s: float = PERIOD, duration_s: float | None = None) -> SampledReference:
    """Return the reference that a built-in problem's plan gives its trackers."""
    plan = optimal(name)
    duration = plan.trajectory.duration_s if duration_s is None else duration_s
    return sample(plan.problem.mechanism, plan.trajectory, period_s, duration)


def hinge_reference(mechanism: Mechanism, n: int = 50) -> SampledReference:
    """Return a hinge's reference that stays at zero for n periods of a hundredth of a second."""
    return sample(mechanism, motion_along([0.0, 1.0], [0.0, 0.0]), 0.01, 0.01 * n)


def cubic_reference(mechanism: Mechanism, by: np.ndarray, period_s: float, duration_s: float) -> SampledReference:
    """Return the reference that goes from home by (n_s,) [rad or m] and comes to rest, a cubic in time."""
    home = mechanism.home[mechanism.independent]
    position, effort = home + np.array([[0 * by], [0 * by], [by], [by]]), np.zeros((2, 1, mechanism.n_u))
    path = motion_along([0.0, duration_s], position, effort=effort, start_pose=mechanism.home)
    return sample(mechanism, path, period_s, duration_s)
