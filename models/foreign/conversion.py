"""The parts of a URDF that MuJoCo's converter leaves out without a message, and the joints that are read in its place.

MuJoCo's converter reads a URDF's joints, masses, shapes, ranges, damping, dry friction, effort limits and couplings
(`mimic`), and compiler, option and size in its <mujoco> element (MuJoCo, "URDF extensions"). Joints that a URDF adds to its
tree in `<gazebo>` elements, by which Gazebo closes loops, are read here.
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import ModelError, listed, shown
from linkplan.models.kinematics import rotation_of_rpy

_READ_IN_MUJOCO = ("compiler", "option", "size")
_READ = ("link", "joint", "material", "mujoco", "transmission", "ros2_control", "loop_joint")
# The kinds of joints that close a loop here, in SDF's words.
CLOSING = ("revolute", "continuous", "ball", "fixed")


def conversion_notes(root: ET.Element, *, driven: bool = False) -> list[str]:
    """Return notes on the elements of a URDF's <robot> that its conversion ignores, and on drives if it has none."""
    notes = []
    speeds = [
        f"{joint.get('name')} {limit.get('velocity')}"
        for joint in root.iter("joint")
        for limit in joint.findall("limit")
        if limit.get("velocity", "0").strip(" 0.")
    ]
    if speeds:
        notes.append(
            f"MuJoCo's converter ignores the URDF's speed limits (joint {listed(speeds, 6)}, rad/s or m/s):"
            " limits.speed_deg_s and limits.speed_m_s impose them"
        )
    soft = [str(joint.get("name")) for joint in root.iter("joint") if joint.find("safety_controller") is not None]
    added = {joint.name for joint in gazebo_joints(root)}
    joints = [one for one in root.findall("gazebo") if len(one) and all(joint.get("name") in added for joint in one)]
    others = [child.tag for child in root if child.tag not in _READ and child not in joints]
    others += ["safety_controller"] * bool(soft)
    inside = [child.tag for block in root.findall("mujoco") for child in block if child.tag not in _READ_IN_MUJOCO]
    if others:
        notes.append(f"MuJoCo's converter ignores the URDF's elements {listed(list(dict.fromkeys(others)), 6)}")
    if inside:
        notes.append(
            f"MuJoCo ignores {listed(list(dict.fromkeys(inside)), 6)} in the URDF's <mujoco> element, where it only reads"
            f" {', '.join(_READ_IN_MUJOCO)}"
        )
    if driven:
        return notes
    notes.append(
        "the URDF names no actuators: name their joints (mechanism.drive), or add <transmission> elements, a YAML"
        " file beside it, or an MJCF file that attaches it,"
        ' with <asset><model name="NAME" file="FILE.urdf"/></asset> and <frame><attach model="NAME" prefix="P_"/></frame>'
    )
    return notes


def compile_hint(error: Exception) -> str:
    """Return the remedy if MuJoCo refuses a model's inertia or a URDF's meshes; empty for other errors."""
    if "balanceinertia" in str(error):
        return ': <compiler balanceinertia="true"/>'
    if "'package:" not in str(error):
        return ""
    return (
        "; name the folder of the package's meshes in the URDF's <robot>:"
        ' <mujoco><compiler strippath="true" meshdir="FOLDER"/></mujoco>'
    )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class GazeboJoint:
    """A joint between links of a URDF: its kind in SDF, a point (3,) [m] on its axis and the axis (3,), in the child.

    With `in_root` the axis is in the root link at zero positions.
    """

    name: str
    kind: str
    links: tuple[str, str]  # parent and child
    place: np.ndarray
    axis: np.ndarray
    in_root: bool = False


def gazebo_joints(root: ET.Element) -> list[GazeboJoint]:
    """Return the joints in the `<gazebo>` elements of a URDF's <robot>, also between links that detachable joints hold.

    Those that only add a sensor or friction to a joint of the tree are left out.

    Raises:
        ModelError: for a pose or an axis that is not six or three numbers.
    """
    links, found = {link.get("name", "") for link in root.iter("link")}, []
    tree = {joint.get("name", "") for joint in root.findall("joint")}
    for joint in root.iterfind("gazebo/joint"):
        if joint.get("name") in tree or joint.find("parent") is None or joint.find("child") is None:
            continue
        pose, axis = _numbers(joint, "pose", "0 0 0 0 0 0"), _numbers(joint, "axis/xyz", "0 0 1")
        in_root = _text(joint, "axis/use_parent_model_frame") in ("1", "true")
        found.append(
            GazeboJoint(
                name=joint.get("name", "loop"),
                kind=joint.get("type", ""),
                links=(_text(joint, "parent"), _text(joint, "child")),
                place=pose[:3],
                axis=axis if in_root else rotation_of_rpy(pose[3:]) @ axis,
                in_root=in_root,
            )
        )
    still = np.zeros(3)
    for plugin in root.iterfind("gazebo/plugin"):
        ends = (_text(plugin, "parent_link"), _text(plugin, "child_link"))
        if plugin.get("name", "").endswith("DetachableJoint") and links.issuperset(ends):
            found.append(GazeboJoint(name="-".join(ends), kind="fixed", links=ends, place=still, axis=still))
    return found


def _text(element: ET.Element, path: str) -> str:
    return element.findtext(path, "").strip()


def _numbers(joint: ET.Element, path: str, default: str) -> np.ndarray:
    return numbers_of(
        joint.findtext(path, default), len(default.split()), f"joint '{joint.get('name')}' in <gazebo> has {path}"
    )


def numbers_of(text: str, count: int, what: str) -> np.ndarray:
    """Return the numbers (count,) in a text.

    Raises:
        ModelError: for another count or a number that is not finite; `what` says whose text it is.
    """
    try:
        numbers = np.array(text.split(), dtype=float)
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != count or not np.all(np.isfinite(numbers)):
        raise ModelError(f"{what} = '{shown(text, 60)}'; it takes {count} numbers")
    return numbers
