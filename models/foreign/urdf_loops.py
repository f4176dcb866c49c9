"""Loops, drives and joint types beside a URDF's tree, in elements or in a YAML file, which MuJoCo ignores.

linkplan reads `<loop_joint>` elements (Drake's), joints in `<gazebo>` elements, frames named closing_NAME_1 and
closing_NAME_2 (onshape-to-robot's), `<transmission>` and `<ros2_control>` elements, and the YAML files of
example-parallel-robots and of the SolidWorks exporter sw2robot. Frames that only mark a closure stay bodies of their own.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import msgspec
import mujoco
import numpy as np

from linkplan.models.catalogue import is_text
from linkplan.models.errors import ModelError, choose, listed
from linkplan.models.extras import load_extra
from linkplan.models.foreign.conversion import CLOSING, GazeboJoint, gazebo_joints, numbers_of
from linkplan.models.foreign.urdf_links import settle_links
from linkplan.models.kinematics import data_at, in_body, rotation_of_rpy
from linkplan.models.reading import read_file

_MOST_YAML_BYTES = 1_000_000
Table = TypeVar("Table", bound=msgspec.Struct)
_CONNECT, _WELD = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD
_AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
# The sources of closures and motors, as notes name them.
_BESIDE, _CUT = "the YAML file beside the URDF", "loop_closures.yaml"
_CLOSING = re.compile(r"closing_(.+)_[12]")
# The distance [m] of a hinge's two points.
_HINGE_WIDTH_M = 0.05
# Kinds of actuators whose force follows their control by a filter.
FILTERS = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)


class Beside(msgspec.Struct, frozen=True):
    """The YAML file of example-parallel-robots; other keys are ignored."""

    closed_loop: list[tuple[str, str]] = []
    type: list[str] = []
    name_mot: list[str] = []
    joint_name: list[str] = []
    joint_type: list[str] = []


class CutHinge(msgspec.Struct, frozen=True):
    """A hinge that was cut: a point [m] on its axis and the axis (3,), in the root link's frame at zero positions."""

    link_a: str
    link_b: str
    point: tuple[float, float, float]
    axis: tuple[float, float, float]


class LoopClosures(msgspec.Struct, frozen=True):
    """The file loop_closures.yaml of sw2robot: cut hinges, and the joints that are driven; other keys are ignored."""

    closures: list[CutHinge]
    independent: list[str] = []


def beside(path: Path) -> Beside | None:
    """Return the closures and motors of the YAML file with a URDF's name, or of the only one beside the only URDF.

    Raises:
        ModelError: for a file that has one of its keys but not its form.
    """
    place = path.with_suffix(".yaml")
    others = list(path.parent.glob("*.yaml"))
    if not place.is_file() and len(others) == 1 and len(list(path.parent.glob("*.urdf"))) == 1:
        place = others[0]
    asked = _table(place, Beside, {"closed_loop", "name_mot"})
    if asked is None:
        return None
    for names, kinds in (("closed_loop", "type"), ("joint_name", "joint_type")):
        count, of = len(getattr(asked, names)), len(getattr(asked, kinds))
        if of != count and (of or kinds == "joint_type"):
            raise ModelError(f"'{place}' has {count} entries in {names} and {of} in {kinds}; they belong together")
    return asked


def loop_closures(path: Path) -> LoopClosures | None:
    """Return the cut hinges of the file loop_closures.yaml in a URDF's folder, in the folder above or in its config.

    Raises:
        ModelError: for a file with closures in another form.
    """
    folders = (path.parent, path.parent.parent, path.parent.parent / "config")
    place = next((one for folder in folders if (one := folder / "loop_closures.yaml").is_file()), None)
    return None if place is None else _table(place, LoopClosures, {"closures"})


