"""What machines at the corners of a problem's ranges need for a motion, as an expression and along samples."""

import functools
from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.planner.problem.robust import Corner


def corner_efforts(
    mechanism: Mechanism, corners: Sequence[Corner], call: Callable[..., ca.SX], payload: ca.SX, motion: tuple[ca.SX, ...]
) -> list[ca.SX]:
    """Return the efforts (n_u,) of each corner that a motion (q, v, a) needs.

    Where there are more actuators than degrees of freedom, many efforts make one motion: a corner has the plan's own and the
    least ones that make up for the difference, u_c = u + (Gamma^T B)^+ (tau_c / k - Gamma^T B u).

    Args:
        mechanism: whose actuators move every degree of freedom.
        corners: of the ranges.
        call: a function of the reduced dynamics by name, of the machine as modelled.
        payload: its numbers (7,), none without one.
        motion: q (n_q,), v and a (n_s,), and the plan's efforts u (n_u,).
    """
    q, v, a, u = motion
    gamma, effort_map = call("velocity_map", q), call("effort_map", q)
    rates = gamma @ v
    needed: dict[float, ca.SX] = {}
    found = []
    for corner in corners:
        factor = corner.payload_factor
        if factor not in needed:
            if factor == 1:
                needed[factor] = call("inverse_dynamics", q, v, a)
            else:
                scaled = ca.vertcat(factor * payload[0], payload[1:4], factor * payload[4:7])
                needed[factor] = mechanism.parametric_dynamics().inverse_dynamics(q, v, a, scaled)
        tau = needed[factor]
        for joint, viscous, coulomb in corner.friction:
            tau = tau + gamma[joint, :].T * (viscous * rates[joint] + coulomb)
        if mechanism.n_u == mechanism.dof:
            found.append(ca.solve(effort_map, tau) / corner.torque_factor)
        else:
            found.append(u + ca.pinv(effort_map) @ (tau / corner.torque_factor - effort_map @ u))
    return found


def corner_efforts_along(mechanism: Mechanism, corners: tuple[Corner, ...], q, v, a, u) -> np.ndarray:
    """Return each corner's efforts (n, n_corners, n_u) [N.m or N] along samples q (n, n_q), v, a (n, n_s), u (n, n_u)."""
    found = sampled(_function(mechanism, corners), q, v, a, u)
    return found.reshape(len(q), len(corners), mechanism.n_u)


@functools.lru_cache(maxsize=16)
def _function(mechanism: Mechanism, corners: tuple[Corner, ...]) -> ca.Function:
    sizes = {"q": mechanism.n_q, "v": mechanism.dof, "a": mechanism.dof, "u": mechanism.n_u}
    motion = tuple(ca.SX.sym(name, size) for name, size in sizes.items())
    payload = ca.SX(0, 1) if mechanism.payload is None else ca.SX(mechanism.payload.numbers())
    efforts = corner_efforts(mechanism, corners, lambda name, *x: getattr(mechanism.dynamics, name)(*x), payload, motion)
    return ca.Function("corners", list(motion), [ca.densify(ca.vertcat(*efforts))])
