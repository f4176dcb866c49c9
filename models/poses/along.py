"""Quantities of a mechanism along a motion, sampled: poses q (n, n_q), velocities v and accelerations a (n, n_s).

They include the angles of ball joints with a range, the inertia that MuJoCo's own simulation, with its soft loops, lets a
force on a coordinate accelerate, and the ctrl that planned efforts need, which a servo's ctrlrange must contain.
"""

import functools

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.actuation.actuators import ranged_control
from linkplan.models.actuation.distribution import LEAST_SQUARES, ZERO_ARM_SHARE, distribute
from linkplan.models.compiled.functions import evaluated, mapped
from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.friction import frictions_of

# Violations of a joint's range below this are rounding of the assembly [rad or m].
RANGE_ROUNDING = 1e-8
# Functions with more values are evaluated sample by sample: CasADi lists the indices of all values of a mapped function.
MAX_MAPPED = 4096


def sampled(function: ca.Function, *arguments: np.ndarray) -> np.ndarray:
    """Return a function's first output over samples: arguments (n, k), result (n, rows, columns)."""
    n = len(arguments[0])
    if n == 0:
        return np.empty((0, *function.size_out(0)))
    shape = function.size_out(0)
    if np.prod(shape) > MAX_MAPPED:
        return np.stack([evaluated(function, *one, outputs=1)[0] for one in zip(*arguments, strict=True)])
    (stacked,) = evaluated(mapped(function, n), *[a.T for a in arguments], outputs=1)
    return stacked.reshape(shape[0], n, shape[1]).transpose(1, 0, 2)


