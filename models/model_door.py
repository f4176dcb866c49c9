"""What no model may hold, whoever wrote it: looked for in its text before MuJoCo reads it, and in what MuJoCo made of it.

MuJoCo's compiler warns of NaN and passes on most else: infinite masses, negative armatures, names that are no text, counts
that ask for more memory than there is, includes that are pipes.
"""

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from linkplan.models.catalogue import is_there
from linkplan.models.errors import ModelError, one_line
from linkplan.models.model_size import (
    MOST_BODIES,
    MOST_ELEMENTS,
    MOST_ROOM_BYTES,
    MOST_SITES,
    Element,
    ModelSize,
    elements_of,
    image_bytes,
    numbers_in,
    size_of,
)
from linkplan.models.reading import read_file, read_head, shown

# MJCF files, and the meshes and textures that they name: the largest humanoid's mesh has some 20 MB.
MOST_BYTES, _MOST_ASSET_BYTES = 32_000_000, 500_000_000
_MOST_INCLUDES, _DEEPEST_FILES = 1000, 50
# No quantity of a mechanism is larger, in SI units; MuJoCo's own bound on states is 1e10, and solver parameters are below.
_LARGEST = 1e12
# Longer names are no names: pages and tables show them.
_LONGEST_NAME = 500
# Attributes of MJCF that ask for room: at most so much of each (arena memory [bytes] apart).
_COUNTS = {
    "count": 10_000, "nrow": 4096, "ncol": 4096, "width": 16_384, "height": 16_384,
    "nuserdata": 1_000_000, "njmax": 1_000_000, "nconmax": 1_000_000, "nstack": 10_000_000, "nkey": 100_000,
    "nuser_body": 1000, "nuser_jnt": 1000, "nuser_geom": 1000, "nuser_site": 1000, "nuser_cam": 1000,
    "nuser_tendon": 1000, "nuser_actuator": 1000, "nuser_sensor": 1000, "offwidth": 16_384, "offheight": 16_384,
    "size": 100_000, "nsample": 1_000_000, "resolution": 16_384, "dim": 100_000, "num": 100_000, "actdim": 1000,
    "iterations": 10_000, "ls_iterations": 10_000, "noslip_iterations": 10_000, "ccd_iterations": 10_000,
    "sdf_iterations": 10_000, "sdf_initpoints": 10_000, "shadowsize": 16_384, "offsamples": 64, "numslices": 1000,
    "numstacks": 1000, "numquads": 1000, "params": 400,
}  # fmt: skip
_MOST_MEMORY = 1_000_000_000
_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}
# Attributes that name files.
_FILES = frozenset({"file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback"})

# Fields of a compiled model that are not below zero, by what they are.
_NOT_NEGATIVE = {
    "body_mass": "mass", "body_inertia": "inertia", "dof_armature": "armature", "dof_frictionloss": "frictionloss",
    "dof_damping": "damping", "tendon_frictionloss": "frictionloss", "tendon_damping": "damping",
    "tendon_armature": "armature", "actuator_armature": "armature", "actuator_damping": "damping",
}  # fmt: skip
# What the compiler works out of the others, for its own scaling: huge where something is nearly massless.
_DERIVED = ("oct_coeff", "actuator_acc0", "body_invweight0", "dof_invweight0", "tendon_invweight0")
# The simulator's step [s]: below the first no computer gets anywhere, above the last nothing moves as it should.
_TIMESTEP_S = (1e-8, 1.0)
# Which of mjModel's names a field's prefix has, for a refusal that names the element.
_OWNERS = {
    "body": "body", "jnt": "joint", "geom": "geom", "site": "site", "tendon": "tendon", "actuator": "actuator",
    "eq": "equality", "key": "key", "mesh": "mesh", "cam": "camera", "sensor": "sensor",
}  # fmt: skip
_KINDS = {
    "body": mujoco.mjtObj.mjOBJ_BODY, "joint": mujoco.mjtObj.mjOBJ_JOINT, "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "site": mujoco.mjtObj.mjOBJ_SITE, "tendon": mujoco.mjtObj.mjOBJ_TENDON, "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "equality": mujoco.mjtObj.mjOBJ_EQUALITY, "key": mujoco.mjtObj.mjOBJ_KEY, "mesh": mujoco.mjtObj.mjOBJ_MESH,
    "camera": mujoco.mjtObj.mjOBJ_CAMERA, "sensor": mujoco.mjtObj.mjOBJ_SENSOR,
}  # fmt: skip


def refuse_files(path: Path) -> None:
    """Refuse a model file that names, itself or in what it includes or attaches, anything but regular files of bounded size.

    Raises:
        ModelError: naming the file, or the models that attach each other in a circle.
    """
    made: dict[Path, float] = {}
    _refuse_file(path, path, path, made, ())


