"""The linearised map of one step of MuJoCo's integrator in reduced coordinates.

    x = (s, v),   x_{t+h} = A_h x_t + B_h u_t

The reduced dynamics' linearisation is a = A_s ds + A_v dv + B du. A step is v_{t+h} = v_t + h F a, s_{t+h} = s_t + h v_{t+h}
(MuJoCo, "Computation", Numerical integration), where F depends on the integrator:

    Euler           F = M_r^-1 Gamma^T M (M + h D)^-1 M Gamma, D the joints' damping; F = I without damping
    implicitfast    the same, D of joints, tendons and servos, without coupling between branches of the tree
    implicit        the same with Coriolis terms
    discrete        (M_r + h D_r + h^2 K_r) F a = M_r a - h K_r v, D complete, K the springs of joints, tendons and servos
    RK4             the Taylor polynomial of the exponential to the fourth order

The loop constraint is assumed to be rigid. MuJoCo's constraint is soft: with an impedance d it yields by (1 - d) / d of the
load, and it closes a gap within the time constant in `solref`. `rollout.conditions` records both.
"""

import functools

import casadi as ca
import mujoco
import numpy as np

from linkplan.controllers.linearisation import linearise
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates, sampled
from linkplan.models.tree.passive import is_gas_spring, joint_passive

# Integrators that do not use the derivatives of a servo's force.
_EXPLICIT = (int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_RK4))


def simulates_servos(mechanism: Mechanism) -> bool:
    """Return True if a mechanism has servos and an integrator that uses the derivatives of their force."""
    return any(one.is_servo for one in mechanism.actuators) and int(mechanism.model.opt.integrator) not in _EXPLICIT


def shares_in_a_step(mechanism: Mechanism) -> np.ndarray:
    """Return the share (n_s,) of its acceleration that each coordinate reaches in a simulated step from rest at home.

    It is below 1 where the simulation keeps servos and an implicit integrator adds their damping to a step's inertia.
    """
    kind = int(mechanism.model.opt.integrator)
    if not simulates_servos(mechanism) or kind == int(mujoco.mjtIntegrator.mjINT_DISCRETE):
        return np.ones(mechanism.dof)
    step_s = float(mechanism.model.opt.timestep)
    return np.diagonal(_implicit_factor(mechanism, mechanism.home[None], np.zeros((1, mechanism.dof)), step_s, kind)[0])


