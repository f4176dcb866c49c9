"""The serial equivalent as URDF, with <transmission> elements if the linkage has a constant ratio.

A URDF is a tree of links with joints of one axis, without armature, springs and coupled limits. A transmission of one joint
(SimpleTransmission) has one ratio: motor position = reduction (joint position - offset). Comments in the file and the record
state what a URDF cannot express; the tables contain it.
"""

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import mujoco
import numpy as np

from linkplan.models.transfer.polytope import speed_box
from linkplan.models.transfer.serial import SerialModel
from linkplan.models.tree.coordinates import joint_label
from linkplan.models.tree.passive import is_gas_spring
from linkplan.studies.handover.transfer.study import Transfer

# A ratio that changes by less than this share over the table is constant except for rounding.
_CONSTANT_SHARE = 1e-6
_KINDS = {
    mujoco.mjtJoint.mjJNT_HINGE: "revolute",
    mujoco.mjtJoint.mjJNT_SLIDE: "prismatic",
    mujoco.mjtJoint.mjJNT_FREE: "floating",
}
_INTERFACE = "hardware_interface/EffortJointInterface"
# The speed limit if it is unknown: the format requires one, and zero would lock the joint in some programs.
_UNKNOWN_SPEED = "1000"


def reductions(transfer: Transfer) -> list[tuple[int, float, float]]:
    """Return the joints' motors (index, reduction and offset [rad or m]), if the ratios are constant.

    The result is empty if G changes over the table, is not square, or couples the joints.
    """
    table = transfer.table
    ratio = table.grid.values["ratio"][table.known]  # (n, n_m, n_o)
    mean, n_o = ratio.mean(axis=0), ratio.shape[2]
    if ratio.shape[1] != n_o or not table.known.any() or not all(one.has_length for one in transfer.outputs.actuators):
        return []
    rounding = _CONSTANT_SHARE * np.abs(mean).max()
    if np.abs(ratio - mean).max() > rounding or np.sum(np.abs(mean) > rounding) != n_o:
        return []
    motors = np.argmax(np.abs(mean), axis=0)
    if len(set(motors.tolist())) < n_o:
        return []
    home = transfer.outputs.home
    found = []
    for k, j in enumerate(motors.tolist()):
        reduction = float(mean[j, k])
        found.append((j, reduction, float(home[k] - transfer.home.motor_position[0, j] / reduction)))
    return found


def urdf_notes(transfer: Transfer) -> list[str]:
    """Return sentences on what the URDF of a serial equivalent lacks compared with the MJCF."""
    serial, table = transfer.serial, transfer.table
    model, joints = serial.model.mechanism.model, transfer.outputs.joints
    if _has_ball(model):
        return ["there is none: a URDF has no ball joint"]
    carried = [f"{one.name} {x:.6g} {one.inertia_unit}" for one, x in zip(joints, serial.model.armature, strict=True)]
    armature = ", ".join(carried)
    found = [f"a URDF has no armature: set the joints' armature to {armature} in the simulator"]
    if not reductions(transfer):
        ratio = table.grid.values["ratio"][table.known]
        span = np.ptp(ratio, axis=0).max() / np.abs(ratio).max()
        why = f"G changes by {100 * span:.2g} % of its size" if span > _CONSTANT_SHARE else "G couples the joints"
        found.append(f"no <transmission>, which has one constant ratio: {why}; the tables have the ratio")
    if transfer.motor_speed is None or not np.isfinite(_speeds(transfer)).all():
        found.append(f"speed limits are {_UNKNOWN_SPEED} if the motors' speeds are not given")
    lacking = {
        "springs of joints": bool(np.any(model.jnt_stiffness)),
        "gas springs": any(is_gas_spring(model, a) for a in range(model.nactuator)),
        "closures of other loops": model.neq > 0,
        "shapes other than boxes, spheres, cylinders and capsules": None in [_shape(model, g) for g in range(model.ngeom)],
    }
    found += [f"{what} are omitted" for what, there in lacking.items() if there]
    if np.any(model.body_jntnum > 1):
        found.append("a link of 1e-6 kg and 1e-9 kg m2 is added between two joints of one body")
    return found


