"""Computed torque: inverse dynamics at the measured state, with a reference acceleration corrected by the errors.

    u = u_ref + R^+ (tau - R u_ref),   R = Gamma^T B,   tau = M_r (a_ref + 2 zeta w (v_ref - v) + w^2 (s_ref - s)) + b_r

More actuators than freedoms produce tau by the efforts nearest to the reference's. For the nominal mechanism the errors
obey e'' + 2 zeta w e' + w^2 e = 0 at all poses (Featherstone, Rigid Body Dynamics Algorithms, 2008, 1.5; Siciliano et al.,
Robotics, 2009, 8.5.2).
"""

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.tracker import Design
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import evaluated, mapped, sampled
from linkplan.models.reduction.closing import MAX_LOOP_GAP_M, closed_near


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ComputedTorque:
    """u = u_ref + R^+ (tau(s, v, a_ref + damping (v_ref - v) + stiffness (s_ref - s)) - R u_ref).

    `acceleration` (n, n_s): produced by the reference's own efforts. `stiffness`: w^2 [1/s^2]. `damping`: 2 zeta w [1/s].
    `law`: function (near pose, s, v, a, u_ref, forces over time) -> efforts, loop gap [m].
    """

    reference: SampledReference
    acceleration: np.ndarray
    stiffness: float
    damping: float
    law: ca.Function
    name: str = "ct"
    batched: ClassVar[bool] = True

    def effort(self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray) -> np.ndarray:
        """Return efforts (..., n_u) [N.m or N] for s and v (..., n_s)."""
        reference = self.reference
        acceleration = self.acceleration[k] + self.damping * (reference.velocity_rad_s[k] - velocity_rad_s)
        acceleration += self.stiffness * (reference.position_rad[k] - position_rad)
        s, v, a = (np.atleast_2d(x) for x in (position_rad, velocity_rad_s, acceleration))
        near = np.broadcast_to(reference.pose_rad[k], (len(s), reference.pose_rad.shape[1]))
        given = [np.broadcast_to(w[k], (len(s), w.shape[1])) for w in (reference.effort, *reference.forces)]
        effort, gap = self._called(near, s, v, a, *given)
        far = ~(gap <= MAX_LOOP_GAP_M)
        if np.any(far):
            there = np.broadcast_to(reference.position_rad[k], s.shape)
            effort[far] = self._called(near[far], there[far], v[far], a[far], *(w[far] for w in given))[0]
        return effort.reshape(*np.shape(position_rad)[:-1], -1)

    def _called(self, *arguments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        effort, gap = evaluated(mapped(self.law, len(arguments[0])), *(x.T for x in arguments))
        return effort.T, gap.ravel()


def computed_torque(design: Design) -> ComputedTorque:
    """Return the computed torque of a design."""
    mechanism, reference, (natural_frequency, damping_ratio) = design.mechanism, design.reference, design.of_errors
    return ComputedTorque(
        reference=reference,
        acceleration=sampled(mechanism.forced.acceleration, *reference.states)[:, :, 0],
        stiffness=natural_frequency**2,
        damping=2 * damping_ratio * natural_frequency,
        law=_law(mechanism),
    )


def _law(mechanism: Mechanism) -> ca.Function:
    """Return the function (near pose, s, v, a, u_ref, forces over time) -> efforts (n_u,), loop gap [m]."""
    dynamics, n_s = mechanism.dynamics, mechanism.dof
    forces = [] if mechanism.forces is None else [ca.MX.sym("forces", 3 * len(mechanism.forces.sites))]
    near, u = ca.MX.sym("near", mechanism.n_q), ca.MX.sym("u", mechanism.n_u)
    s, v, a = (ca.MX.sym(name, n_s) for name in "sva")
    q, gap = closed_near(dynamics, near, s)
    R = dynamics.effort_map(q)
    effort = u + ca.pinv(R) @ (mechanism.forced.inverse_dynamics(q, v, a, *forces) - R @ u)
    return ca.Function("computed_torque", [near, s, v, a, u, *forces], [effort, gap])
