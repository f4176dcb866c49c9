"""Actuators that a plan can use, with their effort limits.

    tau = B(q) u,   u = gain ctrl + bias,   u in [lower, upper]

The effort u is MuJoCo's actuator force. A motor has a constant gain and no bias, so its `ctrlrange` limits the effort, in
addition to `forcerange` and to the `actuatorfrcrange` of its joint or tendon. A servo (position, velocity, any affine gain
and bias) has a gain and a bias that depend on its length l and speed l':

    gain = g0 + g1 l + g2 l',   bias = b0 + b1 l + b2 l'

A plan contains efforts for both. The simulation inverts gain and bias to find the ctrl that gives an effort.
"""

from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.actuation.transmission import KINDS, TRN_SITE, TRN_TENDON, attachment, gear_of, has_length, moment
from linkplan.models.tree.coordinates import HINGE, SLIDE, joint_label
from linkplan.models.tree.dynamics import Tree
from linkplan.models.tree.passive import is_gas_spring, switched_off
from linkplan.models.tree.tendons import LACKING, is_fixed, lacks_length, tendon_joints, tendon_label

# Coefficients on 1, length and speed.
Triple = tuple[float, float, float]

FIXED, AFFINE = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE)
NO_BIAS, AFFINE_BIAS = int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)
# A motor with a back-EMF; without inductance and the like it has no state.
DC_MOTOR = int(mujoco.mjtDyn.mjDYN_DCMOTOR)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Actuator:
    """An actuator: its effort limits [unit], its target and its indices in MuJoCo's model.

    `joint` is the coordinate of the hinge or slide that it drives, or None for any other transmission. `target` names the
    driven element ("joint O", "tendon cable", "site tool"). `gains` and `biases` hold (g0, g1, g2) and (b0, b1, b2).
    """

    name: str
    index: int  # of MuJoCo's actuator
    channel: int  # of its ctrl
    output: int  # of its force, length and velocity
    joint: int | None
    target: str
    gear: float  # the first of the gear vector
    gains: Triple
    biases: Triple
    control_lower: float
    control_upper: float
    lower: float
    upper: float
    unit: str  # "N.m" or "N"
    has_length: bool  # true on a hinge, slide or tendon: `lengths` then gives its length

    @property
    def limits_control(self) -> bool:
        """True if its ctrlrange gives effort limits that depend on length and speed: a servo with constant gain."""
        limited = np.isfinite([self.control_lower, self.control_upper]).any()
        return self.is_servo and bool(limited) and not any(self.gains[1:]) and self.has_length

    @property
    def effort_ends(self) -> tuple[float, float]:
        """The least and largest effort: its clamps, or twice the stall effort if a back-EMF or another speed gain limits it.

        By its ctrl alone it does not exceed its no-load speed, and brakes from there with at most twice its stall effort.
        """
        stall = [abs(self.gain * end + self.biases[0]) for end in (self.control_lower, self.control_upper)]
        slows = self.limits_control and not self.biases[1] and self.biases[2] < 0
        largest = 2 * max(stall) if slows else np.inf
        return max(self.lower, -largest), min(self.upper, largest)

    @property
    def gain(self) -> float:
        """The effort per unit of MuJoCo's ctrl at zero length and speed."""
        return self.gains[0]

    @property
    def si_units(self) -> tuple[str, str]:
        """The SI units of its length and of its effort."""
        return "rad" if self.unit == "N.m" else "m", self.unit

    @property
    def is_servo(self) -> bool:
        """True if its effort at a given ctrl depends on its length or speed."""
        return any(self.gains[1:]) or any(self.biases[1:])


