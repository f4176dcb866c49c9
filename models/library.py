"""Finding and compiling a model: a built-in name, a path to an MJCF file, or MJCF text.

Its text is checked before MuJoCo allocates memory for it, and the compiled model's names and numbers afterwards: MuJoCo's
compiler warns of NaN but accepts infinite masses, negative armatures and ranges with low above high. MuJoCo has one handler
of warnings for the whole process; its warnings are kept here for each thread.
"""

import contextlib
import contextvars
import copy
import itertools
import os
import re
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np

from linkplan.models.catalogue import MODELS, is_text, unknown_source
from linkplan.models.deadline import one_thread_at_a_time
from linkplan.models.errors import ModelError, listed, one_line, shown
from linkplan.models.foreign.conversion import compile_hint, conversion_notes
from linkplan.models.foreign.deletion import couple_narrow_tendons, leave_out_large_textures, leave_out_missing_files
from linkplan.models.foreign.model_text import COMMENT, MAX_MODEL_BYTES, refuse_oversized, robot_element, urdf_root
from linkplan.models.foreign.urdf_loops import complete, lost_when_attached
from linkplan.models.payload import MAX_SI_VALUE, Payload, attach
from linkplan.models.reading import read_file
from linkplan.models.selection import Selection, select

# Attributes that older versions of MuJoCo read and that no plan depends on.
_RETIRED = re.compile(rb"""\s(sensornoise|apirate|collision)\s*=\s*["'](?:\d+|enable|disable|all|predefined|dynamic)["']""")
# Files that a model includes, and models that it attaches.
_INCLUDE = re.compile(rb"""<include\s[^>]*?\bfile\s*=\s*["']([^"']+)["']""")
_ATTACHED = re.compile(rb"""<model\s[^>]*?\bfile\s*=\s*["']([^"']+)["']""")
# MuJoCo's refusal of a file whose root element is <mujocoinclude>.
_PART_OF_A_MODEL = "model type: 'mujocoinclude'"
MAX_NAME_LENGTH = 500
# Fields of a compiled model that must not be negative: the element's prefix and the word of MJCF.
_NOT_NEGATIVE = (
    "body_mass", "body_inertia", "dof_armature", "dof_frictionloss", "dof_damping", "tendon_frictionloss", "tendon_damping",
    "tendon_armature", "actuator_armature", "actuator_damping",
)  # fmt: skip
# Fields that the compiler derives for its own scaling. They are huge for a nearly massless body.
_DERIVED = ("oct_coeff", "actuator_acc0", "body_invweight0", "dof_invweight0", "tendon_invweight0")
# Legal range of the simulator's timestep [s].
TIMESTEP_RANGE_S = (1e-8, 1.0)
# The element kind of each field prefix of mjModel.
_OWNERS = {
    "body": "body", "jnt": "joint", "geom": "geom", "site": "site", "tendon": "tendon", "actuator": "actuator",
    "eq": "equality", "key": "key", "mesh": "mesh", "cam": "camera", "sensor": "sensor",
}  # fmt: skip


class _Kept(threading.local):
    """The warnings of one thread; None where nobody keeps them."""

    messages: list[str] | None = None


_KEPT = _Kept()
_KEEPERS: list[int] = []  # the threads that keep warnings; a thread of MuJoCo's own belongs to one of them


def _keep(message: str) -> None:
    if _KEPT.messages is not None:
        _KEPT.messages.append(message)
    elif not _KEEPERS:
        warnings.warn(message, RuntimeWarning, stacklevel=2)


@contextlib.contextmanager
def mujoco_warnings() -> Iterator[list[str]]:
    """Keep the warnings that MuJoCo issues in this thread; by default MuJoCo writes a log file to the working folder."""
    outer, _KEPT.messages = _KEPT.messages, []
    _KEEPERS.append(threading.get_ident())
    try:
        yield _KEPT.messages
    finally:
        _KEEPERS.remove(threading.get_ident())
        _KEPT.messages = outer


# Set once for the process: MuJoCo can deadlock when one thread sets the handler while another compiles a model.
mujoco.set_mju_user_warning(_keep)


