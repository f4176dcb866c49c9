"""Deletion of elements of a specification with everything that refers to them, and of missing files of an MJCF.

A missing mesh that only serves for drawing or contact is deleted with its geoms. If it gives its body a mass, the model is
refused, because its dynamics would change.
"""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import mujoco
import numpy as np

from linkplan.models.errors import ModelError, listed, shown

_OPENING = "opening file"
# Most pixels of a model's textures together, and most points of its height fields: 200 and 270 MB in memory.
MAX_IMAGE_PIXELS = 8192**2
# First bytes of the text that stands for a file in a clone without Git LFS.
_POINTER = b"version https://git-lfs"


def delete_users(spec: mujoco.MjSpec, joints: set[str], away: set[str], places: Mapping[str, np.ndarray]) -> list[str]:
    """Delete the elements that refer to locked joints, and return the names of their actuators and couplings.

    A fixed tendon is the weighted sum of its joints: without a locked joint, its range and its spring move by a constant.

    Args:
        spec: is changed.
        joints: names of the locked joints.
        away: names of the joints that are dropped. A coupling of locked and dropped joints alone is deleted.
        places: the reference and the locked position [rad or m] of each locked hinge and slide.

    Raises:
        ModelError: if a tendon or an equality constraint ties one of the joints to one that stays free.
    """
    names: list[str] = []
    coupling = {one.name1 for one in spec.equalities if one.type == mujoco.mjtEq.mjEQ_TENDON}
    coupling |= {one.name2 for one in spec.equalities if one.type == mujoco.mjtEq.mjEQ_TENDON}
    for tendon in list(spec.tendons):
        used = {wrap.target.name for wrap in tendon.path if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT}
        if used & joints and used - joints - away:
            moved = {name for name in used & joints if places[name].any()}
            relaxed = tendon.springlength[0] == -1 and np.any(tendon.stiffness)  # at the reference pose of every joint
            if tendon.name in coupling or (moved and relaxed):
                spring = "its spring has no springlength: give it one, or lock the joint at 0"
                why = "it couples joints" if tendon.name in coupling else spring
                raise ModelError(
                    f"joint '{min(moved or used & joints)}' cannot be locked: tendon '{tendon.name}' uses it, and {why}"
                )
            _leave_tendon(spec, tendon, {name: places[name][1] for name in used & joints})
        elif used & joints:
            names += [f"tendon {tendon.name}", *_delete_tendon(spec, tendon)]
    for closure in [one for one in spec.equalities if one.type == mujoco.mjtEq.mjEQ_JOINT]:
        used = {closure.name1, closure.name2} - {""}
        if used & joints and used - joints - away:
            raise ModelError(
                f"joint '{min(used & joints)}' cannot be locked: the coupling of joints {closure.name1} and"
                f" {closure.name2} moves it; lock the other joint by it, or leave both free"
            )
        if used & joints:
            names.append(f"the coupling of {' and '.join(sorted(used))}")
            spec.delete(closure)
    return names + _delete_drives(spec, mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtObj.mjOBJ_JOINT, joints)


def _leave_tendon(spec: mujoco.MjSpec, tendon: "mujoco._specs.MjsTendon", joints: Mapping[str, float]) -> None:
    """Replace a fixed tendon by a copy without some joints, which rest at given positions [rad or m]."""
    copy = spec.add_tendon()
    own = {"compiler", "default", "id", "name", "path", "signature"}
    for name in {name for name in dir(tendon) if not name.startswith(("_", "wrap_"))} - own:
        setattr(copy, name, getattr(tendon, name))
    for wrap in tendon.path:
        if wrap.target.name not in joints:
            copy.wrap_joint(wrap.target.name, wrap.coef)
        else:
            rest = wrap.coef * joints[wrap.target.name]
            copy.range = copy.range - rest
            if copy.springlength[0] != -1:
                copy.springlength = copy.springlength - rest
            for one in _acting(spec, mujoco.mjtTrn.mjTRN_TENDON, {tendon.name}):
                one.biasprm[0] += one.biasprm[1] * one.gear[0] * rest
    name = tendon.name
    spec.delete(tendon)
    copy.name = name


def _delete_tendon(spec: mujoco.MjSpec, tendon: "mujoco._specs.MjsTendon") -> list[str]:
    """Delete a tendon with its equalities, actuators and sensors, and return the actuators' names."""
    gone, tied = {tendon.name}, mujoco.mjtEq.mjEQ_TENDON
    names = _delete_drives(spec, mujoco.mjtTrn.mjTRN_TENDON, mujoco.mjtObj.mjOBJ_TENDON, gone)
    for one in [one for one in spec.equalities if one.type == tied and gone & {one.name1, one.name2}]:
        spec.delete(one)
    spec.delete(tendon)
    return names


def _acting(spec: mujoco.MjSpec, transmission: mujoco.mjtTrn, targets: set[str]) -> list["mujoco._specs.MjsActuator"]:
    return [one for one in spec.actuators if one.trntype == transmission and one.target in targets]