def urdf_text(transfer: Transfer) -> str | None:
    """Return the serial equivalent as URDF; None if it has a ball joint, which a URDF cannot have."""
    serial: SerialModel = transfer.serial.model
    model = serial.mechanism.model
    if _has_ball(model):
        return None
    root = ET.Element("robot", name=serial.mechanism.name)
    root.append(ET.Comment(" " + "; ".join(note.replace("--", "- -") for note in urdf_notes(transfer)) + " "))
    given = [model.body(k).name or (f"body_{k}" if k else "world") for k in range(model.nbody)]
    names = [name if given.index(name) == k else f"{name}_{k}" for k, name in enumerate(given)]
    shift = np.zeros((model.nbody, 3))  # a link's origin in its body
    limits = _limits(transfer)
    for body in range(model.nbody):
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        parent = int(model.body_parentid[body])
        if body and not joints:
            pose = (model.body_pos[body] - shift[parent], model.body_quat[body])
            _joint(root, f"{names[body]}_fixed", "fixed", names[parent], names[body], pose)
        above, before = names[parent], None
        for place, joint in enumerate(joints):
            below = names[body] if place == len(joints) - 1 else f"{names[body]}_{place}"
            anchor = model.jnt_pos[joint]
            if before is not None:
                pose = anchor - before, np.array([1.0, 0, 0, 0])
            else:  # of the body's first joint in its parent's link
                turned = np.zeros(3)
                mujoco.mju_rotVecQuat(turned, anchor, model.body_quat[body])
                pose = model.body_pos[body] + turned - shift[parent], model.body_quat[body]
            kind = _KINDS[mujoco.mjtJoint(model.jnt_type[joint])]
            element = _joint(root, joint_label(model, joint), kind, above, below, pose)
            if kind != "floating":
                _moving(element, model, joint, limits)
            if below != names[body]:
                _inertial(ET.SubElement(root, "link", name=below), np.zeros(3), np.array([1.0, 0, 0, 0]), 1e-6, [1e-9] * 3)
            above, before = below, anchor
        shift[body] = 0.0 if before is None else before
        root.append(_link(model, body, names[body], shift[body]))
    for joint, (motor, reduction, offset) in zip(transfer.outputs.joints, reductions(transfer), strict=False):
        _transmission(root, joint.name, transfer.outputs.actuators[motor].name, reduction, offset)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _has_ball(model: mujoco.MjModel) -> bool:
    return bool(np.any(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL))


def _speeds(transfer: Transfer) -> np.ndarray:
    """Return the joints' largest speeds (n_o,) at home, infinite where unknown."""
    speed, ratio = transfer.motor_speed, transfer.home.ratio
    if speed is None or ratio.shape[1] != ratio.shape[2]:
        return np.full(ratio.shape[2], np.inf)
    found = speed_box(ratio, speed)[0]
    return np.where(np.isfinite(found), found, np.inf)


def _limits(transfer: Transfer) -> dict[str, tuple[float, float]]:
    """Return the effort and speed limits by name of the output joints and of other joints with a motor."""
    mechanism = transfer.serial.model.mechanism
    speeds = {one.name: v for one, v in zip(transfer.outputs.joints, _speeds(transfer).tolist(), strict=True)}
    found = {}
    for motor, limit in zip(mechanism.actuators, mechanism.effort_limit, strict=True):
        if motor.joint is not None:
            name = mechanism.joints[motor.joint].name
            found[name] = (abs(motor.gear) * float(np.abs(limit).max()), speeds.get(name, np.inf))
    return found


def _moving(element: ET.Element, model: mujoco.MjModel, joint: int, limits: dict[str, tuple[float, float]]) -> None:
    """Add axis, limits and losses of a joint; a URDF's position is zero in MuJoCo's reference pose."""
    dof, reference = model.jnt_dofadr[joint], model.qpos0[model.jnt_qposadr[joint]]
    ET.SubElement(element, "axis", xyz=_numbers(model.jnt_axis[joint]))
    effort, speed = limits.get(model.joint(joint).name, (0.0, np.inf))
    limit = {"effort": f"{effort:.17g}" if np.isfinite(effort) else "1e30"}
    limit["velocity"] = f"{speed:.17g}" if np.isfinite(speed) else _UNKNOWN_SPEED
    if model.jnt_limited[joint]:
        lower, upper = model.jnt_range[joint] - reference
        limit |= {"lower": f"{lower:.17g}", "upper": f"{upper:.17g}"}
    elif element.get("type") == "revolute":
        element.set("type", "continuous")
    else:
        limit |= {"lower": "-1e3", "upper": "1e3"}
    ET.SubElement(element, "limit", limit)
    losses = {"damping": model.dof_damping.reshape(model.nv, -1)[dof, 0], "friction": model.dof_frictionloss[dof]}
    if any(losses.values()):
        ET.SubElement(element, "dynamics", {key: f"{value:.17g}" for key, value in losses.items()})