def refuse_unusable(name: str, model: mujoco.MjModel) -> None:
    """Refuse a compiled model with invalid names or numbers.

    Raises:
        ModelError: if a name or number is invalid; the message names the element and the field.
    """
    _refuse_names(name, model)
    step = float(model.opt.timestep)
    if not TIMESTEP_RANGE_S[0] <= step <= TIMESTEP_RANGE_S[1]:
        raise ModelError(
            f"model '{name}' has option timestep = {step:g} s; the simulator's step is from {TIMESTEP_RANGE_S[0]:g} to"
            f" {TIMESTEP_RANGE_S[1]:g} s"
        )
    for field in _NOT_NEGATIVE:
        value = np.asarray(getattr(model, field))
        if np.any(bad := value < 0):
            got = float(value[bad].ravel()[0])
            raise ModelError(
                f"model '{name}' has {_where(model, field, bad)} = {got:g}; {field.partition('_')[2]} is at least 0"
            )
    for field in ("jnt_range", "tendon_range", "actuator_ctrlrange", "actuator_forcerange", "jnt_actfrcrange"):
        value = np.asarray(getattr(model, field))
        bad = value[:, 0] > value[:, 1]
        if np.any(bad):
            low, high = value[bad][0]
            raise ModelError(f"model '{name}' has {_where(model, field, bad)} = {low:g} to {high:g}, which is not a range")
    for what, value in _numbers(model):
        bad = ~np.isfinite(value) | (np.abs(value) > MAX_SI_VALUE)
        if np.any(bad):
            got = float(value[bad].ravel()[0])
            legal = "not finite (nan or inf)" if not np.isfinite(got) else f"beyond {MAX_SI_VALUE:g}"
            raise ModelError(f"model '{name}' holds a number that is {legal}: {_where(model, what, bad)} is {got:g}")


def _numbers(model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
    """Yield every array of floats of a model and of its options with its name."""
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
        if len(text) > MAX_NAME_LENGTH:
            raise ModelError(
                f"model '{name}' has a name of {len(text)} characters, '{one_line(shown(text, 40))}'; names have at most"
                f" {MAX_NAME_LENGTH}"
            )
        if text and not text.isprintable():
            raise ModelError(
                f"model '{name}' has a name with characters that cannot be shown: '{one_line(shown(text, 60))}'"
            )


def _where(model: mujoco.MjModel, field: str, bad: np.ndarray) -> str:
    """Return a field's name, with the name of the first bad element if the field belongs to elements."""
    prefix, _, rest = field.partition("_")
    row = int(np.argwhere(bad)[0][0])
    if prefix == "dof" and row < model.nv:
        prefix, row = "jnt", int(model.dof_jntid[row])
    kind = _OWNERS.get(prefix)
    if kind is None or not rest:
        return field
    element = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), row)
    return f"{rest} of {kind} {element or row}"


NOTHING_SELECTED = Selection()
# What was compiled in a `compiled_once` block; None outside.
_ALREADY: contextvars.ContextVar[dict | None] = contextvars.ContextVar("already", default=None)


@contextlib.contextmanager
def compiled_once() -> Iterator[None]:
    """Compile each selection of a model once in the block, in which its files do not change."""
    token = _ALREADY.set({})
    try:
        yield
    finally:
        _ALREADY.reset(token)


@one_thread_at_a_time
def compile_model(
    source: str | Path, payload: Payload | None = None, selection: Selection = NOTHING_SELECTED, *, changes: bool = False
) -> tuple[str, mujoco.MjModel, tuple[str, ...]]:
    """Return a model's name, the compiled form of what is selected with the payload, and notes on what was left out.

    With `changes` its numbers can be changed: MuJoCo's compiler makes no use of bodies whose inertia is simple.

    Raises:
        ModelError: if the source is neither a built-in name, nor a readable file, nor MJCF text; if MuJoCo refuses it
            (with MuJoCo's reason); or if the payload's body is not in it.
    """
    already, asked = _ALREADY.get(), repr((str(source), payload, selection.table(), changes))
    if already is not None and asked in already:
        name, model, notes = already[asked]
        return name, copy.copy(model), notes
    name, _, model, notes = _compiled(source, payload, selection, changes)
    if already is not None:
        already[asked] = name, copy.copy(model), notes
    return name, model, notes


