"""Servos as effort sources: the ctrl value that produces a given effort, within the range of ctrl.

At every step the ctrl c of a servo is computed from the desired effort u, the length l and the speed l':

    u = gain c + bias,   gain = g0 + g1 l + g2 l',   bias = b0 + b1 l + b2 l',   c within its range.

With explicit integrators such a servo is equivalent to a motor, and the simulation uses a motor. Implicit integrators add
the derivatives of a servo's force to the step's inertia, for any ctrl, so the simulation keeps the servo. Its force follows
from the speed at a step's end: the ctrl is computed for the speed at the step's beginning plus the increase of the
reference's speed in a step.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.controllers.integrator import simulates_servos
from linkplan.controllers.reference import SampledReference
from linkplan.models.actuation.actuators import FIXED, NO_BIAS
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates, sampled

# A servo's gain below this share of its nominal gain counts as zero: no ctrl then gives a prescribed effort.
_LEAST_GAIN_SHARE = 1e-9


def as_motors(model: mujoco.MjModel, mechanism: Mechanism) -> None:
    """Change the servos of a model into motors whose ctrl is their effort; the model is modified."""
    for actuator in mechanism.actuators:
        if actuator.is_servo:
            i = actuator.index
            model.actuator_gaintype[i], model.actuator_biastype[i] = FIXED, NO_BIAS
            model.actuator_gainprm[i], model.actuator_biasprm[i] = 0.0, 0.0
            model.actuator_gainprm[i, 0] = 1.0
            model.actuator_ctrllimited[actuator.channel] = False


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ServoInversion:
    """The map from efforts to ctrls (n, n_u): coefficients (n_u, 3) of gains and biases, ends (n_u,) of the ctrl ranges.

    `motor` (n_u,) marks servos that are simulated as motors: their ctrl is the effort that their range allows.
    """

    gains: np.ndarray
    biases: np.ndarray
    low: np.ndarray
    high: np.ndarray
    motor: np.ndarray

    def controls(self, effort: np.ndarray, length: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the ctrls for efforts (n, n_u) at the actuators' lengths and speeds, and the efforts they produce."""
        gain = self.gains[:, 0] + self.gains[:, 1] * length + self.gains[:, 2] * rate
        bias = self.biases[:, 0] + self.biases[:, 1] * length + self.biases[:, 2] * rate
        no_gain = np.abs(gain) <= _LEAST_GAIN_SHARE * np.abs(self.gains[:, 0])  # ctrl has no effect on the effort
        wanted = np.where(no_gain, 0.0, (effort - bias) / np.where(no_gain, 1.0, gain))
        ctrl = np.where(no_gain, 0.0, np.minimum(np.maximum(wanted, self.low), self.high))
        given = np.where((ctrl == wanted) & ~no_gain, effort, gain * ctrl + bias)
        return np.where(self.motor, given, ctrl), given


def servo_inversion(mechanism: Mechanism) -> ServoInversion | None:
    """Return the map from efforts to ctrls; None if every ctrl is an affine function of its effort without limits."""
    servos = np.array([one.is_servo for one in mechanism.actuators])
    ranges = np.array([[one.control_lower, one.control_upper] for one in mechanism.actuators])
    ranges[~servos] = -np.inf, np.inf
    stay = simulates_servos(mechanism)
    if not (stay or np.isfinite(ranges).any()):
        return None
    return ServoInversion(
        gains=np.array([one.gains for one in mechanism.actuators]),
        biases=np.array([one.biases for one in mechanism.actuators]),
        low=ranges[:, 0],
        high=ranges[:, 1],
        motor=servos & (not stay),
    )


def speed_gains(mechanism: Mechanism, reference: SampledReference, substeps: int) -> np.ndarray | None:
    """Return the increases (n, n_u) of the actuators' speeds along a reference in a simulator step of each control period.

    None if no servo's force follows from the speed at a step's end. The discrete integrator also takes the length at the
    step's end, for which efforts are not corrected.
    """
    discrete = int(mechanism.model.opt.integrator) == int(mujoco.mjtIntegrator.mjINT_DISCRETE)
    if discrete or not simulates_servos(mechanism):
        return None
    rates = joint_rates(mechanism, reference.pose_rad, reference.velocity_rad_s)
    speeds = np.einsum("nju,nj->nu", sampled(mechanism.dynamics.effort_matrix, reference.pose_rad), rates)
    return np.diff(speeds, axis=0, append=speeds[-1:]) / substeps
