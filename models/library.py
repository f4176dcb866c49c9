"""Finding and compiling a model: a built-in name, a path to an MJCF file, or MJCF text."""

import itertools
import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from linkplan.models.catalogue import MODELS, built_in_text, is_text
from linkplan.models.errors import ModelError, one_line
from linkplan.models.missing_files import leave_out_missing_files
from linkplan.models.model_values import MAX_MODEL_BYTES, refuse_oversized, refuse_unusable
from linkplan.models.mujoco_warnings import mujoco_warnings
from linkplan.models.names import nearest
from linkplan.models.one_thread import one_thread_at_a_time
from linkplan.models.payload import Payload, attach
from linkplan.models.reading import read_file, shown
from linkplan.models.selection import Selection, select
from linkplan.models.urdf import mesh_hint, urdf_root
from linkplan.models.urdf_loops import complete

NOTHING_SELECTED = Selection()


@one_thread_at_a_time
def compile_model(
    source: str | Path, payload: Payload | None = None, selection: Selection = NOTHING_SELECTED
) -> tuple[str, mujoco.MjModel, tuple[str, ...]]:
    """Return a model's name, the compiled form of what is selected with the payload, and notes on what was left out.

    Raises:
        ModelError: if the source is neither a built-in name, nor a readable file, nor MJCF text; if MuJoCo refuses it
            (with MuJoCo's reason); or if the payload's body is not in it.
    """
    name, _, model, notes = _compiled(source, payload, selection)
    return name, model, notes


@one_thread_at_a_time
def model_spec(source: str | Path, payload: Payload | None = None, selection: Selection = NOTHING_SELECTED) -> mujoco.MjSpec:
    """Return the compiled specification of what is selected of a model, with the payload.

    Raises:
        ModelError: if the model does not compile, see `compile_model`.
    """
    return _compiled(source, payload, selection)[1]


def _compiled(
    source: str | Path, payload: Payload | None, selection: Selection
) -> tuple[str, mujoco.MjSpec, mujoco.MjModel, tuple[str, ...]]:
    with mujoco_warnings() as messages:
        try:
            name, spec, notes = _selected(source, selection)
            if payload is not None:
                attach(spec, payload)
            with warnings.catch_warnings(record=True) as caught:  # MuJoCo's bindings issue some messages as Python warnings
                warnings.simplefilter("always")
                model = spec.compile()
        except UnicodeDecodeError as error:
            raise ModelError(f"model '{source}' has names that are not UTF-8 text") from error
        except (ValueError, RuntimeError, mujoco.FatalError) as error:
            what = "MJCF text" if is_text(str(source)) else source
            raise ModelError(f"model '{what}' does not compile: {one_line(error)}{mesh_hint(error)}") from error
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
    name, spec = _read_spec(source)
    root = urdf_root(source)
    if root is not None:
        notes = complete(spec, source, root)
    else:
        notes = () if is_text(str(source)) or str(source) in MODELS else leave_out_missing_files(spec, Path(source))
    _name_all(spec.bodies, "body")
    if not selection:
        return name, spec, notes
    _name_all(spec.joints, "joint")
    return name, spec, (*notes, *select(spec, spec.compile(), selection))


def _name_all(elements: Sequence, kind: str) -> None:
    """Give every element without a name one, its kind and its place, which is its number in the compiled model."""
    taken = {element.name for element in elements}
    for place, element in enumerate(elements):
        if not element.name:
            element.name = next(name for n in itertools.count(place) if (name := f"{kind}{n}") not in taken)
            taken.add(element.name)


def _read_spec(source: str | Path) -> tuple[str, mujoco.MjSpec]:
    text = str(source)
    if not text.isprintable() and not is_text(text):
        raise ModelError(f"a model's name has characters that cannot be shown: '{text}'")
    if text in MODELS:
        return text, _parse(text, built_in_text(text))
    if is_text(text):
        refuse_oversized(text.encode("utf-8", "replace"), "MJCF text")
        spec = _parse("MJCF text", text)
        return spec.modelname or "MJCF text", spec
    path = Path(text)
    if os.path.isdir(path):
        raise ModelError(f"model '{text}' is a folder; a model is an MJCF file or a built-in name")
    if not os.path.exists(path):
        raise ModelError(
            f"unknown model '{shown(text)}'{nearest(text, MODELS)}: neither a built-in name ({', '.join(MODELS)}) nor a file"
        )
    content = read_file(path, f"model '{text}'", MAX_MODEL_BYTES, ModelError)
    if not content.strip():
        raise ModelError(f"model '{text}' is empty; a model is an MJCF file")
    refuse_oversized(content, f"model '{text}'")
    try:
        return shown(path.stem), mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        named = "" if path.suffix.lower() in (".xml", ".urdf") else "; model files are named .xml or .urdf"
        raise ModelError(f"model '{text}' does not parse: {one_line(error)}{named}") from error


def _parse(name: str, text: str) -> mujoco.MjSpec:
    try:
        return mujoco.MjSpec.from_string(text)
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"model '{name}' does not parse: {one_line(error)}") from error