def _refuse_file(here: Path, base: Path, model: Path, made: dict[Path, float], above: tuple[Path, ...]) -> float:
    """Return how many bodies a file makes, with all that it includes and attaches, after refusing what cannot be read."""
    try:
        key = here.resolve()
    except (OSError, RuntimeError) as error:  # links in a circle
        raise ModelError(f"model '{model}' includes '{here}', which cannot be followed: {error}") from error
    if key in above:
        raise ModelError(f"model '{model}' includes or attaches '{here}' in a circle")
    if key in made:
        return made[key]
    if len(made) > _MOST_INCLUDES or len(above) > _DEEPEST_FILES:
        raise ModelError(
            f"model '{model}' includes more than {_MOST_INCLUDES} files, or files in files more than {_DEEPEST_FILES} deep"
        )
    content = read_file(here, f"model '{here}'", MOST_BYTES, ModelError)
    made[key] = 0.0
    text, size = elements_and_size(content, here)
    within, largest, folders = 0.0, 0.0, asset_folders(text)
    for element in text:
        for name, named in element.attributes.items():
            if name not in _FILES or not named or "\0" in named:
                continue
            for place in _places(named, folders, base, here):
                if not is_there(place):
                    continue
                if element.name not in ("include", "model"):
                    read_file_head(place, model)
                    continue
                inner = place if element.name == "model" else base  # a model's own files lie beside it
                bodies = _refuse_file(place, inner, model, made, (*above, key))
                if element.name == "model":
                    largest = max(largest, bodies)
                else:
                    within += bodies
    made[key] = size.bodies + within + size.attached * largest
    if made[key] > MOST_BODIES:
        raise ModelError(
            f"model '{model}' makes {made[key]:.6g} bodies by what '{here}' includes and attaches; at most {MOST_BODIES}"
            " are read"
        )
    return made[key]


def read_file_head(place: Path, model: Path) -> None:
    """Refuse an asset that is no regular file, or too large."""
    if not place.is_file():
        raise ModelError(f"model '{model}' names '{place}', which is not a regular file")
    if place.stat().st_size > _MOST_ASSET_BYTES:
        raise ModelError(
            f"model '{model}' names '{place}' of {place.stat().st_size} bytes; at most {_MOST_ASSET_BYTES} are read"
        )
    width, height = png_size(place)  # whatever it is named: MJCF may say in words what a file is
    if image_bytes(width, height) > MOST_ROOM_BYTES:  # a few kilobytes of file may unfold to any size
        raise ModelError(
            f"model '{model}' names '{place}', a picture of {width} x {height} pixels; at most {MOST_ROOM_BYTES:.6g}"
            " bytes of textures are read"
        )


def png_size(place: Path) -> tuple[int, int]:
    """Return the width and height [pixels] that a PNG file declares; zeros where it is none."""
    head = read_head(place, f"'{place}'", 24, ModelError)
    if not head.startswith(b"\x89PNG\r\n\x1a\n") or len(head) < 24:
        return 0, 0
    return int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")


def asset_folders(text: list[Element]) -> list[str]:
    """Return the folders that a text's compiler takes assets from, the model's own first."""
    folders = ("meshdir", "texturedir", "assetdir")
    found = [element.attributes[name] for element in text for name in folders if name in element.attributes]
    return ["", *(folder for folder in found if "\0" not in folder)]


def _places(named: str, folders: list[str], base: Path, here: Path) -> Iterator[Path]:
    """Yield where MuJoCo may look for a file: beside the model or the including file, below its asset folders."""
    for parent in {base.parent, here.parent}:
        for folder in folders:
            yield parent / folder / named


def refuse_text(text: str | bytes, path: Path | None) -> None:
    """Refuse an MJCF text that asks for more room than a model can need.

    Raises:
        ModelError: naming the attribute, or what there is too much of.
    """
    try:
        content = text.encode("utf-8") if isinstance(text, str) else text
    except UnicodeEncodeError as error:
        raise ModelError(f"MJCF text is not text: {error}") from error
    elements_and_size(content, path)


def elements_and_size(content: bytes, path: Path | None) -> tuple[list[Element], ModelSize]:
    """Return the elements of an MJCF text, and what they make, after refusing one that asks for too much."""
    what = "MJCF text" if path is None else f"model '{path}'"
    if len(content) > MOST_BYTES:
        raise ModelError(f"{what} has {len(content)} bytes; at most {MOST_BYTES} are read")
    if b"\0" in content:
        raise ModelError(f"{what} does not parse: it holds zero bytes; a model is MJCF or URDF text")
    elements = list(elements_of(content))
    for element in elements:
        for name, value in element.attributes.items():
            if name not in _COUNTS and name != "memory":
                continue
            if name == "params" and "builtin" not in element.attributes:
                continue
            asked = _largest(value)
            if name == "size" and asked < 1000:
                continue
            most = _MOST_MEMORY if name == "memory" else _COUNTS[name]
            if asked > most:
                raise ModelError(f'{what} has {name} = "{shown(value, 40)}"; at most {most} is read')
    size = size_of(elements)
    for asked, most, words in (
        (size.bodies, MOST_BODIES, "bodies, points of flexes among them"),
        (size.sites, MOST_SITES, "sites"),
        (size.elements, MOST_ELEMENTS, "elements by replicate"),
        (size.room_bytes, MOST_ROOM_BYTES, "bytes of textures and height fields"),
    ):
        if asked > most:
            raise ModelError(f"{what} makes {asked:.6g} {words}; at most {most:.6g} are read")
    return elements, size