def _delete_drives(spec: mujoco.MjSpec, transmission: mujoco.mjtTrn, kind: mujoco.mjtObj, gone: set[str]) -> list[str]:
    """Delete the actuators of deleted elements, and the sensors of both; return the names of the actuators."""
    acting = _acting(spec, transmission, gone)
    names = [f"actuator {one.name or 'on ' + one.target}" for one in acting]
    lost = {kind: gone, mujoco.mjtObj.mjOBJ_ACTUATOR: {one.name for one in acting}}
    for one in [*acting, *(one for one in spec.sensors if one.objname in lost.get(one.objtype, ()))]:
        spec.delete(one)
    return names


def delete_geoms(spec: mujoco.MjSpec, geoms: Iterable["mujoco._specs.MjsGeom"]) -> None:
    """Delete geoms with the pairs for contact that name them."""
    gone = list(geoms)
    names = {geom.name for geom in gone if geom.name}
    for pair in [pair for pair in spec.pairs if {pair.geomname1, pair.geomname2} & names]:
        spec.delete(pair)
    for geom in gone:
        spec.delete(geom)


def leave_the_ground(spec: mujoco.MjSpec) -> list[str]:
    """Delete the world's geoms, and return a note: a robot whose base is fixed needs no ground."""
    ground = list(spec.worldbody.geoms)
    names = list(dict.fromkeys(geom.name or "geoms without a name" for geom in ground))
    delete_geoms(spec, ground)
    return [f"the base is fixed in the air, without the world's {', '.join(names)}"] if ground else []


