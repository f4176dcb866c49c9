"""A mechanism as a system for the transcription: closure and reduced dynamics at a node, all scaled.

Second-order coordinates are the independent joints, algebraic unknowns the dependent ones (lifted: tied by phi(s, z) = 0).
Equations: phi(q) / length and (inverse_dynamics(q, v, a) - Gamma^T B u) / scale. Path quantities: speeds of dependent
joints.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from models.mechanism import Mechanism
from planner.system import System, node_symbols


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Scales:
    """Units in which the unknowns are of order one.

    `time_s` [s], `position` (n_s,) [rad or m], `effort` (n_u,) and `residual` (n_s,), the generalised effort's, [N.m or N],
    `length_m` the closure's [m].
    """

    time_s: float
    position: np.ndarray
    effort: np.ndarray
    residual: np.ndarray
    length_m: float

    def vector(self) -> np.ndarray:
        """Return the scales as parameters of a node."""
        return np.concatenate([[self.time_s], self.position, self.effort, self.residual, [self.length_m]])


def mechanism_system(mechanism: Mechanism, tracking: bool, speed_joints: tuple[int, ...]) -> System:
    """Return a mechanism's system.

    Args:
        mechanism: whose closure and reduced dynamics are to hold.
        tracking: whether the running cost is the squared distance from a reference (else there is none).
        speed_joints: dependent joints whose speeds [rad/s or m/s] are path quantities.

    A node's parameters are the reference (n_s,), scaled, and the scales.
    """
    n_s, n_z, n_u = mechanism.dof, mechanism.n_q - mechanism.dof, mechanism.n_u
    node = node_symbols(n_s, 0, n_z, n_u)
    reference = ca.SX.sym("reference", n_s)
    scale_names = {"time": 1, "position": n_s, "effort": n_u, "residual": n_s, "length": 1}
    scale = {name: ca.SX.sym(name, size) for name, size in scale_names.items()}
    rate = scale["position"] / scale["time"]
    order = np.argsort(np.concatenate([mechanism.independent, mechanism.dependent]))
    stacked = ca.vertcat(node.s * scale["position"], node.z)
    q = stacked[[int(i) for i in order]]
    v, a, u = node.v * rate, node.a * rate / scale["time"], node.u * scale["effort"]
    dynamics = mechanism.dynamics
    equations = ca.vertcat(
        dynamics.independent_closure(q) / scale["length"], dynamics.residual(q, v, a, u) / scale["residual"]
    )
    path = ca.vertcat(ca.SX(0, 1), *[dynamics.velocity_map(q)[joint, :] @ v for joint in speed_joints])
    share_of = (scale["position"] / ca.mmax(scale["position"])) ** 2
    running = ca.dot(share_of, (node.s - reference) ** 2) if tracking else ca.SX(0)
    theta = ca.vertcat(reference, *scale.values())
    column = ca.densify(ca.vertcat(equations, path, running))
    return System(
        n_s=n_s,
        n_x=0,
        n_z=n_z,
        n_u=n_u,
        node=ca.Function("node", [node.stacked, theta], [column]),
        n_equations=equations.numel(),
        n_path=path.numel(),
        kinds=("closure",) * n_z + ("dynamics",) * n_s + ("speed",) * path.numel(),
    )
