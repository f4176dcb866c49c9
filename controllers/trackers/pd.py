"""PD in the independent joints."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.linear import times
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

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return efforts (..., n_u) [N.m or N] for states (..., n_s)."""
        reference = self.reference
        error = self.kp * (reference.position[k] - position) + self.kd * (reference.velocity[k] - velocity)
        return times(self.map[k], error)


def pd(mechanism: Mechanism, reference: SampledReference, kp: float | np.ndarray, kd: float | np.ndarray) -> PD:
    """Return the PD tracker of a reference."""
    maps = np.linalg.pinv(sampled(mechanism.dynamics.effort_map, reference.pose))
    return PD(reference=reference, kp=kp, kd=kd, map=maps)
