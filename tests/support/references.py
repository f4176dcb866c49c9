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
