"""What an MJCF file names and does not have: meshes and textures that were not published with it, geoms of its scene.

A mesh that is only drawn or touched is left out with its geoms. A mesh that gives its body a mass cannot be: the model is
refused then, because its dynamics would be others.
"""

import os
from pathlib import Path

import mujoco

from linkplan.models.errors import ModelError, listed, shown
from linkplan.models.users import delete_geoms

_OPENING = "opening file"


def leave_out_missing_files(spec: mujoco.MjSpec, path: Path) -> tuple[str, ...]:
    """Delete the meshes and textures whose files are not there, and return a note that names them.

    Args:
        spec: a parsed MJCF file.
        path: of the file.

    Raises:
        ModelError: if a body has its mass from a mesh that is not there.
    """
    folder, stripped = path.parent, bool(spec.strippath)
    meshes = [mesh for mesh in spec.meshes if _is_missing(folder / spec.meshdir, mesh.file, stripped)]
    textures = [texture for texture in spec.textures if _is_missing(folder / spec.texturedir, texture.file, stripped)]
    notes = _without_lost_pairs(spec)
    if not (meshes or textures) or not _fails_for_a_file(spec):
        return notes
    names = list(dict.fromkeys(Path(one.file).name for one in (*meshes, *textures)))
    for mesh in meshes:
        geoms = [geom for geom in spec.geoms if geom.meshname == mesh.name]
        for geom in geoms:
            _refuse_lost_mass(geom, mesh, path)
        delete_geoms(spec, geoms)
        spec.delete(mesh)
    gone = {texture.name for texture in textures}
    for material in spec.materials:
        material.textures = ["" if name in gone else name for name in material.textures]
    for texture in textures:
        spec.delete(texture)
    said = f"files that are not there are left out with what they draw: {listed(names, 6)}"
    return (*notes, said)


def _without_lost_pairs(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Delete the pairs for contact with geoms of another file, such as a scene's floor, and return a note on them."""
    there = {geom.name for geom in spec.geoms}
    lost = [pair for pair in spec.pairs if not {pair.geomname1, pair.geomname2} <= there]
    names = sorted({name for pair in lost for name in (pair.geomname1, pair.geomname2)} - there)
    for pair in lost:
        spec.delete(pair)
    return (f"pairs for contact with geoms of other files are left out: {', '.join(names)}",) if lost else ()


def _is_missing(folder: Path, name: str, stripped: bool) -> bool:
    """Return True if a file is not where MuJoCo looks for it: in the folder, without the path of its name if `stripped`."""
    return bool(name) and not os.path.isfile(folder / (Path(name).name if stripped else name))


def _fails_for_a_file(spec: mujoco.MjSpec) -> bool:
    try:
        spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        return _OPENING in str(error)
    return False


def _refuse_lost_mass(geom: mujoco.MjsGeom, mesh: mujoco.MjsMesh, path: Path) -> None:
    body = geom.parent
    if body.name == "world" or body.explicitinertial or geom.mass == 0 or geom.density == 0:
        return
    named = f"body '{body.name}'" if body.name else "a body without a name"
    raise ModelError(
        f"model '{shown(str(path))}': {named} has its mass from mesh '{mesh.file}', which is not there; put the file"
        " there, or give the body an <inertial>"
    )
