"""Joints that a URDF adds to its tree in `<gazebo>` elements, by which Gazebo closes loops: SDF's, and detachable joints."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import ModelError
from linkplan.models.kinematics import rotation_of_rpy


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


# The kinds of joints that close a loop here, in SDF's words.
CLOSING = ("revolute", "continuous", "ball", "fixed")


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
    text = joint.findtext(path, default)
    try:
        numbers = np.array(text.split(), dtype=float)
    except ValueError:
        numbers = np.empty(0)
    most = len(default.split())
    if len(numbers) != most or not np.all(np.isfinite(numbers)):
        raise ModelError(f"joint '{joint.get('name')}' in <gazebo> has {path} = '{text}'; it takes {most} numbers")
    return numbers