def ranged_control(actuator: Actuator, control, effort, gain, larger):
    """Return the quantity that a servo's ctrlrange bounds: the ctrl c of an effort, corrected for force clamps.

    MuJoCo's force is clip(gain clip(ctrl) + bias), where the outer clip is at the force clamps. If the whole ctrlrange
    exceeds a clamp, every ctrl gives the clamp, and the effort at the clamp must be legal whatever c is:

        low <= c + max(0, low - c_most) - max(0, c_least - high) <= high,

    where c_least and c_most are the ctrls that reach the clamps. `larger` is np.maximum for numbers and ca.fmax for
    expressions.
    """
    clamps = (actuator.lower, actuator.upper) if actuator.gain > 0 else (actuator.upper, actuator.lower)
    least, most = (control + (clamp - effort) / gain if np.isfinite(clamp) else None for clamp in clamps)
    ranged = control
    if most is not None and np.isfinite(actuator.control_lower):
        ranged = ranged + larger(0.0, actuator.control_lower - most)
    if least is not None and np.isfinite(actuator.control_upper):
        ranged = ranged - larger(0.0, least - actuator.control_upper)
    return ranged


def label(model: mujoco.MjModel, index: int) -> str:
    """Return an actuator's name, or a name made from its index."""
    return model.actuator(index).name or f"actuator {index}"


def unusable_reason(model: mujoco.MjModel, index: int) -> str | None:
    """Return the reason why a plan cannot use actuator `index`, or None if it can."""
    return _unusable_dynamics(model, index) or _unusable_force(model, index)


def _unusable_dynamics(model: mujoco.MjModel, index: int) -> str | None:
    if switched_off(model, index):
        return "it is switched off"
    if float(model.actuator_delay[index]) != 0.0:
        return "its control is delayed"
    if int(model.actuator_plugin[index]) >= 0:
        return "it is a plugin"
    if int(model.actuator_dyntype[index]) == DC_MOTOR and not model.actuator_actnum[index]:
        return None if _is_line(model, index) else "a torque-speed line has no cogging, rate limit or temperature"
    if int(model.actuator_dyntype[index]) != int(mujoco.mjtDyn.mjDYN_NONE) or int(model.actuator_actnum[index]) > 0:
        dynamics = mujoco.mjtDyn(int(model.actuator_dyntype[index])).name.removeprefix("mjDYN_").lower()
        at_joint = dynamics.startswith("filter") and attachment(model, index).dof is not None
        remedy = ", which mechanism.drive with its joint omits" if at_joint else ""
        return f"it has a state of its own ({dynamics} dynamics{remedy})"
    return None


def _unusable_force(model: mujoco.MjModel, index: int) -> str | None:
    kind = mujoco.mjtTrn(int(model.actuator_trntype[index]))
    gain, bias = int(model.actuator_gaintype[index]), int(model.actuator_biastype[index])
    if kind not in KINDS or int(model.actuator_outnum[index]) != 1:
        return "a plan supports joint, tendon, slider-crank and site transmissions of one force"
    if int(model.actuator_ctrlnum[index]) != 1:
        return f"it has {int(model.actuator_ctrlnum[index])} controls, where a plan has one"
    dc_motor = int(model.actuator_dyntype[index]) == DC_MOTOR
    if not dc_motor and (gain not in (FIXED, AFFINE) or bias not in (NO_BIAS, AFFINE_BIAS)):
        return "its gain or bias is not affine"
    if is_gas_spring(model, index):
        of = "a constant force" if kind == TRN_SITE else "a passive force, such as a gas spring's"
        return f"it has no gain: {of}"
    if _coefficients(model, index)[0][0] == 0.0:
        return "its gain vanishes at rest"
    if not np.any(gear_of(model, index)):
        return "its gear is zero"
    if has_length(model, index) and kind != TRN_SITE and gear_of(model, index)[0] == 0.0:
        return "the first number of its gear is zero, and on a hinge, slide or tendon only that number counts"
    if kind == TRN_TENDON and lacks_length(model, int(model.actuator_trnid[index, 0])):
        return f"its tendon {LACKING}"
    depends = any(any(terms[1:]) for terms in _coefficients(model, index))  # on the length or velocity at a given ctrl
    if depends and not has_length(model, index):
        return "it is a servo on a rotation, whose length MuJoCo wraps to one turn"
    return None


def _is_line(model: mujoco.MjModel, index: int) -> bool:
    """Return True if a DC motor without state has no more than a resistance and a motor constant: a torque-speed line."""
    further = (model.actuator_gainprm[index, 2:], model.actuator_biasprm[index], model.actuator_dynprm[index])
    return not any(np.any(numbers) for numbers in further)