def _table(place: Path, kind: type[Table], keys: set[str]) -> Table | None:
    """Return a YAML file as a table; None if it is missing or has none of the keys."""
    if not place.is_file():
        return None
    text = read_file(place, f"'{place}'", _MOST_YAML_BYTES, ModelError).decode("utf-8", "replace")
    yaml = load_extra("yaml", f"the closures in '{place}'")
    try:
        found = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ModelError(f"'{place}' is not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(found, dict) or not found.keys() & keys:
        return None
    try:
        return msgspec.convert(found, kind)
    except msgspec.ValidationError as error:
        raise ModelError(f"'{place}' does not describe closures of a URDF: {error}") from error


def complete(spec: mujoco.MjSpec, source: str | Path, root: ET.Element) -> tuple[str, ...]:
    """Add the parts of a URDF that MuJoCo ignored to its specification, and return notes on their sources.

    Args:
        spec: MuJoCo's conversion of the URDF, which is changed.
        source: the URDF's path or text.
        root: its <robot> element.

    Raises:
        ModelError: for an element or a key that names no link, frame or joint.
    """
    path = None if is_text(str(source)) else Path(source)
    named, cut = (None, None) if path is None else (beside(path), loop_closures(path))
    named, cut = named or Beside(), cut or LoopClosures(closures=[])
    notes = settle_links(spec, root, None if path is None else path.parent)
    notes += _close_loops(spec, root, named, cut.closures)
    _retype(spec, dict(zip(named.joint_name, named.joint_type, strict=True)))
    named_there = dict.fromkeys(j.get("name", "") for t in root.iter("transmission") for j in t.findall("joint"))
    transmitted = [name for name in named_there if name in {joint.name for joint in spec.joints}]
    if still := [name for name in named_there if name not in transmitted]:
        notes.append(f"transmissions of missing or immovable joints are ignored: {listed(still, 8)}")
    kinds = ("revolute", "continuous", "prismatic")  # a fixed joint, or one that follows another, has no motor
    moving = {j.get("name") for j in root.findall("joint") if j.get("type") in kinds and j.find("mimic") is None}
    commanded = [j for j in root.iterfind(".//ros2_control/joint") if j.find("command_interface") is not None]
    sources = {
        _BESIDE: named.name_mot,
        "transmissions of the URDF": transmitted,
        "ros2_control of the URDF": list(
            dict.fromkeys(joint.get("name", "") for joint in commanded if joint.get("name") in moving)
        ),
        _CUT: cut.independent,
    }
    where, motors = next(((where, motors) for where, motors in sources.items() if motors), ("", []))
    add_motors(spec, motors, where)
    if motors:
        notes.append(f"motors from {where}: {', '.join(motors)}")
    return tuple(notes)


def _close_loops(spec: mujoco.MjSpec, root: ET.Element, named: Beside, hinges: Sequence[CutHinge]) -> list[str]:
    """Close the loops that frames, loop_joints and YAML files name, and return a note for each source."""
    closing = dict.fromkeys(found[1] for name in _links(root) if (found := _CLOSING.fullmatch(name)))
    frames = [(f"closing_{name}_1", f"closing_{name}_2") for name in closing]
    loops = list(root.iter("loop_joint"))
    kinds = ["3d"] * len(frames) + (named.type or ["6d"] * len(named.closed_loop))
    for kind in named.type:
        choose(f"type of closure in {_BESIDE}", kind.lower(), ("3d", "6d"))
    pairs, added = [*frames, *named.closed_loop], gazebo_joints(root)
    spec.compiler.fusestatic = spec.compiler.fusestatic and not any((pairs, hinges, added))
    for pair, kind in zip(pairs, kinds, strict=True):
        ends = [(_link_of(root, name), np.zeros(3)) for name in pair]
        _close(spec, "-".join(pair), ends, _WELD if kind.lower() == "6d" else _CONNECT)
    for loop in loops:
        _close_loop_joint(spec, loop)
    data, names = (data_at(spec.compile()), [body.name for body in spec.bodies]) if [*hinges, *added] else (None, [])
    for hinge in hinges:
        _close_hinge(spec, hinge, data, names)
    closed = [joint for joint in added if _close_gazebo_joint(spec, joint, data, names)]
    sources = {
        "the URDF": ["-".join(pair) for pair in frames] + [loop.get("name", "loop") for loop in loops],
        "the URDF's <gazebo>": [joint.name for joint in closed],
        _BESIDE: ["-".join(pair) for pair in named.closed_loop],
        _CUT: [f"{hinge.link_a}-{hinge.link_b}" for hinge in hinges],
    }
    notes = [f"closures from {where}: {', '.join(names)}" for where, names in sources.items() if names]
    return [*notes, *_left_open(loops, [joint for joint in added if joint not in closed])]


def _left_open(loops: Sequence[ET.Element], added: Sequence[GazeboJoint]) -> list[str]:
    """Return the notes on unread parts of loop_joints, and on joints in <gazebo> that close no loop."""
    unread = {loop.get("name", "loop"): listed(left, 6) for loop in loops if (left := _unread(loop))}
    notes = [f"ignored in loop_joint '{name}': {left}" for name, left in unread.items()]
    if not added:
        return notes
    names = ", ".join(f"{joint.name} (type {joint.kind}, {' to '.join(joint.links)})" for joint in added)
    legal = f"{', '.join(CLOSING)} joints between links that move do"
    return [*notes, f"joints in <gazebo> close no loop here: {names}; {legal}"]


def lost_when_attached(root: ET.Element, path: Path) -> list[str]:
    """Return the closures and motors of a URDF that MuJoCo does not read where an MJCF file attaches it."""
    said = [f"loop_joint {loop.get('name')}" for loop in root.iter("loop_joint")]
    said += [f"joint {joint.name} in <gazebo>" for joint in gazebo_joints(root)]
    said += [f"frame {name}" for name in _links(root) if _CLOSING.fullmatch(name)]
    said += [f"<{tag}>" for tag in ("transmission", "ros2_control") if root.find(tag) is not None]
    return said + [what for what, read in ((_BESIDE, beside), (_CUT, loop_closures)) if read(path) is not None]


def _link_of(root: ET.Element, name: str) -> str:
    """Return the link of a frame: a link's own name, or the child of the joint of that name."""
    child = root.find(f"joint[@name='{name}']/child")
    return name if child is None or name in _links(root) else child.get("link", name)


def _links(root: ET.Element) -> list[str]:
    return [link.get("name", "") for link in root.iter("link")]


def _close(spec: mujoco.MjSpec, name: str, ends: Sequence[tuple[str, np.ndarray]], kind: "mujoco.mjtEq") -> None:
    """Tie points (3,) of two links together: a connect, or a weld of the frames there."""
    sites = []
    for number, (link, place) in enumerate(ends, 1):
        body = spec.body(choose(f"link in closure {name}", link, [one.name for one in spec.bodies if one.name]))
        site = body.add_site(name=f"{name} {number}", pos=place)
        sites.append(site.name)
    equality = spec.add_equality(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, name1=sites[0], name2=sites[1])
    if kind == _WELD:
        equality.data[10] = 1.0  # MuJoCo's default of torquescale


def _close_loop_joint(spec: mujoco.MjSpec, loop: ET.Element) -> None:
    """Close a loop_joint: a weld if it is fixed, a connect of its points, and one along the axis if it is a hinge."""
    name = loop.get("name", "loop")
    what = f"loop_joint '{name}' has"
    kind = choose(f"type of loop_joint '{name}'", loop.get("type", "continuous"), CLOSING)
    if next(loop.iter("origin"), None) is not None:
        raise ModelError(f"{what} an <origin>; its points are the attributes xyz and rpy of <link1> and <link2>")
    ends, turns = [], []
    for tag in ("link1", "link2"):
        end = _only(loop, tag, f"{what} {{}} <{tag}>; it has 1")
        place, turn = (numbers_of(end.get(key, "0 0 0"), 3, f"{what} {tag} {key}") for key in ("xyz", "rpy"))
        ends.append((end.get("link", ""), place))
        turns.append(rotation_of_rpy(turn))
    if ends[0][0] == ends[1][0]:
        raise ModelError(f"{what} link1 and link2 = '{ends[0][0]}'; it joins two links")
    if kind == "fixed":
        _close(spec, name, ends, _WELD)
        return
    _close(spec, name, ends, _CONNECT)
    if kind != "ball" and loop.find("axis") is not None:
        axis = _only(loop, "axis", f"{what} {{}} <axis>; it has at most 1")
        along = _direction(numbers_of(axis.get("xyz", "1 0 0"), 3, f"{what} axis xyz"), f"{what} axis xyz")
        further = [(link, place + turn @ along * _HINGE_WIDTH_M) for (link, place), turn in zip(ends, turns, strict=True)]
        _close(spec, f"{name} axis", further, _CONNECT)


def _only(loop: ET.Element, tag: str, said: str) -> ET.Element:
    """Return the only child with a tag; `said` has a place for the number of others."""
    found = loop.findall(tag)
    if len(found) != 1:
        raise ModelError(said.format(len(found) or "no"))
    return found[0]


def _direction(axis: np.ndarray, what: str) -> np.ndarray:
    """Return the unit vector (3,) along an axis.

    Raises:
        ModelError: for an axis without a direction; `what` says whose it is.
    """
    largest = np.abs(axis).max()
    if not 0 < largest < np.inf:
        raise ModelError(f"{what} = '{' '.join(f'{one:g}' for one in axis)}', which has no direction")
    return axis / largest / np.linalg.norm(axis / largest)


def _unread(loop: ET.Element) -> list[str]:
    """Return the elements and attributes of a loop_joint that are not read."""
    end = {"link", "xyz", "rpy"}
    read = {"loop_joint": {"name", "type"}, "link1": end, "link2": end, "axis": {"xyz"}}
    given = [(one.tag, key) for one in (loop, *loop) for key in one.attrib]
    attributes = [f"{key} of <{tag}>" for tag, key in given if key not in read.get(tag, {key})]
    return [f"<{child.tag}>" for child in loop if child.tag not in read] + attributes


def _close_hinge(spec: mujoco.MjSpec, hinge: CutHinge, data: mujoco.MjData, names: Sequence[str]) -> None:
    """Close a hinge that was cut by two connects on its axis, which let its links turn; `names` are those of all bodies."""
    links = (hinge.link_a, hinge.link_b)
    bodies = [names.index(choose("link in loop_closures.yaml", link, names)) for link in links]
    name = "-".join(links)
    along = _direction(np.array(hinge.axis), f"closure {name} has axis")
    if not np.all(np.isfinite(hinge.point)):
        raise ModelError(f"closure {name} has point = {list(hinge.point)}; it takes 3 finite numbers")
    for label, point in ((name, np.array(hinge.point)), (f"{name} axis", hinge.point + _HINGE_WIDTH_M * along)):
        ends = [in_body(data, body, point) for body in bodies]
        _close(spec, label, list(zip(links, ends, strict=True)), _CONNECT)


def _close_gazebo_joint(spec: mujoco.MjSpec, joint: GazeboJoint, data: mujoco.MjData, names: Sequence[str]) -> bool:
    """Close a loop as a joint of Gazebo's does at zero positions: by a hinge, a ball or a weld; return False for no loop."""
    if joint.kind not in CLOSING or not set(joint.links) <= set(names):
        return False
    ends = [names.index(link) for link in joint.links]
    if len(set(data.model.body_weldid[ends])) == 1:  # a link that is tied to the ground, on which it stands
        return False
    turn = data.xmat[ends[1]].reshape(3, 3)
    point = data.xpos[ends[1]] + turn @ joint.place
    if joint.kind == "fixed":
        weld, body, (first, second) = _WELD, mujoco.mjtObj.mjOBJ_BODY, joint.links
        spec.add_equality(name=joint.name, type=weld, objtype=body, name1=first, name2=second).data[10] = 1.0
    elif joint.kind == "ball":
        places = [in_body(data, body, point) for body in ends]
        _close(spec, joint.name, list(zip(joint.links, places, strict=True)), _CONNECT)
    else:
        axis = joint.axis if joint.in_root else turn @ joint.axis
        _close_hinge(spec, CutHinge(*joint.links, tuple(point), tuple(axis)), data, names)
    return True


def _joint(spec: mujoco.MjSpec, name: str, where: str = "") -> "mujoco._specs.MjsJoint":
    return spec.joint(choose(f"joint in {where}" if where else "joint", name, [one.name for one in spec.joints]))


def _retype(spec: mujoco.MjSpec, types: Mapping[str, str]) -> None:
    """Make ball joints and universal joints of hinges: SPHERICAL, or UJOINT_ with its two axes."""
    for name, kind in types.items():
        joint = _joint(spec, name, _BESIDE)
        if kind == "SPHERICAL":
            joint.type = mujoco.mjtJoint.mjJNT_BALL
            joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
            joint.range = (0.0, 0.0)
        elif kind.startswith("UJOINT_") and set(kind[-2:]) <= set(_AXES):
            body, place = joint.parent, joint.pos
            spec.delete(joint)
            for axis in kind[-2:]:
                body.add_joint(name=f"{name}_{axis}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=_AXES[axis], pos=place)
        elif kind != "FIXED":
            raise ModelError(
                f"joint '{name}' has the unknown type '{kind}'; legal: SPHERICAL, UJOINT_XY and its like, FIXED"
            )


# The note on each kind of actuator that a joint may have when a motor is asked for, and on the motors that are added.
_DRIVE_NOTES = {
    "added": "motors added (mechanism.drive)",
    "motor": "motors that the model has already (mechanism.drive)",
    "filter": "actuators without their filters, in simulation too (mechanism.drive)",
    "plugin": "actuators replaced by motors, with their sensors",
}


def add_motors(spec: mujoco.MjSpec, names: Sequence[str], where: str = "") -> list[str]:
    """Add a motor on each of the joints named in `where`, within the effort limit that the joint has, and return notes.

    Plugins that act on such a joint are deleted with their sensors, since no plan can use them. An actuator there with a
    filter, such as a hydraulic cylinder, loses the filter and serves as the motor. A joint that has a motor gets no other.

    Raises:
        ModelError: for an unknown joint, or a joint without an axis for a motor.
    """
    noted: dict[str, list[str]] = {kind: [] for kind in _DRIVE_NOTES}
    for name in names:
        joint, on_joint = _joint(spec, name, where), mujoco.mjtTrn.mjTRN_JOINT
        if joint.type not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            raise ModelError(f"joint '{name}' is neither a hinge nor a slide, so a motor has no axis there")
        own = [(a, _kind_of(a)) for a in spec.actuators if a.trntype == on_joint and a.target == joint.name]
        for actuator, kind in own:
            if kind:
                noted[kind].append(f"{actuator.name or f'a {kind}'} on {joint.name}")
            if kind == "filter":
                actuator.dyntype, actuator.actlimited = mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtLimited.mjLIMITED_FALSE
            elif kind == "plugin":
                of_it = (s for s in spec.sensors if s.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and s.objname == actuator.name)
                for sensor in list(of_it):
                    spec.delete(sensor)
                spec.delete(actuator)
        if all(kind in ("", "plugin") for _, kind in own):
            noted["added"].append(name)
            motor = spec.add_actuator(name=name, target=joint.name, trntype=on_joint)
            motor.set_to_motor()
            if joint.actfrcrange[1] > 0:
                motor.ctrllimited, motor.ctrlrange = mujoco.mjtLimited.mjLIMITED_TRUE, joint.actfrcrange
    return [f"{_DRIVE_NOTES[kind]}: {', '.join(actuators)}" for kind, actuators in noted.items() if actuators]


def _kind_of(actuator: mujoco.MjsActuator) -> str:
    """Return "plugin", "filter" or "motor", whose force is a constant times its ctrl; "" for other actuators."""
    if actuator.plugin.active:
        return "plugin"
    if actuator.dyntype in FILTERS:
        return "filter"
    fixed = actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED and actuator.gainprm[0] != 0
    direct = actuator.dyntype == mujoco.mjtDyn.mjDYN_NONE and actuator.biastype == mujoco.mjtBias.mjBIAS_NONE
    return "motor" if fixed and direct else ""
