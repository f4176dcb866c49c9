"""Gain-scheduled PD: gains proportional to the reduced inertia give the same bandwidth and damping ratio at every pose."""

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.pd import PD
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled


def scheduled_pd(mechanism: Mechanism, reference: SampledReference, natural_frequency: float, damping_ratio: float) -> PD:
    """Return PD with gains M_r w^2 and 2 zeta w M_r along a reference, M_r the reduced inertia of its pose.

    Args:
        mechanism: the mechanism.
        reference: the sampled motion.
        natural_frequency: w [rad/s].
        damping_ratio: zeta.
    """
    maps = np.linalg.pinv(sampled(mechanism.dynamics.effort_map, reference.pose))
    inertia = sampled(mechanism.dynamics.reduced_inertia, reference.pose)
    return PD(
        reference=reference,
        kp=natural_frequency**2,
        kd=2 * damping_ratio * natural_frequency,
        map=maps @ inertia,
        name="gs-pd",
    )