def _largest(value: str) -> float:
    """Return the largest number of an attribute's value, infinite where one cannot be told, -1 where there is none."""
    most = -1.0
    for word in value.split():
        unit = _UNITS.get(word[-1:].upper(), 1) if "x" not in word.lower() else 1
        digits = word if unit == 1 else word[:-1]
        if any(c.isdigit() for c in digits) or digits.strip("+-").lower() in ("inf", "infinity", "nan"):
            most = max(most, numbers_in(digits) * unit)
    return most


def refuse_unusable(name: str, model: mujoco.MjModel) -> None:
    """Refuse a compiled model that holds names that are no text, or numbers that are not finite or mean nothing.

    Raises:
        ModelError: naming the element and the field.
    """
    _refuse_names(name, model)
    step = float(model.opt.timestep)
    if not _TIMESTEP_S[0] <= step <= _TIMESTEP_S[1]:
        raise ModelError(
            f"model '{name}' has option timestep = {step:g} s; the simulator's step is from {_TIMESTEP_S[0]:g} to"
            f" {_TIMESTEP_S[1]:g} s"
        )
    for field, word in _NOT_NEGATIVE.items():
        value = getattr(model, field, None)
        if value is not None and np.any(np.asarray(value) < 0):
            bad = np.asarray(value) < 0
            raise ModelError(
                f"model '{name}' has {_where(model, field, bad)} = {float(np.asarray(value)[bad].ravel()[0]):g}; {word}"
                " is at least 0"
            )
    for field in ("jnt_range", "tendon_range", "actuator_ctrlrange", "actuator_forcerange", "jnt_actfrcrange"):
        value = np.asarray(getattr(model, field, np.zeros((0, 2)))).reshape(-1, 2)
        bad = value[:, 0] > value[:, 1]
        if np.any(bad):
            low, high = value[bad][0]
            raise ModelError(f"model '{name}' has {_where(model, field, bad)} = {low:g} to {high:g}, which is no range")
    for what, value in _numbers(model):
        bad = ~np.isfinite(value) | (np.abs(value) > _LARGEST)
        if np.any(bad):
            got = float(value[bad].ravel()[0])
            legal = "not finite (nan or inf)" if not np.isfinite(got) else f"beyond {_LARGEST:g}"
            raise ModelError(f"model '{name}' holds a number that is {legal}: {_where(model, what, bad)} is {got:g}")


def _numbers(model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
    """Yield every array of floats of a model and of its options, by its name."""
    for owner, prefix in ((model, ""), (model.opt, "option ")):
        for field in dir(owner):
            if field.startswith("_") or field.endswith(("_user", "_numeric")) or field in _DERIVED:
                continue
            value = getattr(owner, field)
            if isinstance(value, float):
                yield prefix + field, np.array([value])
            elif isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.size:
                yield prefix + field, value


def _refuse_names(name: str, model: mujoco.MjModel) -> None:
    for word in bytes(model.names).split(b"\0"):
        try:
            text = word.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ModelError(f"model '{name}' has a name that is not UTF-8 text: {word[:40]!r}") from error
        if len(text) > _LONGEST_NAME:
            raise ModelError(
                f"model '{name}' has a name of {len(text)} characters, '{one_line(shown(text, 40))}'; names have at most"
                f" {_LONGEST_NAME}"
            )
        if text and not text.isprintable():
            raise ModelError(
                f"model '{name}' has a name with characters that cannot be shown: '{one_line(shown(text, 60))}'"
            )


def _where(model: mujoco.MjModel, field: str, bad: np.ndarray) -> str:
    """Return a field's name and, where it belongs to elements, that of the first bad one."""
    prefix, _, rest = field.partition("_")
    row = int(np.argwhere(bad)[0][0])
    if prefix == "dof" and row < model.nv:
        prefix, row = "jnt", int(model.dof_jntid[row])
    kind = _OWNERS.get(prefix)
    if kind is None or not rest:
        return field
    try:
        element = mujoco.mj_id2name(model, _KINDS[kind], row)
    except (UnicodeDecodeError, TypeError):
        element = None
    return f"{rest} of {kind} {element or row}"