@one_thread_at_a_time
def model_spec(source: str | Path, payload: Payload | None = None, selection: Selection = NOTHING_SELECTED) -> mujoco.MjSpec:
    """Return the compiled specification of what is selected of a model, with the payload.

    Raises:
        ModelError: if the model does not compile, see `compile_model`.
    """
    return _compiled(source, payload, selection)[1]


def _compiled(
    source: str | Path, payload: Payload | None, selection: Selection, changes: bool = False
) -> tuple[str, mujoco.MjSpec, mujoco.MjModel, tuple[str, ...]]:
    with mujoco_warnings() as messages:
        try:
            name, spec, notes = _selected(source, selection)
            if payload is not None:
                attach(spec, payload)
            for body in spec.bodies if changes else ():
                body.simple = False
            spec.memory = min(spec.memory, 10**9)  # no mechanism needs more for its contacts; scenes ask for gigabytes
            with warnings.catch_warnings(record=True) as caught:  # MuJoCo's bindings issue some messages as Python warnings
                warnings.simplefilter("always")
                model = spec.compile()
        except UnicodeDecodeError as error:
            raise ModelError(f"model '{source}' has names that are not UTF-8 text") from error
        except (ValueError, RuntimeError, mujoco.FatalError) as error:
            what = "MJCF text" if is_text(str(source)) else source
            raise ModelError(f"model '{what}' does not compile: {one_line(error)}{compile_hint(error)}") from error
    messages += [str(one.message) for one in caught]
    refuse_unusable(name, model)
    if any("nan" in text.lower() for text in messages) or not np.all(np.isfinite(model.opt.gravity)):
        raise ModelError(
            f"model '{name}' holds a number that is not finite (nan or inf): {one_line(' '.join(messages)) or 'gravity'}"
        )
    for text in messages:
        warnings.warn(f"model '{name}': {one_line(text)}", RuntimeWarning, stacklevel=2)
    return name, spec, model, notes


def _selected(source: str | Path, selection: Selection) -> tuple[str, mujoco.MjSpec, tuple[str, ...]]:
    """Return a model's name, the specification of what is selected, and notes on what was left out."""
    name, spec, notes = _read_spec(source)
    built_in = str(source) in MODELS
    root = None if built_in else urdf_root(source)
    if root is not None:
        notes += complete(spec, source, root)
    else:
        notes += () if built_in or is_text(str(source)) else leave_out_missing_files(spec, Path(source))
        notes += _angle_note(spec)
    _name_all(spec.bodies, "body")
    if selection:
        _name_all(spec.joints, "joint")
        # Deletion is slow in a compiled specification, which holds its meshes. Compilation may fuse its bodies, though.
        notes += select(spec, (spec if spec.compiler.fusestatic else spec.copy()).compile(), selection)
    notes += couple_narrow_tendons(spec) if spec.tendons else ()
    if root is not None:
        notes += tuple(conversion_notes(root, driven=len(spec.actuators) > 0))
    return name, spec, notes


