"""The ctrl that planned efforts need along a motion, which a servo's ctrlrange must contain."""

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import ranged_control
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates


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
