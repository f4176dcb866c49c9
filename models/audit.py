"""What a model says that the reduced dynamics do not honour: named one by one, never dropped in silence."""

from dataclasses import dataclass

import mujoco
import numpy as np

from models.actuators import is_motor
from models.tree import JOINT_TRANSMISSIONS


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Unhonoured:
    """One element that is left out. `falsifies` says whether motions planned without it would be wrong."""

    text: str
    falsifies: bool


def audit(model: mujoco.MjModel) -> tuple[Unhonoured, ...]:
    """Return every element of a model that the reduced dynamics leave out (contacts are for the pose to show)."""
    found: list[Unhonoured] = []

    def add(text: str, falsifies: bool = True) -> None:
        found.append(Unhonoured(text=text, falsifies=falsifies))

    for joint in range(model.njnt):
        name, dof = model.joint(joint).name or f"joint{joint}", int(model.jnt_dofadr[joint])
        if model.dof_frictionloss[dof] > 0:
            add(f"frictionloss {model.dof_frictionloss[dof]:g} of joint {name}")
        if model.jnt_springyield[joint] > 0:
            add(f"springyield of joint {name}")
    for tendon in range(model.ntendon):
        name = model.tendon(tendon).name or f"tendon {tendon}"
        forces = [
            ("stiffness", model.tendon_stiffness[tendon] > 0),
            ("damping", model.tendon_damping[tendon] > 0),
            ("frictionloss", model.tendon_frictionloss[tendon] > 0),
            ("armature", model.tendon_armature[tendon] > 0),
            ("limit", bool(model.tendon_limited[tendon])),
        ]
        for what, present in forces:
            if present:
                add(f"{what} of tendon {name}")
    for body in range(1, model.nbody):
        if model.body_gravcomp[body] != 0:
            add(f"gravcomp of body {model.body(body).name or body}")
    if model.opt.density > 0 or model.opt.viscosity > 0 or np.any(model.opt.wind != 0):
        add("fluid forces (option density, viscosity or wind)")
    if model.nflex:
        add(f"{model.nflex} flex")
    if model.nplugin:
        add(f"{model.nplugin} plugin instance(s)")
    for index in range(model.nu):
        if is_motor(model, index):
            continue
        name = model.actuator(index).name or f"actuator {index}"
        passive = [model.actuator_damping[index], *model.actuator_dampingpoly[index], model.actuator_armature[index]]
        on_joint = int(model.actuator_trntype[index]) in JOINT_TRANSMISSIONS  # whose passive part the tree carries
        idle = int(model.actuator_biastype[index]) == int(mujoco.mjtBias.mjBIAS_NONE) and (on_joint or not np.any(passive))
        transmission = mujoco.mjtTrn(int(model.actuator_trntype[index])).name.removeprefix("mjTRN_").lower()
        gain = mujoco.mjtGain(int(model.actuator_gaintype[index])).name.removeprefix("mjGAIN_").lower()
        add(
            f"actuator {name} ({transmission} transmission, {gain} gain) is not a motor at work on a joint: plans leave it"
            f" {'idle at zero control' if idle else 'out, though it acts at zero control too'}",
            falsifies=not idle,
        )
    for index in range(model.neq):
        if not model.eq_active0[index]:
            add(f"equality constraint {model.equality(index).name or index} is inactive and stays so", falsifies=False)
    return tuple(found)
