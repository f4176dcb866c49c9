"""References for trackers that stand apart from any plan."""

import numpy as np

from linkplan.controllers.reference import SampledReference, sample
from linkplan.models.mechanism import Mechanism
from linkplan.planner.trajectory import Trajectory


def hinge_reference(mechanism: Mechanism, n: int = 50) -> SampledReference:
    """Return a hinge's reference that stays at zero for n periods of a hundredth of a second."""
    zeros = np.zeros((2, 1, 1))
    rest = Trajectory(
        breaks_s=np.array([0.0, 1.0]), position=zeros, velocity=zeros, effort=zeros, start_pose=np.zeros(1), periodic=False
    )
    return sample(mechanism, rest, 0.01, 0.01 * n)


def cubic_reference(mechanism: Mechanism, by: np.ndarray, period_s: float, duration_s: float) -> SampledReference:
    """Return the reference that goes from home by (n_s,) [rad or m] and comes to rest, a cubic in time."""
    home = mechanism.home[mechanism.independent]
    path = Trajectory(
        breaks_s=np.array([0.0, duration_s]),
        position=home + np.array([[0 * by], [0 * by], [by], [by]]),
        velocity=3 / duration_s * np.array([[0 * by], [by], [0 * by]]),
        effort=np.zeros((2, 1, mechanism.n_u)),
        start_pose=mechanism.home,
        periodic=False,
    )
    return sample(mechanism, path, period_s, duration_s)
