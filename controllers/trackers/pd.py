"""PD in the independent joints, and gain-scheduled PD.

Gains proportional to the reduced inertia give the same bandwidth and damping ratio at every pose.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.tracker import times
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PD:
    """u = (Gamma^T B)^+ [kp (s_ref - s) + kd (v_ref - v)].

    kp [N.m/rad or N/m] and kd [N.m.s/rad or N.s/m], one for all or one for each (n_s,), act on the independent joints. `map`
    (n, n_u, n_s) converts joint efforts to actuator efforts along the reference.
    """

    reference: SampledReference
    kp: float | np.ndarray
    kd: float | np.ndarray
    map: np.ndarray
    name: str = "pd"
    batched: ClassVar[bool] = True

    def effort(self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray) -> np.ndarray:
        """Return efforts (..., n_u) [N.m or N] for states (..., n_s)."""
        reference = self.reference
        error = self.kp * (reference.position_rad[k] - position_rad) + self.kd * (
            reference.velocity_rad_s[k] - velocity_rad_s
        )
        return times(self.map[k], error)


def pd(mechanism: Mechanism, reference: SampledReference, kp: float | np.ndarray, kd: float | np.ndarray) -> PD:
    """Return the PD tracker of a reference."""
    maps = np.linalg.pinv(sampled(mechanism.dynamics.effort_map, reference.pose_rad))
    return PD(reference=reference, kp=kp, kd=kd, map=maps)


def scheduled_pd(mechanism: Mechanism, reference: SampledReference, natural_frequency: float, damping_ratio: float) -> PD:
    """Return PD with gains M_r w^2 and 2 zeta w M_r along a reference, M_r the reduced inertia of its pose.

    Args:
        mechanism: the mechanism.
        reference: the sampled motion.
        natural_frequency: w [rad/s].
        damping_ratio: zeta.
    """
    maps = np.linalg.pinv(sampled(mechanism.dynamics.effort_map, reference.pose_rad))
    inertia = sampled(mechanism.dynamics.reduced_inertia, reference.pose_rad)
    return PD(
        reference=reference,
        kp=natural_frequency**2,
        kd=2 * damping_ratio * natural_frequency,
        map=maps @ inertia,
        name="gs-pd",
    )
