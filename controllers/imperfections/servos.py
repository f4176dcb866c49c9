"""Servos in many simulations at once: motors that give the effort asked, as far as the range of their ctrl leaves it.

Who runs a plan on a servo works out the ctrl that gives an effort where it stands, at every step. With a gain and bias in
the simulator that follow the state, that is a motor; here the model has the motor, and the ctrl's range is what is left of
the servo:

    u between gain c + b0 + b1 l + b2 l' at both ends c of the range.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.controllers.trackers.linear import added
from linkplan.models.actuation.actuators import FIXED, NO_BIAS, constant_arms
from linkplan.models.errors import ModelError
from linkplan.models.mechanism import Mechanism

# Integrators whose steps know nothing of how a servo's force changes.
_EXPLICIT = (int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_RK4))


def refuse_unfit(mechanism: Mechanism) -> None:
    """Refuse a mechanism that cannot be simulated in a batch.

    Raises:
        ModelError: when a servo's range limits it by a gain that changes, or a length that is no sum of joints' positions.
    """
    for actuator in mechanism.actuators:
        limited = np.isfinite([actuator.control_lower, actuator.control_upper]).any()
        simple = not any(actuator.gains[1:]) and constant_arms(mechanism.model, actuator.index)
        if actuator.is_servo and limited and not simple:
            raise ModelError(
                f"mechanism '{mechanism.name}': batches of simulations run servos of constant gain on hinges, slides and"
                f" fixed tendons where a ctrlrange limits them; actuator {actuator.name} is another on {actuator.target}"
            )


def as_motors(model: mujoco.MjModel, mechanism: Mechanism) -> None:
    """Make the servos of a model, which is changed, motors whose ctrl is their effort."""
    for actuator in mechanism.actuators:
        if actuator.is_servo:
            i = actuator.index
            model.actuator_gaintype[i], model.actuator_biastype[i] = FIXED, NO_BIAS
            model.actuator_gainprm[i], model.actuator_biasprm[i] = 0.0, 0.0
            model.actuator_gainprm[i, 0] = 1.0
            model.actuator_ctrllimited[actuator.channel] = False


def servo_bias(mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray] | None:
    """Return what makes servos' b1 l (n_u, nq) of qpos and b2 l' (n_u, nv) of qvel, where a step tells them from motors.

    The implicit integrators have the slopes of servos' forces in a step's inertia, whatever their ctrl; under the others,
    and without servos, None.

    Raises:
        ModelError: for a servo whose gain changes, or whose length is no sum of joints' positions.
    """
    model, servos = mechanism.model, [actuator for actuator in mechanism.actuators if actuator.is_servo]
    if not servos or int(model.opt.integrator) in _EXPLICIT:
        return None
    by_position, by_rate = np.zeros((mechanism.n_u, model.nq)), np.zeros((mechanism.n_u, model.nv))
    for j, actuator in enumerate(mechanism.actuators):
        arms = constant_arms(model, actuator.index) if actuator.is_servo else {}
        if actuator.is_servo and (any(actuator.gains[1:]) or not arms):
            raise ModelError(
                f"mechanism '{mechanism.name}': batches of simulations run servos of constant gain on hinges, slides and"
                f" fixed tendons under an implicit integrator; actuator {actuator.name} is another on {actuator.target}"
            )
        for dof, arm in arms.items():
            by_position[j, int(model.jnt_qposadr[int(model.dof_jntid[dof])])] = actuator.biases[1] * arm
            by_rate[j, dof] = actuator.biases[2] * arm
    return by_position, by_rate


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ServoRanges:
    """What the ranges of servos' ctrl leave of efforts (n, n_u); infinite for all other actuators.

    `by_position` (n_u, nq) and `by_rate` (n_u, nv) make an actuator's b1 l and b2 l' of qpos and qvel; `low` and `high`
    (n_u,) are gain c + b0 at the ends of the range.
    """

    by_position: np.ndarray
    by_rate: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def within(self, effort: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Return efforts (n, n_u) cut at the ranges where the servos stand, qpos (n, nq), and move, qvel (n, nv)."""
        bias = added(qpos[:, None] * self.by_position) + added(qvel[:, None] * self.by_rate)
        return np.clip(effort, self.low + bias, self.high + bias)


def servo_ranges(mechanism: Mechanism) -> ServoRanges | None:
    """Return the ranges of a mechanism's servos, None where there are none."""
    model, actuators = mechanism.model, mechanism.actuators
    if not any(actuator.limits_control for actuator in actuators):
        return None
    by_position, by_rate = np.zeros((len(actuators), model.nq)), np.zeros((len(actuators), model.nv))
    low, high = np.full(len(actuators), -np.inf), np.full(len(actuators), np.inf)
    for j, actuator in enumerate(actuators):
        if not actuator.limits_control:
            continue
        ends = (actuator.gain * actuator.control_lower, actuator.gain * actuator.control_upper)
        low[j], high[j] = min(ends) + actuator.biases[0], max(ends) + actuator.biases[0]
        for dof, arm in constant_arms(model, actuator.index).items():
            by_position[j, int(model.jnt_qposadr[int(model.dof_jntid[dof])])] = actuator.biases[1] * arm
            by_rate[j, dof] = actuator.biases[2] * arm
    return ServoRanges(by_position=by_position, by_rate=by_rate, low=low, high=high)
