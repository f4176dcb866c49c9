"""Quantities of a linkage seen at its output joints: transmission, reflected inertia, losses, motor positions.

    l' = G(s) v,   tau = G^T u,   tau v = u l'      (power balance)

l (n_m,) are the motors' positions (MuJoCo's actuator lengths: gear times joint position), s and v = s' (n_o,) the output
joints' positions and velocities, u the motors' efforts and tau the efforts on the output joints. With the output joints as
independent coordinates G^T = Gamma^T B, see `models.reduction.reduced`. Other independent coordinates rest at home.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.errors import ModelError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled, sliding_friction
from linkplan.models.tree.joints import Joint
from linkplan.models.tree.passive import joint_armature

# A motor whose rate is below this share of the largest moves with other joints only.
_ZERO_RATE_SHARE = 1e-12


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OutputMap:
    """Output joints of a mechanism whose independent coordinates they are, and the motors that move with them.

    `columns` (n_o,) are the outputs' places among the independent coordinates, `motors` (n_m,) indices of actuators.
    """

    mechanism: Mechanism
    columns: tuple[int, ...]
    motors: tuple[int, ...]

    @property
    def joints(self) -> tuple[Joint, ...]:
        """The output joints, in the order asked for."""
        return tuple(self.mechanism.independent_joints[column] for column in self.columns)

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """The motors that move with the output joints."""
        return tuple(self.mechanism.actuators[motor] for motor in self.motors)

    @property
    def effort_limit(self) -> np.ndarray:
        """The motors' effort limits (n_m, 2) [N.m or N]."""
        return self.mechanism.effort_limit[list(self.motors)]

    @property
    def coordinates(self) -> np.ndarray:
        """The outputs' places (n_o,) among all coordinates q."""
        return self.mechanism.independent[list(self.columns)]

    @property
    def home(self) -> np.ndarray:
        """The outputs' positions (n_o,) at home [rad or m]."""
        return self.mechanism.home[self.coordinates]

    def independent(self, s: np.ndarray) -> np.ndarray:
        """Return all independent positions (n, n_s) for the outputs' positions s (n, n_o), the others at home."""
        whole = np.tile(self.mechanism.home[self.mechanism.independent], (len(s), 1))
        whole[:, list(self.columns)] = s
        return whole


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Transmission:
    """A linkage at poses (n,); units by a motor's and a joint's kind, "rad" and "N.m" or "m" and "N".

    `motor_position` (n, n_m) is NaN for a motor on a site or slider-crank, which has no position. `ratio` is G (n, n_m,
    n_o), `ratio_slope` dG/ds (n, n_m, n_o, n_o): G' = dG/ds v, summed over its last axis. `inertia` (n, n_o, n_o) is all
    that the outputs move, `armature` the part of rotors and other joint armatures, `damping` (n, n_o, n_o) the viscous
    losses. `friction` (n, n_o) is dry friction while one output slides alone, `gravity` (n, n_o) the effort that balances
    gravity, `hold` (n, n_o) the effort at rest: gravity, springs and constant forces.
    """

    motor_position: np.ndarray
    ratio: np.ndarray
    ratio_slope: np.ndarray
    inertia: np.ndarray
    armature: np.ndarray
    damping: np.ndarray
    friction: np.ndarray
    gravity: np.ndarray
    hold: np.ndarray