def _coefficients(model: mujoco.MjModel, index: int) -> tuple[Triple, Triple]:
    """Return the gains and biases on 1, length and speed: force = gains . state ctrl + biases . state.

    A DC motor without state, of resistance R and constant K, gives K (ctrl - K speed) / R.
    """
    if int(model.actuator_dyntype[index]) == DC_MOTOR:
        resistance, constant = (float(x) for x in model.actuator_gainprm[index, :2])
        return (constant / resistance, 0.0, 0.0), (0.0, 0.0, -(constant**2) / resistance)
    gain, bias = model.actuator_gainprm[index, :3], model.actuator_biasprm[index, :3]
    fixed = int(model.actuator_gaintype[index]) == FIXED
    on_one, on_length, on_speed = (float(g) if k == 0 or not fixed else 0.0 for k, g in enumerate(gain))
    biased = int(model.actuator_biastype[index]) == AFFINE_BIAS
    return (on_one, on_length, on_speed), ((float(bias[0]), float(bias[1]), float(bias[2])) if biased else (0.0, 0.0, 0.0))


def is_idle_at_zero(model: mujoco.MjModel, index: int) -> bool:
    """Return True if an actuator at zero control has no effect that the planner does not model."""
    if int(model.actuator_plugin[index]) >= 0:
        return switched_off(model, index)
    if is_gas_spring(model, index):
        on_site = int(model.actuator_trntype[index]) == int(TRN_SITE)
        return passive_terms_modelled(model, index) or (on_site and not has_passive_terms(model, index))
    gain, bias = int(model.actuator_gaintype[index]), int(model.actuator_biastype[index])
    affine = gain in (FIXED, AFFINE) and (
        bias == NO_BIAS or (bias == AFFINE_BIAS and not any(_coefficients(model, index)[1]))
    )
    return (affine or switched_off(model, index)) and (
        passive_terms_modelled(model, index) or not has_passive_terms(model, index)
    )


def has_passive_terms(model: mujoco.MjModel, index: int) -> bool:
    """Return True if an actuator has damping or armature of its own."""
    own = [model.actuator_damping[index], *model.actuator_dampingpoly[index], model.actuator_armature[index]]
    return bool(np.any(own))


def passive_terms_modelled(model: mujoco.MjModel, index: int) -> bool:
    """Return True if the tree includes an actuator's passive forces and armature: on a hinge, slide or most tendons."""
    if int(model.actuator_trntype[index]) == int(TRN_TENDON):
        return not lacks_length(model, int(model.actuator_trnid[index, 0]))
    on_joint = attachment(model, index)
    return on_joint.dof is not None


def read_actuators(model: mujoco.MjModel) -> tuple[Actuator, ...]:
    """Return the actuators of a model that a plan can use, in file order."""
    return tuple(_read(model, index) for index in range(model.nactuator) if unusable_reason(model, index) is None)


def effort_matrix(model: mujoco.MjModel, tree: Tree, actuators: tuple[Actuator, ...]) -> ca.SX:
    """Return B (n_q, n_u), whose columns are the generalised forces of unit efforts, an expression of tree.q."""
    columns = [moment(model, tree, actuator.index) for actuator in actuators]
    return ca.sparsify(ca.horzcat(ca.SX(tree.q.numel(), 0), *columns))


def lengths(model: mujoco.MjModel, tree: Tree, actuators: tuple[Actuator, ...]) -> ca.SX:
    """Return the actuators' lengths (n_u,) [rad or m]; NaN for sites and slider-cranks."""
    found = []
    for actuator in actuators:
        first = int(model.actuator_trnid[actuator.index, 0])
        gear = model.actuator_gear[model.actuator_outadr[actuator.index], 0]
        if actuator.joint is not None:
            found.append(gear * tree.q[actuator.joint])
        elif int(model.actuator_trntype[actuator.index]) == int(TRN_TENDON):
            found.append(gear * tree.tendon_lengths[first])
        else:
            found.append(ca.SX(np.nan))
    return ca.vertcat(ca.SX(0, 1), *found)