def joint_rates(mechanism: Mechanism, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return every joint's speed q' = Gamma v (n, n_q)."""
    return sampled(_joint_rate(mechanism), q, v)[:, :, 0]


def accelerations(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return every joint's acceleration q'' = Gamma a + Gamma' v (n, n_q)."""
    return sampled(joint_acceleration(mechanism), q, v, a)[:, :, 0]


def jerks(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, a: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Return every joint's jerk (n, n_q), from those of the independent joints j (n, n_s)."""
    return sampled(joint_jerk(mechanism), q, v, a, j)[:, :, 0]


@functools.lru_cache(maxsize=16)
def _joint_rate(mechanism: Mechanism) -> ca.Function:
    """Return the function from q and v to every joint's speed (n_q,)."""
    q, v = ca.SX.sym("q", mechanism.n_q), ca.SX.sym("v", mechanism.dof)
    return ca.Function("rate", [q, v], [ca.densify(mechanism.dynamics.velocity_map(q) @ v)])


@functools.lru_cache(maxsize=16)
def joint_acceleration(mechanism: Mechanism) -> ca.Function:
    """Return the function from q, v and a to every joint's acceleration (n_q,)."""
    q, v, a = (ca.SX.sym(name, n) for name, n in (("q", mechanism.n_q), ("v", mechanism.dof), ("a", mechanism.dof)))
    gamma = mechanism.dynamics.velocity_map(q)
    rates = gamma @ v
    return ca.Function("acceleration", [q, v, a], [ca.densify(gamma @ a + ca.jtimes(rates, q, rates))])


@functools.lru_cache(maxsize=16)
def joint_jerk(mechanism: Mechanism) -> ca.Function:
    """Return the function from q, v, a and the independent joints' jerk j to every joint's jerk (n_q,).

    It is the derivative of the accelerations in the direction (Gamma v, a, j).
    """
    q, v, a, j = (ca.SX.sym(name, n) for name, n in zip("qvaj", (mechanism.n_q, *[mechanism.dof] * 3), strict=True))
    value = joint_acceleration(mechanism)(q, v, a)
    slope = ca.jtimes(value, ca.vertcat(q, v, a), ca.vertcat(mechanism.dynamics.velocity_map(q) @ v, a, j))
    return ca.Function("jerk", [q, v, a, j], [ca.densify(slope)])


@functools.lru_cache(maxsize=16)
def site_derivative(mechanism: Mechanism, order: int) -> ca.Function:
    """Return the function from q and its derivatives by time up to an order, each (n_q,), to that of all sites (3, n_sites).

    The sites' velocities have the order 1, their accelerations 2, their jerks 3.
    """
    of_joints = [ca.SX.sym(f"q{k}", mechanism.n_q) for k in range(order + 1)]
    value = ca.vec(mechanism.dynamics.site_places(of_joints[0]))
    for k in range(order):
        value = ca.jtimes(value, ca.vertcat(*of_joints[: k + 1]), ca.vertcat(*of_joints[1 : k + 2]))
    return ca.Function("site_derivative", of_joints, [ca.reshape(ca.densify(value), 3, -1)])


@functools.lru_cache(maxsize=16)
def site_motion(mechanism: Mechanism, order: int) -> ca.Function:
    """Return the function from q, v and a to the velocities (order 1) or accelerations (2) of all sites (3, n_sites).

    That to their jerks (3) takes the independent joints' jerk as well.
    """
    names = "qvaj" if order == 3 else "qva"
    q, v, a, *j = (ca.SX.sym(name, mechanism.dof if name != "q" else mechanism.n_q) for name in names)
    of_joints = [mechanism.dynamics.velocity_map(q) @ v]
    if order > 1:
        of_joints.append(joint_acceleration(mechanism)(q, v, a))
    if order > 2:
        of_joints.append(joint_jerk(mechanism)(q, v, a, *j))
    return ca.Function("site_motion", [q, v, a, *j], [site_derivative(mechanism, order)(q, *of_joints)])


def sliding_friction(mechanism: Mechanism, q: np.ndarray, column: int = 0) -> np.ndarray:
    """Return the dry friction (n,) [N.m or N] against one independent coordinate at poses (n, n_q); the others rest."""
    if not any(frictions_of(mechanism.model)):
        return np.zeros(len(q))
    # At 1000 transition speeds, joints that move a hundredth as fast still have full friction.
    fast, still = np.zeros((2, len(q), mechanism.dof))
    fast[:, column] = 1000.0 * mechanism.friction_transition
    motion = (q, fast, still, np.zeros((len(q), mechanism.n_u)))
    whole, without = (sampled(f, *motion)[:, column, 0] for f in (mechanism.dynamics.residual, mechanism.dynamics.sliding))
    return whole - without


def needed_effort(
    mechanism: Mechanism,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    time_s: np.ndarray | None = None,
    *,
    limit: np.ndarray | None = None,
    wanted: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the efforts (n, n_u) for a motion by `distributed`, and the generalised effort (n, n_s) that they miss.

    The second value is zero if there are enough actuators, whatever their limits. `time_s` is that of `demanded`.
    """
    tau, maps = demanded(mechanism, q, v, a, time_s)
    effort = distributed(mechanism, tau, maps, limit, wanted)
    return effort, tau - np.einsum("ksu,ku->ks", maps, effort)


def distributed(
    mechanism: Mechanism,
    tau: np.ndarray,
    maps: np.ndarray,
    limit: np.ndarray | None = None,
    wanted: np.ndarray | None = None,
) -> np.ndarray:
    """Return the efforts (n, n_u) by which the actuators of a mechanism produce generalised efforts tau (n, n_s).

    Args:
        mechanism: whose `selection` has the rule and the pre-tension.
        tau: generalised efforts [N.m or N].
        maps: Gamma^T B (n, n_s, n_u).
        limit: of the actuators (n_u, 2) or (n, n_u, 2) [N.m or N]; by default the model's own.
        wanted: efforts (n_u,) or (n, n_u) to which the nearest are taken; by default the pre-tension, which is 0 or given.
    """
    limit, rule = mechanism.effort_limit if limit is None else limit, mechanism.selection.effort_sharing
    if wanted is not None:
        return distribute(tau, maps, limit, wanted)
    return distribute(tau, maps, limit, mechanism.pre_tension, rule or LEAST_SQUARES)


def demanded(
    mechanism: Mechanism, q: np.ndarray, v: np.ndarray, a: np.ndarray, time_s: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the generalised effort tau (n, n_s) that a motion needs, and Gamma^T B (n, n_s, n_u) along it.

    Forces over time are those at the times (n,) [s]; without times they are left out.
    """
    if time_s is None:
        tau = sampled(mechanism.dynamics.inverse_dynamics, q, v, a)[:, :, 0]
    else:
        tau = sampled(mechanism.forced.inverse_dynamics, q, v, a, *mechanism.forces_at(time_s))[:, :, 0]
    return tau, sampled(mechanism.dynamics.effort_map, q)


def is_redundant(mechanism: Mechanism) -> bool:
    """Tell if at home several efforts of the actuators produce the same generalised effort."""
    arms = np.array(mechanism.dynamics.effort_map(mechanism.home))
    return bool(np.linalg.matrix_rank(arms, rtol=ZERO_ARM_SHARE) < mechanism.n_u)


def whole_turns(mechanism: Mechanism, travelled: np.ndarray) -> np.ndarray:
    """Return the whole turns (n_q,) [rad] nearest to the joints' travel [rad or m]; 0 for joints that do not turn."""
    hinges = np.array([joint.turns for joint in mechanism.joints])
    return np.where(hinges, 2 * np.pi * np.round(travelled / (2 * np.pi)), 0.0)


def ball_angles(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return the angles [rad] (n, n_balls) of the ball joints with a range, in the order of `mechanism.balls`."""
    if not mechanism.balls:
        return np.empty((len(poses), 0))
    turns = sampled(mechanism.dynamics.ball_turns, poses)[:, :, 0]
    return 2 * np.arcsin(np.sqrt(np.clip(turns, 0.0, 1.0)))


def beyond_balls(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return how far ball joints are turned beyond their ranges [rad] (n, n_balls); values inside are negative."""
    return ball_angles(mechanism, poses) - [ball.largest for ball in mechanism.balls]


def shut_balls(mechanism: Mechanism) -> str | None:
    """Return a sentence on the ball joints with a range of 0 deg, which a default limited="true" gives; None without any."""
    names = [ball.name for ball in mechanism.balls if ball.largest == 0]
    if not names:
        return None
    return (
        f'ball joint {", ".join(names)} cannot turn: it has limited="true" and a range of 0 deg, perhaps from a default'
        ' class. Set limited="false" at the joint, or give it a range'
    )


def felt_inertia(mechanism: Mechanism, pose: np.ndarray) -> np.ndarray:
    """Return the inertia (n_s,) [kg.m2 or kg] that a force on each independent coordinate accelerates in the simulation.

    All other coordinates are free, as between two control instants. Loops that are closed exactly leave 1 / (M^-1)_ii.
    Behind a soft loop, a drive at first moves little more than its own link, and feedback for the whole leg would be
    unstable. With the rows J and the regularisation R of MuJoCo's equality constraints, a force f accelerates by
    (M^-1 - M^-1 J^T (J M^-1 J^T + R)^-1 J M^-1) f (MuJoCo, "Computation", constraint model).
    """
    model = mechanism.model
    data = mujoco.MjData(model)
    data.qpos[:] = mechanism.qpos_of(pose)
    mujoco.mj_forward(model, data)
    rows, free = equality_rows(model, data)
    held = free @ rows.T @ np.linalg.solve(rows @ free @ rows.T + np.diag(data.efc_R[: data.ne]), rows @ free)
    found = np.empty(mechanism.dof)
    for column, index in enumerate(mechanism.independent.tolist()):
        unit = np.zeros(mechanism.n_q)
        unit[index] = 1.0
        found[column] = 1.0 / mechanism.rates_of(pose, (free - held) @ mechanism.qvel_of(pose, unit))[index]
    return found


def equality_rows(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows J (n, nv) of MuJoCo's equality constraints, and M^-1 (nv, nv), at the pose of a forward pass."""
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return equality_jacobian(model, data), np.linalg.inv(mass)


def equality_jacobian(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the rows J (n, nv) of MuJoCo's equality constraints at the pose of a forward pass."""
    rows = np.zeros((data.ne, model.nv))  # they stand before the rows of limits and contacts
    if mujoco.mj_isSparse(model):
        of_rows = (data.efc_J_rownnz[: data.ne], data.efc_J_rowadr[: data.ne])
        mujoco.mju_sparse2dense(rows, data.efc_J, *of_rows, data.efc_J_colind)
    else:
        rows[:] = data.efc_J[: rows.size].reshape(rows.shape)
    return rows


def needed_controls(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return MuJoCo's ctrl (n, n_u) of every actuator that gives efforts u (n, n_u) at poses q (n, n_q) under v (n, n_s).

    The ctrl is (u - bias) / gain at MuJoCo's own length and speed of the actuator. The value is not clipped to the range,
    and is infinite where the gain is zero.
    """
    return _needed(mechanism, q, v, u)[0]


def _needed(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ctrls (n, n_u) of `needed_controls`, and the gains (n, n_u)."""
    model, controls, gains = mechanism.model, np.empty((len(q), mechanism.n_u)), np.empty((len(q), mechanism.n_u))
    data = mujoco.MjData(model)
    rates = joint_rates(mechanism, q, v)
    qpos, qvel = mechanism.qpos_of(q), mechanism.qvel_of(q, rates)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:] = qpos[k], qvel[k]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        for j, actuator in enumerate(mechanism.actuators):
            state = np.array([1.0, data.actuator_length[actuator.output], data.actuator_velocity[actuator.output]])
            gain, bias = float(state @ actuator.gains), float(state @ actuator.biases)
            controls[k, j], gains[k, j] = (u[k, j] - bias) / gain if gain else np.inf, gain
    return controls, gains


def control_excess(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the violation (n, n_u) of ctrlrange by the needed ctrl, in its own unit, negative inside the range.

    If the whole range exceeds a force clamp, the value is the distance of the effort from that clamp.
    """
    ranges = np.array([[a.control_lower, a.control_upper] for a in mechanism.actuators]).reshape(-1, 2)
    controls, gains = _needed(mechanism, q, v, u)
    for j, actuator in enumerate(mechanism.actuators):
        turning = np.isfinite(controls[:, j])
        controls[turning, j] = ranged_control(actuator, controls[turning, j], u[turning, j], gains[turning, j], np.maximum)
    return np.maximum(ranges[:, 0] - controls, controls - ranges[:, 1])
