"""Quantities of a mechanism along a motion, sampled: poses q (n, n_q), velocities v and accelerations a (n, n_s).

They include the angles of ball joints with a range.
"""

import functools

import casadi as ca
import numpy as np

from linkplan.models.compiled.functions import evaluated, mapped
from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.friction import frictions_of

# Violations of a joint's range below this are rounding of the assembly [rad or m].
RANGE_ROUNDING = 1e-8
# Moment arms below this share of the largest are zero to rounding, at an actuator's dead centre.
_ZERO_ARM_SHARE = 1e-12
# Efforts that miss at most this share of the largest effort count as complete: above rounding, and negligible in practice.
HOLDING_TOLERANCE = 1e-9


def sampled(function: ca.Function, *arguments: np.ndarray) -> np.ndarray:
    """Return a function's first output over samples: arguments (n, k), result (n, rows, columns)."""
    n = len(arguments[0])
    if n == 0:
        return np.empty((0, *function.size_out(0)))
    (stacked,) = evaluated(mapped(function, n), *[a.T for a in arguments], outputs=1)
    return stacked.reshape(function.size1_out(0), n, function.size2_out(0)).transpose(1, 0, 2)


def joint_rates(mechanism: Mechanism, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return every joint's speed q' = Gamma v (n, n_q)."""
    return np.einsum("kqs,ks->kq", sampled(mechanism.dynamics.velocity_map, q), v)


def accelerations(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return every joint's acceleration q'' = Gamma a + Gamma' v (n, n_q)."""
    return sampled(joint_acceleration(mechanism), q, v, a)[:, :, 0]


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
    mechanism: Mechanism, q: np.ndarray, v: np.ndarray, a: np.ndarray, time_s: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the least efforts (n, n_u) for a motion, and the generalised effort (n, n_s) that no effort can produce.

    u = (Gamma^T B)^+ tau. The second value is zero if there are enough actuators. `time_s` is that of `demanded`.
    """
    tau, maps = demanded(mechanism, q, v, a, time_s)
    effort = least_effort(tau, maps)
    return effort, tau - np.einsum("ksu,ku->ks", maps, effort)


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


def least_effort(tau: np.ndarray, maps: np.ndarray) -> np.ndarray:
    """Return the efforts (n, n_u) of least norm that give generalised efforts tau (n, n_s), in least squares."""
    same = len(maps) > 1 and bool(np.all(maps == maps[0]))  # motors on the coordinates: one inverse for all samples
    inverse = (
        np.broadcast_to(np.linalg.pinv(maps[0], rcond=_ZERO_ARM_SHARE), maps.transpose(0, 2, 1).shape)
        if same
        else np.linalg.pinv(maps, rcond=_ZERO_ARM_SHARE)
    )
    return np.einsum("kus,ks->ku", inverse, tau)


def missed_rounding(limit: np.ndarray) -> float:
    """Return the effort that may be missed by rounding [N.m or N], of actuators with limits (n_u, 2)."""
    return HOLDING_TOLERANCE * np.where(np.isfinite(limit), np.abs(limit), 0.0).max(initial=1.0)


def effort_within(tau: np.ndarray, maps: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return the efforts (n, n_u) of least norm within limits (n_u, 2) that give tau (n, n_s), in least squares.

    Several actuators of one joint, such as cables that only pull, may share its effort differently than without limits.
    """
    import scipy

    effort, (low, high) = least_effort(tau, maps), limit.T
    for k in np.flatnonzero(np.any((effort < low) | (effort > high), axis=1)):
        small = 1e-6 * float(np.linalg.norm(maps[k])) * np.eye(len(limit))  # the least of the efforts with the same result
        rows, wanted = np.vstack([maps[k], small]), np.append(tau[k], np.zeros(len(limit)))
        within = (low, np.nextafter(high, np.inf))
        found = scipy.optimize.lsq_linear(rows, wanted, within, method="bvls", max_iter=100 * len(limit))
        free = found.active_mask == 0  # these give exactly, in all rows, what those at their limits lack
        held = np.where(free, 0.0, np.clip(found.x, low, high))
        held[free] = least_effort((tau[k] - maps[k] @ held)[None], maps[k][None, :, free])[0]
        both = (np.clip(x, low, high) for x in (held, found.x))
        effort[k] = min(both, key=lambda x: float(np.linalg.norm(tau[k] - maps[k] @ x)))
    return effort


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
