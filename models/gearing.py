"""Another motor behind an actuator: its gear and the inertia of its rotor, in MuJoCo's meaning of both.

The motor's position is gear times the position of the joint, tendon or slider-crank that the actuator drives. On these its
effort u is gear u, and its rotor of inertia J is gear^2 J, which MuJoCo adds to the mass matrix (armature of the actuator).
"""

from collections.abc import Mapping

import mujoco

from linkplan.models.errors import ModelError, choose
from linkplan.models.kinematics import HINGE, SLIDE

_ON_JOINTS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


def set_gearing(spec: mujoco.MjSpec, gear: Mapping[str, float], rotor_inertia: Mapping[str, float]) -> list[str]:
    """Give actuators by name a gear and a rotor [kg m2, or kg], and return notes on the armature of their joints.

    Raises:
        ModelError: for an unknown actuator, a gear of 0, or one that acts on anything but a hinge, slide, tendon or
            slider-crank; also for a rotor on a slider-crank.
    """
    actuators = {one.name or f"actuator {index}": one for index, one in enumerate(spec.actuators)}
    for name, ratio in gear.items():
        one = actuators[choose("actuator in mechanism.gear", name, actuators)]
        if not ratio:
            raise ModelError(f"mechanism.gear.{name} must be a number other than 0, got {ratio:g}")
        if not _has_one_ratio(spec, one) and one.trntype != mujoco.mjtTrn.mjTRN_SLIDERCRANK:
            raise ModelError(f"mechanism.gear.{name}: the actuator acts on {_target(one)}, which no single gear moves")
        one.gear = [ratio, *one.gear[1:]]
    notes = []
    for name, inertia in rotor_inertia.items():
        one = actuators[choose("actuator in mechanism.rotor_inertia", name, actuators)]
        if not _has_one_ratio(spec, one):
            raise ModelError(
                f"mechanism.rotor_inertia.{name}: the actuator acts on {_target(one)}; a rotor turns with a hinge, a slide"
                " or a tendon"
            )
        one.armature = inertia
        joint = spec.joint(one.target) if one.trntype in _ON_JOINTS else None
        if joint is not None and joint.armature:
            notes.append(
                f"joint {joint.name} has an armature of {float(joint.armature):g} in the model, which is added to the rotor"
                f" of {name}"
            )
    return notes


def _has_one_ratio(spec: mujoco.MjSpec, one: mujoco.MjsActuator) -> bool:
    """Return True if an actuator acts on a hinge, a slide or a tendon."""
    if one.trntype in _ON_JOINTS:
        return int(spec.joint(one.target).type) in (HINGE, SLIDE)
    return one.trntype == mujoco.mjtTrn.mjTRN_TENDON


def _target(one: mujoco.MjsActuator) -> str:
    return f"{one.trntype.name.removeprefix('mjTRN_').lower()} '{one.target}'"
