"""MuJoCo's own integrator in reduced coordinates: the exact linear map of one step about a state.

    x = (s, v),   x_{t+h} = A_h x_t + B_h u_t

With a = A_s ds + A_v dv + B du the reduced dynamics' derivatives, and v_{t+h} = v_t + h F a, s_{t+h} = s_t + h v_{t+h}
(MuJoCo, "Computation", Numerical integration):

    Euler           F = M_r^-1 Gamma^T M (M + h D)^-1 M Gamma, D the joints' damping; F = I without damping
    implicitfast    the same, whether or not Euler's implicit damping is switched off
    implicit        the same with D = -d(forces)/dq', Coriolis terms included
    discrete        (M_r + h D_r + h^2 K_r) F a = M_r a - h K_r v, K the joints' springs
    RK4             the Taylor polynomial of the exponential to the fourth order

The loop constraint is taken as hard. MuJoCo's is soft: with an impedance d it gives way by (1 - d) / d of the load, and its
`solref` closes what opens within its time constant. `rollout.conditions` records both beside every measurement.
"""

import mujoco
import numpy as np

from linkplan.controllers.trackers.lqr import linearise
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates, sampled

_JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))


def simulator_step(
    mechanism: Mechanism, pose: np.ndarray, velocity: np.ndarray, effort: np.ndarray, timestep_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return A_h (n, 2 n_s, 2 n_s) and B_h (n, 2 n_s, n_u) of one step [s] of the model's integrator about states (n, ...).

    Raises:
        LinkplanError: for an integrator that is not known here.
    """
    A, B = linearise(mechanism, pose, velocity, effort)
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
        D = _reduced(gamma, _damping(mechanism.model, rates))
        K = _reduced(gamma, _stiffness(mechanism.model, pose))
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
    """Return the maps (..., m, m) and (..., m, n_u) of several steps under one held input."""
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
    """Return F (n, n_s, n_s): what the implicit damping leaves of an acceleration."""
    model, n, n_s = mechanism.model, len(pose), mechanism.dof
    rates = joint_rates(mechanism, pose, velocity)
    if kind == int(mujoco.mjtIntegrator.mjINT_IMPLICIT):
        bias, passive = mechanism.dynamics.bias.jacobian(), mechanism.dynamics.passive.jacobian()
        D = np.empty((n, mechanism.n_q, mechanism.n_q))
        for k in range(n):
            n_q = mechanism.n_q
            of_bias = np.array(bias(pose[k], rates[k], np.zeros(n_q))[1])
            D[k] = of_bias - np.array(passive(pose[k], rates[k], np.zeros(n_q))[1])
    else:
        off = kind == int(mujoco.mjtIntegrator.mjINT_EULER) and bool(
            model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
        )
        damping = np.zeros_like(rates) if off else _damping(model, rates)
        D = damping[:, :, None] * np.eye(mechanism.n_q)
    if not np.any(D):
        return np.broadcast_to(np.eye(n_s), (n, n_s, n_s))
    M = sampled(mechanism.dynamics.mass_matrix, pose)
    gamma = sampled(mechanism.dynamics.velocity_map, pose)
    kept = M @ np.linalg.solve(M + h * D, M)
    return np.linalg.solve(gamma.swapaxes(1, 2) @ M @ gamma, gamma.swapaxes(1, 2) @ kept @ gamma)


def _reduced(gamma: np.ndarray, diagonal: np.ndarray) -> np.ndarray:
    return gamma.swapaxes(1, 2) @ (diagonal[:, :, None] * gamma)


def _damping(model: mujoco.MjModel, rates: np.ndarray) -> np.ndarray:
    """Return the slope (n, n_q) of the joints' damping, the actuators' own reflected by gear^2, at rates (n, n_q)."""
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_DAMPER):
        return np.zeros_like(rates)
    a, (b, c) = np.array(model.dof_damping), np.array(model.dof_dampingpoly).T
    total = a + 2 * b * np.abs(rates) + 3 * c * rates**2
    for actuator in range(model.nu):
        if int(model.actuator_trntype[actuator]) in _JOINT_TRANSMISSIONS:
            dof = int(model.jnt_dofadr[model.actuator_trnid[actuator, 0]])
            a, (b, c) = float(model.actuator_damping[actuator]), model.actuator_dampingpoly[actuator]
            rate = rates[:, dof]
            total[:, dof] += float(model.actuator_gear[actuator, 0]) ** 2 * (a + 2 * b * np.abs(rate) + 3 * c * rate**2)
    return total


def _stiffness(model: mujoco.MjModel, pose: np.ndarray) -> np.ndarray:
    """Return the slope (n, n_q) of the joints' springs at poses (n, n_q), none below zero."""
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_SPRING):
        return np.zeros_like(pose)
    x = pose - model.qpos_spring[model.jnt_qposadr]
    a, (b, c) = np.array(model.jnt_stiffness), np.array(model.jnt_stiffnesspoly).T
    return np.maximum(a + 2 * b * x + 3 * c * x**2, 0.0)
