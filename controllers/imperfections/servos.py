"""Servos that give the effort asked, as far as the range of their ctrl leaves it.

Who runs a plan on a servo works out the ctrl that gives an effort where it stands, at every step:

    u = gain c + bias,   gain = g0 + g1 l + g2 l',   bias = b0 + b1 l + b2 l',   c within its range.

Under integrators whose steps do not know how a force changes that is a motor, which is what the simulation then has. The
implicit ones have the slopes of a servo's force in a step's inertia, whatever its ctrl: there servos stay what they are.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import FIXED, LEAST_GAIN, NO_BIAS
from linkplan.models.mechanism import Mechanism

# Integrators whose steps know nothing of how a servo's force changes.
_EXPLICIT = (int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_RK4))


def stay_servos(mechanism: Mechanism) -> bool:
    """Return whether a mechanism has servos that a simulator step tells from motors."""
    return any(one.is_servo for one in mechanism.actuators) and int(mechanism.model.opt.integrator) not in _EXPLICIT


def as_motors(model: mujoco.MjModel, mechanism: Mechanism) -> None:
    """Make the servos of a model, which is changed, motors whose ctrl is their effort."""
    for actuator in mechanism.actuators:
        if actuator.is_servo:
            i = actuator.index
            model.actuator_gaintype[i], model.actuator_biastype[i] = FIXED, NO_BIAS
            model.actuator_gainprm[i], model.actuator_biasprm[i] = 0.0, 0.0
            model.actuator_gainprm[i, 0] = 1.0
            model.actuator_ctrllimited[actuator.channel] = False


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ServoInversion:
    """What makes ctrls (n, n_u) of efforts: coefficients (n_u, 3) of gains and biases, the ends (n_u,) of ctrls' ranges.

    `motor` (n_u,) are the servos that the simulation has as motors: their ctrl is the effort that their range leaves.
    """

    gains: np.ndarray
    biases: np.ndarray
    low: np.ndarray
    high: np.ndarray
    motor: np.ndarray

    def controls(self, effort: np.ndarray, length: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the ctrls that give efforts at actuators' lengths and speeds, and the efforts that they give."""
        gain = self.gains[:, 0] + self.gains[:, 1] * length + self.gains[:, 2] * rate
        bias = self.biases[:, 0] + self.biases[:, 1] * length + self.biases[:, 2] * rate
        none = np.abs(gain) <= LEAST_GAIN * np.abs(self.gains[:, 0])  # no ctrl gives an effort
        wanted = np.where(none, 0.0, (effort - bias) / np.where(none, 1.0, gain))
        ctrl = np.where(none, 0.0, np.minimum(np.maximum(wanted, self.low), self.high))
        given = np.where((ctrl == wanted) & ~none, effort, gain * ctrl + bias)
        return np.where(self.motor, given, ctrl), given


def servo_inversion(mechanism: Mechanism) -> ServoInversion | None:
    """Return what makes ctrls of efforts; None where each is a multiple of the other, but for a constant."""
    servos = np.array([one.is_servo for one in mechanism.actuators])
    ranges = np.array([[one.control_lower, one.control_upper] for one in mechanism.actuators])
    ranges[~servos] = -np.inf, np.inf
    stay = stay_servos(mechanism)
    if not (stay or np.isfinite(ranges).any()):
        return None
    return ServoInversion(
        gains=np.array([one.gains for one in mechanism.actuators]),
        biases=np.array([one.biases for one in mechanism.actuators]),
        low=ranges[:, 0],
        high=ranges[:, 1],
        motor=servos & (not stay),
    )