def simulator_step(
    mechanism: Mechanism, pose: np.ndarray, velocity: np.ndarray, effort: np.ndarray, timestep_s: float, *forces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return A_h (n, 2 n_s, 2 n_s) and B_h (n, 2 n_s, n_u) of one step [s] of the model's integrator about states (n, ...).

    `forces` are those of `linearise`.

    Raises:
        LinkplanError: for an unsupported integrator.
    """
    A, B = linearise(mechanism, pose, velocity, effort, *forces)
    kind = int(mechanism.model.opt.integrator)
    integrators = mujoco.mjtIntegrator
    if kind == int(integrators.mjINT_RK4):
        return _runge_kutta(A, B, timestep_s)
    n, n_s, h = len(pose), mechanism.dof, timestep_s
    by_s, by_v, by_u = A[:, n_s:, :n_s], A[:, n_s:, n_s:], B[:, n_s:]
    identity = np.broadcast_to(np.eye(n_s), (n, n_s, n_s))
    if kind == int(integrators.mjINT_DISCRETE):
        gamma = sampled(mechanism.dynamics.velocity_map, pose)
        rates = joint_rates(mechanism, pose, velocity)
        inertia = sampled(mechanism.dynamics.reduced_inertia, pose)
        D, K = (gamma.swapaxes(1, 2) @ of_all @ gamma for of_all in _discrete_terms(mechanism, pose, rates))
        metric = inertia + h * D + h**2 * K
        by_s, by_u = np.linalg.solve(metric, inertia @ by_s), np.linalg.solve(metric, inertia @ by_u)
        by_v = np.linalg.solve(metric, inertia @ by_v - h * K)
    elif kind in (int(integrators.mjINT_EULER), int(integrators.mjINT_IMPLICIT), int(integrators.mjINT_IMPLICITFAST)):
        F = _implicit_factor(mechanism, pose, velocity, h, kind)
        by_s, by_v, by_u = F @ by_s, F @ by_v, F @ by_u
    else:
        raise LinkplanError(
            f"MuJoCo's integrator {kind} of mechanism '{mechanism.name}' is not supported by the sampled model"
        )
    A_h, B_h = np.empty_like(A), np.empty_like(B)
    A_h[:, n_s:, :n_s], A_h[:, n_s:, n_s:], B_h[:, n_s:] = h * by_s, identity + h * by_v, h * by_u
    A_h[:, :n_s, :n_s] = identity + h * A_h[:, n_s:, :n_s]
    A_h[:, :n_s, n_s:], B_h[:, :n_s] = h * A_h[:, n_s:, n_s:], h * B_h[:, n_s:]
    return A_h, B_h


def repeat(A: np.ndarray, B: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the maps (..., m, m) and (..., m, n_u) of several steps under a constant input."""
    m, n_u = B.shape[-2:]
    block = np.zeros((*A.shape[:-2], m + n_u, m + n_u))
    block[..., :m, :m], block[..., :m, m:] = A, B
    block[..., m:, m:] = np.eye(n_u)
    power = np.linalg.matrix_power(block, steps)
    return power[..., :m, :m], power[..., :m, m:]


def _runge_kutta(A: np.ndarray, B: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    m = A.shape[-1]
    term = np.broadcast_to(np.eye(m), A.shape)  # (h A)^k / k!
    A_h, integral = term.copy(), h * term.copy()
    for k in range(1, 5):
        term = term @ (h * A) / k
        A_h = A_h + term
        if k < 4:
            integral = integral + h * term / (k + 1)
    return A_h, integral @ B


def _implicit_factor(mechanism: Mechanism, pose: np.ndarray, velocity: np.ndarray, h: float, kind: int) -> np.ndarray:
    """Return the factor F (n, n_s, n_s) by which implicit damping reduces an acceleration."""
    model, n, n_s = mechanism.model, len(pose), mechanism.dof
    rates = joint_rates(mechanism, pose, velocity)
    if kind == int(mujoco.mjtIntegrator.mjINT_EULER):
        disabled = bool(model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP))
        D = 0.0 if disabled else -sampled(_slope(mechanism, "joint dampers"), pose, rates)
    else:
        D = _servo_terms(mechanism, pose, 2) - sampled(_slope(mechanism, "dampers"), pose, rates)
        if kind == int(mujoco.mjtIntegrator.mjINT_IMPLICIT):
            D = D + sampled(_slope(mechanism, "bias"), pose, rates)
        related = np.eye(model.nv, dtype=bool)  # one of two degrees of freedom is an ancestor of the other
        for dof in range(model.nv):
            above = int(model.dof_parentid[dof])
            while above >= 0:
                related[dof, above] = related[above, dof] = True
                above = int(model.dof_parentid[above])
        D = D * related  # the simulator drops other entries
    if not np.any(D):
        return np.broadcast_to(np.eye(n_s), (n, n_s, n_s))
    M = sampled(mechanism.dynamics.mass_matrix, pose)
    gamma = sampled(mechanism.dynamics.velocity_map, pose)
    kept = M @ np.linalg.solve(M + h * D, M)
    return np.linalg.solve(gamma.swapaxes(1, 2) @ M @ gamma, gamma.swapaxes(1, 2) @ kept @ gamma)


@functools.lru_cache(maxsize=64)
def _slope(mechanism: Mechanism, of: str) -> ca.Function:
    """Return q, q' -> the derivative (n_q, n_q) of a force on the tree, by q of "springs" of joints, else by q'."""
    q, qd = ca.SX.sym("q", mechanism.n_q), ca.SX.sym("qd", mechanism.n_q)
    if of in ("springs", "joint dampers"):
        T = mechanism.coordinates.velocity_matrix(q)
        velocity = ca.SX.zeros(mechanism.n_q) if of == "springs" else T @ qd
        force = T.T @ joint_passive(mechanism.model, q, velocity)[0]
    else:
        force = {"dampers": mechanism.dynamics.passive, "bias": mechanism.dynamics.bias}[of](q, qd)
    return ca.Function("slope", [q, qd], [ca.densify(ca.jacobian(force, q if of == "springs" else qd))])


def _discrete_terms(mechanism: Mechanism, pose: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return D and K (n, n_q, n_q) of the effective metric M + h D + h^2 K, from joints, tendons and servos.

    The dual solver, PGS, omits tendons and actuators (MuJoCo, "Numerical integration"). Negative stiffness becomes zero.
    """
    K = np.maximum(-sampled(_slope(mechanism, "springs"), pose, rates), 0.0)
    if int(mechanism.model.opt.solver) == int(mujoco.mjtSolver.mjSOL_PGS):
        return -sampled(_slope(mechanism, "joint dampers"), pose, rates), K
    D = _servo_terms(mechanism, pose, 2) - sampled(_slope(mechanism, "dampers"), pose, rates)
    K = K + _spring_stiffness(mechanism, pose)
    return D, K + _servo_terms(mechanism, pose, 1)


def _servo_terms(mechanism: Mechanism, pose: np.ndarray, power: int) -> np.ndarray:
    """Return sum -b B B^T (n, n_q, n_q), b a servo's bias by length (power 1) or speed (2), B its moments.

    The simulation sets a servo's ctrl at every step to obtain the commanded effort. The step's inertia still contains the
    servo's terms. Terms of a gain that varies with length or speed are omitted.
    """
    own = np.array([max(0.0, -actuator.biases[power]) for actuator in mechanism.actuators])
    if not own.any():
        return np.zeros((len(pose), mechanism.n_q, mechanism.n_q))
    moments = sampled(mechanism.dynamics.effort_matrix, pose)
    return (moments * own) @ moments.swapaxes(1, 2)


def _spring_stiffness(mechanism: Mechanism, pose: np.ndarray) -> np.ndarray:
    """Return the contribution of tendons' springs, and of actuators without gain, to K (n, n_q, n_q) at poses (n, n_q)."""
    model, n_q = mechanism.model, mechanism.n_q
    K = np.zeros((len(pose), n_q, n_q))
    gas = [a for a in range(model.nactuator) if is_gas_spring(model, a)]
    sprung = bool(np.any(model.tendon_stiffness) or np.any(model.tendon_stiffnesspoly))
    sprung &= not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_SPRING)
    if not gas and not sprung:
        return K
    data, low, high = mujoco.MjData(model), *model.tendon_lengthspring.T
    a, (b, c) = model.tendon_stiffness, model.tendon_stiffnesspoly.T
    for k, q in enumerate(pose):
        data.qpos[:] = mechanism.qpos_of(q)
        mujoco.mj_fwdPosition(model, data)
        turned = np.array([mechanism.qvel_of(q, unit) for unit in np.eye(n_q)]).T
        if gas:
            moments = np.zeros((len(data.moment_rownnz), model.nv))
            rows = data.moment_rownnz, data.moment_rowadr, data.moment_colind
            mujoco.mju_sparse2dense(moments, data.actuator_moment, *rows)
            arms = moments[model.actuator_outadr[gas]] @ turned
            K[k] += arms.T @ (np.maximum(-model.actuator_biasprm[gas, 1], 0.0)[:, None] * arms)
        if sprung:
            moments = np.zeros((model.ntendon, model.nv))
            mujoco.mju_sparse2dense(moments, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind)
            arms = moments @ turned
            x = np.maximum(data.ten_length - high, 0.0) + np.minimum(data.ten_length - low, 0.0)
            taut = (low >= data.ten_length) | (data.ten_length >= high)
            K[k] += arms.T @ (np.where(taut, np.maximum(a + 2 * b * x + 3 * c * x**2, 0.0), 0.0)[:, None] * arms)
    return K
