"""Parts of a URDF that MuJoCo cannot compile: impossible masses and inertias, meshes, shapes and ranges without size."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np

from linkplan.models.errors import listed
from linkplan.models.foreign.deletion import delete_geoms, is_pointer
from linkplan.models.payload import MAX_SI_VALUE

# The mass and inertia of a link without mass [kg, kg.m^2], such as a dummy link of a universal joint: a millionth of light
# links.
LEAST_MASS_KG, LEAST_INERTIA_KGM2 = 1e-6, 1e-9
# Formats of meshes that MuJoCo reads.
_MESHES = (".stl", ".obj", ".msh")


def settle_links(spec: mujoco.MjSpec, root: ET.Element, folder: Path | None) -> list[str]:
    """Change the parts of a URDF's links and ranges that MuJoCo cannot compile, and return notes on them.

    Args:
        spec: MuJoCo's conversion of the URDF, which is changed.
        root: its <robot> element.
        folder: the URDF's.
    """
    return [
        *_settle_meshes(spec, folder),
        *_delete_flat(spec),
        *_weigh(spec, root),
        *_settle_inertias(spec),
        *_delete_ranges(spec),
        *_free_followers(spec),
    ]


def _settle_meshes(spec: mujoco.MjSpec, folder: Path | None) -> list[str]:
    """Find the files of meshes beside the URDF; delete the geoms of others, and return notes on them."""
    missing, unread, pointers = [], [], []
    for mesh in list(spec.meshes):
        if not mesh.file:
            continue
        name = re.sub(r"^package:/+", "", mesh.file)
        inside = name.partition("/")[2]  # of a package: a folder above the URDF, which may have another name here
        above = [] if folder is None else [folder, *folder.resolve().parents[:3]]
        places = [base / part for part in (name, inside) for base in above if part]
        places += [base / spec.meshdir / Path(name).name for base in above[:1]]
        found = next((place for place in places if place.is_file()), None)
        if found is not None and _is_mesh(found):
            mesh.file = str(found.resolve())
            continue
        (missing if found is None else pointers if is_pointer(found) else unread).append(Path(name).name)
        delete_geoms(spec, (geom for geom in spec.geoms if geom.meshname == mesh.name))
        spec.delete(mesh)
    remedy = 'their folder is named by <mujoco><compiler strippath="true" meshdir="FOLDER"/></mujoco> in <robot>'
    said = {
        "missing meshes are ignored: {}; " + remedy: missing,
        f"meshes that MuJoCo does not read (it reads binary {', '.join(_MESHES)}) are ignored: {{}}": unread,
        "Git LFS pointers are ignored: {}; git lfs pull downloads the files": pointers,
    }
    return [note.format(", ".join(dict.fromkeys(names))) for note, names in said.items() if names]


def _is_mesh(place: Path) -> bool:
    """Tell if MuJoCo reads a file as a mesh: an STL is binary, with 50 bytes for each of at most 200,000 triangles."""
    if place.suffix.lower() != ".stl":
        return place.suffix.lower() in _MESHES and not is_pointer(place)
    with open(place, "rb") as file:
        triangles = int.from_bytes(file.read(84)[80:], "little")
    return 0 < triangles <= 200_000 and place.stat().st_size == 84 + 50 * triangles


def _delete_flat(spec: mujoco.MjSpec) -> list[str]:
    """Delete the shapes without size, placeholders of other simulators, and return a note on them."""
    counts = {mujoco.mjtGeom.mjGEOM_SPHERE: 1, mujoco.mjtGeom.mjGEOM_BOX: 3, mujoco.mjtGeom.mjGEOM_CYLINDER: 2}
    flat = [geom for geom in spec.geoms if (n := counts.get(geom.type)) and not np.all(geom.size[:n] > 0)]
    links = dict.fromkeys(geom.parent.name for geom in flat)
    delete_geoms(spec, flat)
    return [f"shapes without size are ignored: of {listed(list(links), 8)}"] if flat else []


def _delete_ranges(spec: mujoco.MjSpec) -> list[str]:
    """Delete ranges that limit nothing, such as those that end below their beginning, and return a note on them."""
    loose = [joint for joint in spec.joints if joint.range[0] > joint.range[1] or np.abs(joint.range).min() > MAX_SI_VALUE]
    said = [f"{joint.name} ({joint.range[0]:g} to {joint.range[1]:g})" for joint in loose]
    turned = any(joint.range[0] > joint.range[1] for joint in loose)
    for joint in loose:
        joint.range, joint.limited = [0.0, 0.0], mujoco.mjtLimited.mjLIMITED_FALSE
    slip = (
        "; MuJoCo and Bullet, too, ignore ranges that end below their beginning: are their ends swapped?" if turned else ""
    )
    return [f"ranges of joints that impose no limit are ignored: {listed(said, 8)}{slip}"] if said else []


def _free_followers(spec: mujoco.MjSpec) -> list[str]:
    """Delete the ranges of followers that would block their leaders, by a wrong sign for example, and return a note.

    ROS limits a commanded joint, and ignores the ranges of the joints that follow it.
    """
    joints, freed = {joint.name: joint for joint in spec.joints}, []
    for equality in spec.equalities:
        follower, leader = joints.get(equality.name1), joints.get(equality.name2)
        if follower is None or leader is None or not equality.data[1]:
            continue
        low, high = np.sort((np.array(follower.range) - equality.data[0]) / equality.data[1])
        room = min(high, leader.range[1]) - max(low, leader.range[0])
        if np.ptp(follower.range) > 0 and np.ptp(leader.range) > 0 and room <= 1e-3 * np.ptp(leader.range):
            freed.append(f"{follower.name} ({follower.range[0]:g} to {follower.range[1]:g}) of {leader.name}")
            follower.range, follower.limited = [0.0, 0.0], mujoco.mjtLimited.mjLIMITED_FALSE
    said = "ranges of joints that follow others and would block them are ignored, as by ROS"
    return [f"{said}: {listed(freed, 8)}"] if freed else []


def _weigh(spec: mujoco.MjSpec, root: ET.Element) -> list[str]:
    """Give moving links without mass the smallest mass, and return a note on them."""
    masses = {link.get("name", ""): link.find("inertial/mass") for link in root.iter("link")}
    moving = {
        joint.find("child").get("link", "") for joint in root.findall("joint") if joint.get("type") not in (None, "fixed")
    }
    light = [name for name in moving if (mass := masses.get(name)) is None or float(mass.get("value", "0")) < LEAST_MASS_KG]
    if not light:
        return []
    spec.compiler.boundmass, spec.compiler.boundinertia = LEAST_MASS_KG, LEAST_INERTIA_KGM2
    return [
        f"links without mass get {LEAST_MASS_KG:g} kg and {LEAST_INERTIA_KGM2:g} kg.m^2, because MuJoCo cannot move a"
        " massless body:"
        f" {', '.join(sorted(light))}"
    ]


def _settle_inertias(spec: mujoco.MjSpec) -> list[str]:
    """Replace impossible inertias of links, which MuJoCo refuses, by the nearest possible ones, and return notes on them.

    Principal moments are positive, and none exceeds the sum of the others. For the nearest one, by least squares, each
    moment changes by a third of the largest moment's excess.
    """
    points, changes = [], []
    for body in spec.bodies:
        if not body.explicitinertial:
            continue
        xx, yy, zz, xy, xz, yz = (*body.inertia, 0, 0, 0) if np.isnan(body.fullinertia[0]) else body.fullinertia
        moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        none = moments[2] <= mujoco.mjMINVAL
        least = LEAST_INERTIA_KGM2 if none else min(LEAST_INERTIA_KGM2, moments[2])
        settled = np.where(moments > mujoco.mjMINVAL, moments, least)
        settled += max(0.0, settled[2] * (1 + 1e-9) - settled[:2].sum()) / 3 * np.array([1, 1, -1])  # rounding stays within
        change = float(np.abs(settled - moments).max())
        if not change or (none and not body.mass):
            continue
        full = axes @ np.diag(settled) @ axes.T
        body.fullinertia = [*np.diag(full), full[0, 1], full[0, 2], full[1, 2]]
        if none:
            points.append(body.name)
        elif change > 1e-6 * settled[2]:
            changes.append(f"{body.name} ({100 * change / settled[2]:.2g} %)")
    notes = [f"links without inertia get {LEAST_INERTIA_KGM2:g} kg.m^2: {listed(points, 8)}"] if points else []
    if changes:
        notes.append(
            "physically impossible inertias of links are replaced by the nearest possible ones (change, of the largest"
            f" moment): {listed(changes, 8)}"
        )
    return notes