def _read(model: mujoco.MjModel, index: int) -> Actuator:
    gains, biases = _coefficients(model, index)
    channel, at = int(model.actuator_ctrladr[index]), attachment(model, index)
    clamp = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    lower, upper = -np.inf, np.inf
    if model.actuator_ctrllimited[channel] and clamp:
        lower, upper = (float(x) for x in model.actuator_ctrlrange[channel])
    bounds = list(_clamps(model, index))
    if not any(gains[1:]) and not any(biases[1:]):
        least, most = sorted((lower * gains[0] + biases[0], upper * gains[0] + biases[0]))
        bounds.append((least, most))
    if model.actuator_forcelimited[index]:
        bounds.append(_scaled(model.actuator_forcerange[index], 1.0))
    return Actuator(
        name=label(model, index),
        index=index,
        channel=channel,
        output=int(model.actuator_outadr[index]),
        joint=at.dof,
        target=at.target,
        gear=float(gear_of(model, index)[0]),
        gains=gains,
        biases=biases,
        control_lower=lower,
        control_upper=upper,
        lower=max((lo for lo, _ in bounds), default=-np.inf),
        upper=min((hi for _, hi in bounds), default=np.inf),
        unit=at.unit,
        has_length=at.dof is not None or int(model.actuator_trntype[index]) == int(TRN_TENDON),
    )


def constant_arms(model: mujoco.MjModel, index: int) -> dict[int, float]:
    """Return an actuator's constant moment arms by coordinate, empty unless it acts on a hinge, slide or fixed tendon."""
    gear, at = float(gear_of(model, index)[0]), attachment(model, index)
    if at.dof is not None:
        return {at.dof: gear}
    tendon = int(model.actuator_trnid[index, 0])
    if int(model.actuator_trntype[index]) == int(TRN_TENDON) and is_fixed(model, tendon):
        return {dof: gear * c for dof, c in tendon_joints(model, tendon).items() if c}
    return {}


def _clamps(model: mujoco.MjModel, index: int):
    """Yield the effort limits of an actuator with constant moment arms that follow from joint and tendon clamps."""
    tendon = int(model.actuator_trnid[index, 0])
    if int(model.actuator_trntype[index]) == int(TRN_TENDON) and model.tendon_actfrclimited[tendon]:
        yield _scaled(model.tendon_actfrcrange[tendon], 1.0)
    for dof, arm in constant_arms(model, index).items():
        joint = int(model.dof_jntid[dof])
        if model.jnt_actfrclimited[joint]:
            yield _scaled(model.jnt_actfrcrange[joint], 1.0 / arm)


def _scaled(interval: np.ndarray, factor: float) -> tuple[float, float]:
    ends = sorted(float(end) * factor for end in interval)
    return ends[0], ends[1]


def shared_clamps(model: mujoco.MjModel) -> list[str]:
    """Return descriptions of the joint and tendon clamps that no limit of a single actuator can represent.

    MuJoCo clamps the sum of the efforts on a joint or tendon, while a plan limits each effort on its own.
    """
    usable = [index for index in range(model.nactuator) if unusable_reason(model, index) is None]
    found: list[tuple[str, list[int]]] = []
    for joint in np.flatnonzero(model.jnt_actfrclimited).tolist():
        if int(model.jnt_type[joint]) not in (HINGE, SLIDE):
            continue
        dof = int(model.jnt_dofadr[joint])
        acting = [index for index in usable if dof in (constant_arms(model, index) or range(model.nv))]
        if len(acting) > 1 or any(not constant_arms(model, index) for index in acting):
            found.append((f"joint {joint_label(model, joint)}", acting))
    on_tendon = [index for index in usable if int(model.actuator_trntype[index]) == int(TRN_TENDON)]
    for tendon in np.flatnonzero(model.tendon_actfrclimited).tolist():
        acting = [index for index in on_tendon if int(model.actuator_trnid[index, 0]) == tendon]
        if len(acting) > 1:
            found.append((f"tendon {tendon_label(model, tendon)}", acting))
    return [
        f"actuatorfrcrange of {target}, which limits the sum of {', '.join(label(model, index) for index in acting)}"
        for target, acting in found
    ]