def output_map(mechanism: Mechanism, names: Sequence[str]) -> OutputMap:
    """Return the map of output joints, which are among the mechanism's independent coordinates.

    Raises:
        ModelError: if a joint is not independent, or no motor moves with the joints.
    """
    at = {joint.name: column for column, joint in enumerate(mechanism.independent_joints)}
    for name in names:
        mechanism.joint_index(name)
        if name not in at:
            raise ModelError(f"output joint '{name}' is not an independent coordinate; those are {', '.join(at)}")
    columns = [at[name] for name in names]
    depends = np.array(ca.DM(mechanism.dynamics.effort_map.jac_sparsity(0, 0), 1.0)) != 0
    ratio = np.array(mechanism.dynamics.effort_map(mechanism.home))[columns]  # (n_o, n_u)
    moved = np.abs(ratio) > _ZERO_RATE_SHARE * np.abs(ratio).max(initial=0.0)
    # At a dead centre the rate is zero, but it depends on the pose.
    varies = depends.any(axis=1).reshape(mechanism.n_u, mechanism.dof).T[columns]
    motors = np.flatnonzero((moved | varies).any(axis=0))
    if len(motors) == 0:
        raise ModelError(
            f"no motor of mechanism '{mechanism.name}' moves with {', '.join(names)}: there is nothing to transfer"
        )
    return OutputMap(mechanism=mechanism, columns=tuple(columns), motors=tuple(motors.tolist()))


@functools.lru_cache(maxsize=16)
def _slopes(outputs: OutputMap) -> tuple[ca.Function, ca.Function]:
    """Return the functions q -> dG/ds, flattened (n_m n_o, n_o) by columns of G, and q -> damping (n_q, n_q) of q'."""
    dynamics, columns = outputs.mechanism.dynamics, list(outputs.columns)
    q, qd = ca.SX.sym("q", outputs.mechanism.n_q), ca.SX.sym("qd", outputs.mechanism.n_q)
    ratio = dynamics.effort_map(q).T[list(outputs.motors), columns]
    gamma = dynamics.velocity_map(q)[:, columns]
    slope = ca.jacobian(ca.vec(ratio), q) @ gamma
    loss = ca.substitute(-ca.jacobian(dynamics.passive(q, qd), qd), qd, ca.SX.zeros(qd.shape))
    return ca.Function("ratio_slope", [q], [ca.densify(slope)]), ca.Function("damping", [q], [ca.densify(loss)])


def motor_map(outputs: OutputMap, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the motors' positions (n, n_m) and G (n, n_m, n_o) at closed poses q (n, n_q)."""
    dynamics, motors = outputs.mechanism.dynamics, list(outputs.motors)
    ratio = sampled(dynamics.effort_map, q)[:, list(outputs.columns)][:, :, motors].transpose(0, 2, 1)
    return sampled(dynamics.actuator_length, q)[:, motors, 0], ratio


def transmission(outputs: OutputMap, q: np.ndarray) -> Transmission:
    """Return the linkage's quantities at closed poses q (n, n_q)."""
    mechanism, columns, (motor_position, ratio) = outputs.mechanism, list(outputs.columns), motor_map(outputs, q)
    dynamics, (n, n_m, n_o) = mechanism.dynamics, ratio.shape
    slope, loss = _slopes(outputs)
    gamma = sampled(dynamics.velocity_map, q)[:, :, columns]
    speeds = np.stack([mechanism.qvel_of(q, gamma[:, :, k]) for k in range(n_o)], axis=-1)  # (n, nv, n_o)
    still = np.zeros((n, mechanism.dof))
    block = (slice(None), *np.ix_(columns, columns))
    return Transmission(
        motor_position=motor_position,
        ratio=ratio,
        ratio_slope=sampled(slope, q).reshape(n, n_o, n_m, n_o).transpose(0, 2, 1, 3),
        inertia=sampled(dynamics.reduced_inertia, q)[block],
        armature=np.einsum("nvi,v,nvj->nij", speeds, np.array(joint_armature(mechanism.model)).ravel(), speeds),
        damping=np.einsum("nqi,nqp,npj->nij", gamma, sampled(loss, q), gamma),
        friction=np.stack([sliding_friction(mechanism, q, column) for column in columns], axis=1),
        gravity=sampled(dynamics.gravity_effort, q)[:, columns, 0],
        hold=sampled(dynamics.inverse_dynamics, q, still, still)[:, columns, 0],
    )
