"""The elements of a model that the reduced dynamics leave out. Each is reported by name."""

from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import (
    has_passive_terms,
    is_idle_at_zero,
    label,
    passive_terms_modelled,
    read_actuators,
    shared_clamps,
    unusable_reason,
)
from linkplan.models.actuation.transmission import attachment
from linkplan.models.closure.equations import equality_name
from linkplan.models.kinematics import disabled
from linkplan.models.tree.coordinates import BALL, FREE, joint_label
from linkplan.models.tree.dynamics import build_tree
from linkplan.models.tree.passive import compensates, is_gas_spring, limits_off, spans_branches, tendon_armatures
from linkplan.models.tree.tendons import LACKING, lacks_length, tendon_label


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class UnsupportedElement:
    """One element that is left out. `falsifies` is True if motions planned without it are wrong."""

    text: str
    falsifies: bool


def audit(model: mujoco.MjModel) -> tuple[UnsupportedElement, ...]:
    """Return every element of a model that the reduced dynamics leave out, except for contacts, which depend on the pose."""
    false = [*_joints(model), *_tendons(model), *_surroundings(model), *shared_clamps(model)]
    found = [*((text, True) for text in false), *_actuators(model), *((text, False) for text in _equalities(model))]
    return tuple(UnsupportedElement(text=text, falsifies=falsifies) for text, falsifies in found)


def _joints(model: mujoco.MjModel):
    for joint in range(model.njnt):
        name, dof, kind = joint_label(model, joint), int(model.jnt_dofadr[joint]), int(model.jnt_type[joint])
        if model.jnt_springyield[joint] > 0:
            yield f"springyield of joint {name}"
        if kind in (BALL, FREE):
            sort = "ball joint" if kind == BALL else "free joint"
            if model.jnt_stiffness[joint] or np.any(model.jnt_stiffnesspoly[joint]):
                yield f"stiffness of {sort} {name}"
            if np.any(model.dof_dampingpoly[dof]):
                yield f"quadratic or cubic damping of {sort} {name}"


def _tendons(model: mujoco.MjModel):
    armatures = tendon_armatures(model)
    tree = build_tree(model) if any(armatures) else None
    for tendon in range(model.ntendon):
        name = tendon_label(model, tendon)
        if model.tendon_springyield[tendon] > 0:
            yield f"springyield of tendon {name}"
        if lacks_length(model, tendon):
            limited = model.tendon_limited[tendon] and not limits_off(model)
            forces = [
                ("limit", limited),
                ("stiffness", model.tendon_stiffness[tendon] or np.any(model.tendon_stiffnesspoly[tendon])),
                ("damping", model.tendon_damping[tendon] or np.any(model.tendon_dampingpoly[tendon])),
                ("armature", armatures[tendon] > 0),
                ("frictionloss", model.tendon_frictionloss[tendon] > 0),
            ]
            of = f"of tendon {name}, which {LACKING}"
            yield from (f"{what} {of}" for what, present in forces if present)
        elif tree and armatures[tendon] > 0 and (length := tree.tendon_lengths[tendon]) is not None:
            if not spans_branches(model, length, tree.q):
                continue
            yield f"armature of tendon {name}: it couples two branches of the tree, which the simulator's inertia leaves out"


def _surroundings(model: mujoco.MjModel):
    # MuJoCo clamps gravity compensation together with the sum of the efforts on a joint with actuatorgravcomp.
    clamped = [joint_label(model, j) for j in range(model.njnt) if model.jnt_actgravcomp[j] and model.jnt_actfrclimited[j]]
    if clamped and (bodies := np.flatnonzero(model.body_gravcomp[1:]) + 1).size:
        more = f" and {len(bodies) - 1} more" if len(bodies) > 1 else ""
        yield (
            f"gravcomp of body {model.body(bodies[0]).name}{more}, clamped by the actuatorfrcrange of joint"
            f" {clamped[0]}{f' and {len(clamped) - 1} more' if len(clamped) > 1 else ''}: without their actuatorgravcomp it"
            " acts in full"
        )
    if compensates(model) and (model.nactuator == 0 or disabled(model, mujoco.mjtDisableBit.mjDSBL_ACTUATION)):
        for joint in np.flatnonzero(model.jnt_actgravcomp).tolist():  # the simulator drops it if no actuator acts
            name = joint_label(model, joint)
            yield f"gravcomp carried by the actuators of joint {name} (actuatorgravcomp), where no actuator acts"
    if model.opt.density > 0 or model.opt.viscosity > 0:  # wind alone has no effect
        yield "fluid forces (option density or viscosity)"
    if model.nflex:
        yield f"{model.nflex} flex"
    for body in np.flatnonzero(model.body_plugin >= 0).tolist():  # actuators report their own
        yield f"the plugin of body {model.body(body).name}"
    if model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP):
        for tree in np.flatnonzero(model.tree_sleep_policy == int(mujoco.mjtSleepPolicy.mjSLEEP_INIT)).tolist():
            body = int(np.flatnonzero(model.body_treeid == tree)[0])
            yield f'sleep="init" of body {model.body(body).name}: the simulator leaves it and what it carries asleep'


def _actuators(model: mujoco.MjModel):
    """Yield the text on an actuator, and True if it falsifies plans."""
    for index in range(model.nactuator):
        reason = unusable_reason(model, index)
        if reason is None:
            continue
        idle = is_idle_at_zero(model, index)
        kind = mujoco.mjtTrn(int(model.actuator_trntype[index])).name.removeprefix("mjTRN_").lower()
        left = "leave it idle at zero control" if idle else "leave it out, though it acts at zero control too"
        left = "include it" if idle and is_gas_spring(model, index) else left
        where = f"actuator {label(model, index)} on {attachment(model, index).target} ({kind} transmission)"
        yield f"{where}: {reason}; plans {left}", not idle
    for actuator in read_actuators(model):
        if has_passive_terms(model, actuator.index) and not passive_terms_modelled(model, actuator.index):
            where = f"damping or armature of actuator {actuator.name} on {actuator.target}"
            yield f"{where}: plans contain its effort but not these forces", True
        if not actuator.is_servo:
            continue
        limits = "" if np.isfinite([actuator.lower, actuator.upper]).all() else ", which no forcerange limits"
        within = ""
        if np.isfinite([actuator.control_lower, actuator.control_upper]).any():
            within = f", clamped to its ctrlrange {actuator.control_lower:g} to {actuator.control_upper:g}"
        computed = f"its ctrl is computed from that effort, its gain and its bias{within}"
        yield f"actuator {actuator.name} is a servo: a plan commands its effort{limits}, and {computed}", False


def _equalities(model: mujoco.MjModel):
    for index in range(model.neq):
        if disabled(model, mujoco.mjtDisableBit.mjDSBL_EQUALITY, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT):
            yield f"equality constraint {equality_name(model, index)} is switched off by a flag of the model's option"
        elif not model.eq_active0[index]:
            yield f"equality constraint {equality_name(model, index)} is inactive"