def _joint(root: ET.Element, name: str, kind: str, parent: str, child: str, pose: tuple) -> ET.Element:
    element = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)
    _origin(element, *pose)
    return element


def _link(model: mujoco.MjModel, body: int, name: str, shift: np.ndarray) -> ET.Element:
    """Return a body as a link whose origin is `shift` in the body."""
    link = ET.Element("link", name=name)
    if body and model.body_mass[body] > 0:
        pose = (model.body_ipos[body] - shift, model.body_iquat[body])
        _inertial(link, *pose, model.body_mass[body], model.body_inertia[body])
    for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        for part, tag in itertools.product(_shape(model, geom) or (), ("visual", "collision") if touches else ("visual",)):
            element = ET.SubElement(link, tag)
            offset = np.zeros(3)
            mujoco.mju_rotVecQuat(offset, np.array([0.0, 0.0, part[2]]), model.geom_quat[geom])
            _origin(element, model.geom_pos[geom] + offset - shift, model.geom_quat[geom])
            ET.SubElement(ET.SubElement(element, "geometry"), part[0], {k: str(v) for k, v in part[1].items()})
    return link


def _inertial(link: ET.Element, position: np.ndarray, turn: np.ndarray, mass: float, inertia: Sequence[float]) -> None:
    element = ET.SubElement(link, "inertial")
    _origin(element, position, turn)
    ET.SubElement(element, "mass", value=f"{mass:.17g}")
    xx, yy, zz = (f"{x:.17g}" for x in inertia)
    ET.SubElement(element, "inertia", ixx=xx, iyy=yy, izz=zz, ixy="0", ixz="0", iyz="0")


def _shape(model: mujoco.MjModel, geom: int) -> list[tuple[str, dict[str, str], float]] | None:
    """Return a geom as URDF shapes (tag, sizes, position along its axis); None if URDF has no such shape."""
    a, b, c = (float(x) for x in model.geom_size[geom])
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return [("sphere", {"radius": f"{a:.17g}"}, 0.0)]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return [("box", {"size": _numbers([2 * a, 2 * b, 2 * c])}, 0.0)]
    tube = [("cylinder", {"radius": f"{a:.17g}", "length": f"{2 * b:.17g}"}, 0.0)]
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return tube
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return [*tube, *(("sphere", {"radius": f"{a:.17g}"}, end) for end in (-b, b))]
    return None


def _transmission(root: ET.Element, joint: str, motor: str, reduction: float, offset: float) -> None:
    element = ET.SubElement(root, "transmission", name=f"{joint}_transmission")
    ET.SubElement(element, "type").text = "transmission_interface/SimpleTransmission"
    at_joint = ET.SubElement(element, "joint", name=joint)
    ET.SubElement(at_joint, "hardwareInterface").text = _INTERFACE
    ET.SubElement(at_joint, "offset").text = f"{offset:.17g}"
    at_motor = ET.SubElement(element, "actuator", name=motor)
    ET.SubElement(at_motor, "hardwareInterface").text = _INTERFACE
    ET.SubElement(at_motor, "mechanicalReduction").text = f"{reduction:.17g}"


def _origin(element: ET.Element, position: np.ndarray, quaternion: np.ndarray) -> None:
    """Add the origin of an element: roll, pitch and yaw about fixed axes."""
    import scipy.spatial.transform

    turn = scipy.spatial.transform.Rotation.from_quat(np.roll(quaternion, -1))
    matrix = turn.as_matrix()
    pitch = np.arctan2(-matrix[2, 0], np.hypot(matrix[0, 0], matrix[1, 0]))
    if np.hypot(matrix[0, 0], matrix[1, 0]) > 1e-9:
        roll, yaw = np.arctan2(matrix[2, 1], matrix[2, 2]), np.arctan2(matrix[1, 0], matrix[0, 0])
    else:  # only their sum or difference is determined
        roll, yaw = np.arctan2(-matrix[1, 2], matrix[1, 1]), 0.0
    ET.SubElement(element, "origin", xyz=_numbers(position), rpy=_numbers([roll, pitch, yaw]))


def _numbers(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{float(x):.17g}" for x in values)