def couple_narrow_tendons(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Hold the length of each fixed tendon whose range couples its joints, and return a note on them.

    A range couples if it is less than 2 % of the lengths that the tendon has within the ranges of its joints. An equality
    in the middle of the range, as soft as the limit, takes the limit's place.
    """
    fixed = [tendon for tendon in spec.tendons if len(tendon.path) > 1 and _is_fixed(tendon) and np.ptp(tendon.range) > 0]
    if not fixed or spec.option.disableflags & mujoco.mjtDisableBit.mjDSBL_LIMIT:
        return ()
    coupled, model = [], spec.compile()
    for tendon in fixed:
        low, high = model.tendon_range[tendon.id]
        joints = [(model.joint(wrap.target.name), wrap.coef) for wrap in tendon.path]
        stroke = sum(abs(coef) * np.ptp(joint.range) for joint, coef in joints if model.jnt_limited[joint.id])
        if model.tendon_limited[tendon.id] and high - low < 0.02 * stroke:
            tendon.name = tendon.name or f"tendon {tendon.id}"
            tie = spec.add_equality(
                type=mujoco.mjtEq.mjEQ_TENDON,
                objtype=mujoco.mjtObj.mjOBJ_TENDON,
                name1=tendon.name,
                solref=tendon.solref_limit,
                solimp=tendon.solimp_limit,
            )
            tie.data = np.eye(len(tie.data))[0] * ((low + high) / 2 - model.tendon_length0[tendon.id])
            tendon.limited = 0
            coupled.append(tendon.name)
    if not coupled:
        return ()
    return (f"the ranges of tendons {listed(coupled, 6)} leave their joints almost no play: they are held in the middle",)


def _is_fixed(tendon: "mujoco._specs.MjsTendon") -> bool:
    return all(wrap.type == mujoco.mjtWrap.mjWRAP_JOINT for wrap in tendon.path)


def leave_out_missing_files(spec: mujoco.MjSpec, path: Path) -> tuple[str, ...]:
    """Delete the meshes and textures whose files are not there or are Git LFS pointers, and return a note that names them.

    Args:
        spec: a parsed MJCF file.
        path: of the file.

    Raises:
        ModelError: if a body has its mass from a mesh that is not there, or a file is a pipe or a device.
    """
    stripped, files = bool(spec.strippath), ((spec.meshdir, spec.meshes), (spec.texturedir, spec.textures))
    places = {
        one: _place(path.parent / below, one.file, stripped) for below, elements in files for one in elements if one.file
    }
    for element, place in places.items():
        if os.path.exists(place) and not os.path.isfile(place):  # MuJoCo would wait for a pipe
            raise ModelError(f"'{shown(element.file)}' is not a regular file (a folder, a pipe or a device)")
    pointers = {element for element, place in places.items() if is_pointer(place)}
    lost = {element for element, place in places.items() if element in pointers or not os.path.isfile(place)}
    meshes = [mesh for mesh in spec.meshes if mesh in lost]
    textures = [texture for texture in spec.textures if texture in lost]
    notes = _without_lost_pairs(spec)
    if not pointers and not (lost and _fails_for_a_file(spec)):
        return notes
    names = list(dict.fromkeys(Path(one.file).name for one in (*meshes, *textures)))
    for mesh in meshes:
        geoms = [geom for geom in spec.geoms if geom.meshname == mesh.name]
        for geom in geoms:
            _refuse_lost_mass(geom, mesh, path, mesh in pointers)
        delete_geoms(spec, geoms)
        spec.delete(mesh)
    _delete_textures(spec, textures)
    said = f"missing files are ignored, with everything that uses them: {listed(names, 6)}"
    said += "; for Git LFS pointers, git lfs pull downloads the files" if pointers else ""
    return (*notes, said)


def leave_out_large_textures(spec: mujoco.MjSpec, folders: Iterable[Path]) -> tuple[str, ...]:
    """Delete the textures that exceed `MAX_IMAGE_PIXELS` together, and return a note that names them; no plan needs them.

    Args:
        spec: a parsed model.
        folders: of its file, and of the models that it attaches.

    Raises:
        ModelError: for height fields with more points.
    """
    room, large = MAX_IMAGE_PIXELS, {}

    def pixels_of(beside: str, name: str) -> int:
        return max((_pixels_of(_place(folder / beside, name, bool(spec.strippath))) for folder in folders), default=0)

    for texture in spec.textures:
        files = [name for name in (texture.file, *texture.cubefiles) if name]
        faces = 1 if texture.type == mujoco.mjtTexture.mjTEXTURE_2D else 6
        made = faces * int(texture.width) * int(texture.height)
        pixels = sum(pixels_of(texture.compiler.texturedir, name) for name in files) if files else made
        if pixels > room:
            large[texture] = f"{texture.name or Path(files[0]).stem} ({pixels / 1e6:.3g} million pixels)"
        else:
            room -= pixels
    for field in spec.hfields:
        made = int(field.nrow) * int(field.ncol)
        points = pixels_of(field.compiler.meshdir, field.file) if field.file else made
        room -= points
        if room < 0:
            raise ModelError(
                f"height field '{field.name}' has {points / 1e6:.3g} million points; height fields and textures have at most"
                f" {MAX_IMAGE_PIXELS / 1e6:.3g} million together"
            )
    _delete_textures(spec, list(large))
    most = f"of more than {MAX_IMAGE_PIXELS / 1e6:.3g} million pixels together"
    return (f"textures {most} are left out of pictures: {listed(list(large.values()), 6)}",) if large else ()


def _delete_textures(spec: mujoco.MjSpec, textures: list["mujoco._specs.MjsTexture"]) -> None:
    gone = {texture.name or Path(texture.file).stem for texture in textures}
    for material in spec.materials:
        material.textures = ["" if name in gone else name for name in material.textures]
    for texture in textures:
        spec.delete(texture)


def _pixels_of(place: Path) -> int:
    """Return the number of pixels of an image: from a PNG's header, or a third of the bytes of another format."""
    if not os.path.isfile(place):
        return 0
    with open(place, "rb") as file:
        head = file.read(24)
    if head[:8] == b"\x89PNG\r\n\x1a\n":
        return int.from_bytes(head[16:20], "big") * int.from_bytes(head[20:24], "big")
    return os.path.getsize(place) // 3


def _without_lost_pairs(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Delete contacts named with geoms or bodies of another file, such as a scene's floor, and return a note on them."""
    there = ({geom.name for geom in spec.geoms}, {body.name for body in spec.bodies})
    named = [(pair, {pair.geomname1, pair.geomname2} - there[0]) for pair in spec.pairs]
    named += [(exclude, {exclude.bodyname1, exclude.bodyname2} - there[1]) for exclude in spec.excludes]
    lost = sorted(set().union(*(names for _, names in named)))
    for contact in [contact for contact, names in named if names]:
        spec.delete(contact)
    return (f"contact pairs with geoms or bodies of other files are ignored: {', '.join(lost)}",) if lost else ()


def _place(folder: Path, name: str, stripped: bool) -> Path:
    """Return where MuJoCo looks for a file: in the folder, without the path of its name if `stripped`."""
    return folder / (Path(name).name if stripped else name)


def is_pointer(place: Path) -> bool:
    """Return True if a file is the text that stands for another one in a clone without Git LFS."""
    if not os.path.isfile(place):  # opening a pipe would block
        return False
    try:
        with open(place, "rb") as file:
            return file.read(len(_POINTER)) == _POINTER
    except OSError:
        return False


def _fails_for_a_file(spec: mujoco.MjSpec) -> bool:
    try:
        spec.copy().compile()  # deletion from a compiled specification takes fifty times as long
    except (ValueError, mujoco.FatalError) as error:
        return _OPENING in str(error)
    return False


def _refuse_lost_mass(geom: mujoco.MjsGeom, mesh: mujoco.MjsMesh, path: Path, pointer: bool) -> None:
    body = geom.parent
    if body.name == "world" or body.explicitinertial or geom.mass == 0 or geom.density == 0:
        return
    named = f"body '{body.name}'" if body.name else "a body without a name"
    lost = "is a Git LFS pointer; git lfs pull downloads the file" if pointer else "is missing; put the file there"
    raise ModelError(
        f"model '{shown(str(path))}': {named} has its mass from mesh '{mesh.file}', which {lost}, or give the body"
        " an <inertial>"
    )
