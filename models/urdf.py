"""Notes on the elements of a URDF that MuJoCo's converter ignores.

MuJoCo converts joints, masses, shapes, ranges, damping, dry friction, effort limits and couplings (`mimic`) of a URDF. It
reads compiler, option and size in the <mujoco> element (MuJoCo, "URDF extensions") and ignores all other elements.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

from linkplan.models.catalogue import is_text
from linkplan.models.errors import listed

_READ_IN_MUJOCO = ("compiler", "option", "size")
_READ = ("link", "joint", "material", "mujoco", "transmission", "loop_joint")


def conversion_notes(source: str | Path, *, driven: bool = False) -> list[str]:
    """Return notes on the elements of a URDF (a path or text) that its conversion ignores, and on drives if it has none."""
    root = urdf_root(source)
    if root is None:
        return []
    notes = []
    speeds = [
        f"{joint.get('name')} {limit.get('velocity')}"
        for joint in root.iter("joint")
        for limit in joint.findall("limit")
        if limit.get("velocity", "0").strip(" 0.")
    ]
    if speeds:
        notes.append(
            f"MuJoCo's converter leaves out the URDF's speed limits (joint {listed(speeds, 6)}, rad/s or m/s):"
            " limits.speed_deg_s and limits.speed_m_s keep them"
        )
    soft = [str(joint.get("name")) for joint in root.iter("joint") if joint.find("safety_controller") is not None]
    others = [child.tag for child in root if child.tag not in _READ] + ["safety_controller"] * bool(soft)
    inside = [child.tag for block in root.findall("mujoco") for child in block if child.tag not in _READ_IN_MUJOCO]
    if others:
        notes.append(f"MuJoCo's converter leaves out the URDF's elements {listed(list(dict.fromkeys(others)), 6)}")
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


def urdf_root(source: str | Path) -> ET.Element | None:
    """Return the <robot> element of a URDF (a path or text); None for another model."""
    root = _root(str(source))
    if root is None:
        return None
    for element in root.iter():  # names of a default namespace, as in Drake's URDFs, are {namespace}name; MuJoCo ignores it
        element.tag = element.tag.rpartition("}")[2] if isinstance(element.tag, str) else element.tag
    return root if root.tag == "robot" else None


def mesh_hint(error: Exception) -> str:
    """Return a hint on the folder of a URDF's meshes if MuJoCo did not find their package, else an empty text."""
    if "'package:" not in str(error):
        return ""
    return (
        "; name the folder of the package's meshes in the URDF's <robot>:"
        ' <mujoco><compiler strippath="true" meshdir="FOLDER"/></mujoco>'
    )


def _root(source: str) -> ET.Element | None:
    try:
        if is_text(source):
            return ET.fromstring(source)
        path = Path(source)
        return ET.fromstring(path.read_bytes()) if path.suffix.lower() in (".urdf", ".xml") and path.is_file() else None
    except (ET.ParseError, OSError, ValueError, LookupError):  # MuJoCo's own reader is less strict
        return None