def _angle_note(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Return a note if all hinges' ranges, which are read in degrees, are so small that radians may be meant."""
    hinges = (
        [joint.range for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE] if spec.compiler.degree else []
    )
    largest = float(np.abs(hinges).max(initial=0.0))
    if not 0 < largest <= np.radians(360):
        return ()
    return (
        f'the largest range of a hinge ends at {largest:.3g} deg: a file that means radians has <compiler angle="radian"/>',
    )


def _name_all(elements: Sequence, kind: str) -> None:
    """Give every element without a name one, its kind and its place, which is its number in the compiled model."""
    taken = {element.name for element in elements}
    for place, element in enumerate(elements):
        if not element.name:
            element.name = next(name for n in itertools.count(place) if (name := f"{kind}{n}") not in taken)
            taken.add(element.name)


def built_in_text(name: str) -> str:
    """Return the MJCF text of a built-in model."""
    return resources.files("linkplan.models").joinpath("mjcf").joinpath(f"{name}.xml").read_text(encoding="utf-8")


def _read_spec(source: str | Path) -> tuple[str, mujoco.MjSpec, tuple[str, ...]]:
    """Return a model's name, its specification, and notes on what its files do not give it."""
    text = str(source)
    if text in MODELS:
        return text, _parse(text, built_in_text(text)), ()
    if is_text(text):
        refuse_oversized(text.encode("utf-8", "replace"), "MJCF text")
        spec = _parse("MJCF text", text)
        return spec.modelname or "MJCF text", spec, leave_out_large_textures(spec, [Path()])
    refusals = (
        (not text.isprintable(), f"a model's name has characters that cannot be shown: '{text}'"),
        (os.path.isdir(text), f"model '{text}' is a folder; a model is an MJCF file or a built-in name"),
        (not os.path.exists(text), unknown_source("model", text, MODELS)),
    )
    for refused, message in refusals:
        if refused:
            raise ModelError(message)
    return _read_file(Path(text))


def _read_file(path: Path) -> tuple[str, mujoco.MjSpec, tuple[str, ...]]:
    """Return the name of the model in a file, its specification, and notes on what was left out."""
    content = read_file(path, f"model '{path}'", MAX_MODEL_BYTES, ModelError)
    if not content.strip():
        raise ModelError(f"model '{path}' is empty; a model is an MJCF file")
    refuse_oversized(content, f"model '{path}'")
    parts = {str(path): content} | _included(content, path.parent, {})
    old = [word for part in parts.values() for word in _RETIRED.findall(COMMENT.sub(b"", part))]
    retired = ", ".join(dict.fromkeys(word.decode() for word in old))
    words = [word for part in parts.values() for word in _ATTACHED.findall(COMMENT.sub(b"", part))]
    names = [word.decode("utf-8", "replace") for word in words]
    attached = {name: place for name in names if (place := path.parent / name).is_file()}
    spec = _spec_of(
        path, {name: _RETIRED.sub(b"", part) for name, part in parts.items()} if old else parts, edited=bool(old)
    )
    folders = dict.fromkeys([path.parent, *(place.parent for place in attached.values())])
    notes = (f"attributes of an older MuJoCo are left out: {retired}",) if retired else ()
    return shown(path.stem), spec, (*notes, *_lost_in(attached), *leave_out_large_textures(spec, folders))


def _spec_of(path: Path, parts: dict[str, bytes], *, edited: bool) -> mujoco.MjSpec:
    """Return the specification of a model's file with its included files; `edited` contents replace those on the disk."""
    try:
        if path.suffix != ".mjcf" and path.suffix.islower():
            return mujoco.MjSpec.from_file(str(path), include=parts if edited else None)
        spec = mujoco.MjSpec.from_string(parts.pop(str(path)).decode("utf-8"), parts)  # it reads no .mjcf or .URDF
    except (ValueError, mujoco.FatalError) as error:
        if _PART_OF_A_MODEL in str(error):
            raise ModelError(f"model '{path}' is a part that other models include; take a file that includes it") from error
        named = "" if path.suffix.lower() in (".xml", ".urdf") else "; model files are named .xml or .urdf"
        raise ModelError(f"model '{path}' does not parse: {one_line(error)}{named}") from error
    spec.modelfiledir = str(path.parent.resolve())
    return spec


def _included(content: bytes, folder: Path, found: dict[str, bytes]) -> dict[str, bytes]:
    """Return the files that a model includes, also through included ones, by name; MuJoCo refuses missing ones."""
    for name in (word.decode("utf-8", "replace") for word in _INCLUDE.findall(COMMENT.sub(b"", content))):
        if name not in found and (folder / name).exists():  # MuJoCo would wait for a pipe
            found[name] = read_file(folder / name, f"'{name}'", MAX_MODEL_BYTES, ModelError)
            refuse_oversized(found[name], f"'{name}'")
            robot_element(found[name].decode("utf-8", "replace"), f"'{name}'")
            _included(found[name], folder, found)
    return found


def _lost_in(attached: Mapping[str, Path]) -> tuple[str, ...]:
    """Return notes on the closures and motors of attached URDFs, which MuJoCo leaves out."""
    notes = []
    for name, place in attached.items():
        root = urdf_root(place)
        lost = [] if root is None else lost_when_attached(root, place)
        if lost:
            notes.append(
                f"of the attached '{name}' are left out: {listed(lost, 6)}; write them in the file that attaches it"
            )
    return tuple(notes)


def _parse(name: str, text: str) -> mujoco.MjSpec:
    try:
        return mujoco.MjSpec.from_string(text)
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"model '{name}' does not parse: {one_line(error)}") from error
