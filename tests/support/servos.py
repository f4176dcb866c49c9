"""Servos as a plan sees them: efforts, and the ctrl that gives them."""

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.mechanism import Mechanism


def ctrl_of(actuator: Actuator, effort: float, length: float, velocity: float) -> float:
    """Return the ctrl at which an actuator gives an effort at a length and speed, (effort - bias) / gain."""
    state = np.array([1.0, length, velocity])
    return float((effort - state @ actuator.biases) / (state @ actuator.gains))


def controls(mechanism: Mechanism, qpos: np.ndarray, qvel: np.ndarray, efforts: np.ndarray) -> np.ndarray:
    """Return the ctrl (nu,) at which MuJoCo's actuators, servos among them, give the efforts (n_u,)."""
    data = mujoco.MjData(mechanism.model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(mechanism.model, data)
    ctrl = np.zeros(mechanism.model.nu)
    for actuator, effort in zip(mechanism.actuators, efforts, strict=True):
        length, velocity = data.actuator_length[actuator.output], data.actuator_velocity[actuator.output]
        ctrl[actuator.channel] = ctrl_of(actuator, effort, length, velocity)
    return ctrl
