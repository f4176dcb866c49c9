"""A mechanism's model as MJCF text: what was selected of it, with its payload and the softness of its loops."""

import contextlib
import ctypes
import os
from collections.abc import Iterator
from pathlib import Path

import mujoco

from linkplan.models.kinematics import tied_points
from linkplan.models.library import model_spec
from linkplan.models.mechanism import Mechanism

# Digits that restore a double from its decimal text.
_EXACT_DIGITS = 17


def whole_model_text(mechanism: Mechanism) -> str:
    """Return the MJCF text of a mechanism's model, exact to the last digit."""
    return exact_text(whole_spec(mechanism))


def exact_text(spec: mujoco.MjSpec) -> str:
    """Return a specification as MJCF text with all digits of its numbers."""
    with _exact_numbers():
        return spec.to_xml()


def whole_spec(mechanism: Mechanism) -> mujoco.MjSpec:
    """Return the specification of a mechanism's model; folders of meshes are absolute, so that a file of it can be moved."""
    source, model = str(mechanism.source["model"]), mechanism.model
    spec = model_spec(source, mechanism.payload, mechanism.selection)
    for equality, solref, solimp in zip(spec.equalities, model.eq_solref, model.eq_solimp, strict=True):
        equality.solref, equality.solimp = solref, solimp
    for closure in mechanism.closures:
        first, second = int(model.eq_obj1id[closure.index]), int(model.eq_obj2id[closure.index])
        if closure.kind in ("joint", "tendon") and second >= 0:  # a stiff one may be written the other way round
            coupling, named = spec.equalities[closure.index], model.joint if closure.kind == "joint" else model.tendon
            coupling.name1, coupling.name2 = named(first).name, named(second).name
            coupling.data[:5] = model.eq_data[closure.index, :5]
    for index in mechanism.shifted:
        closure, name = spec.equalities[index], model.equality(index).name or f"closure {index}"
        for end, (body, place) in enumerate(tied_points(model, index), 1):
            on = spec.body(model.body(body).name) if body else spec.worldbody
            on.add_site(name=f"{name} anchor of end {end}", pos=place)
        closure.objtype = mujoco.mjtObj.mjOBJ_SITE
        closure.name1, closure.name2 = (f"{name} anchor of end {end}" for end in (1, 2))
    if os.path.isfile(source):
        folder = Path(source).resolve().parent
        spec.meshdir, spec.texturedir = str(folder / spec.meshdir), str(folder / spec.texturedir)
    return spec


@contextlib.contextmanager
def _exact_numbers() -> Iterator[None]:
    """Let MuJoCo write numbers with all their digits; by default it writes six, which opens loops by micrometres."""
    library = next(Path(mujoco.__file__).parent.glob("libmujoco.*"), None)
    precision = None if library is None else getattr(ctypes.CDLL(str(library)), "_mjPRIVATE__set_xml_precision", None)
    before = None if library is None else getattr(ctypes.CDLL(str(library)), "_mjPRIVATE__get_xml_precision", None)
    if precision is None or before is None:  # another version of MuJoCo
        yield
        return
    digits = before()
    precision(_EXACT_DIGITS)
    try:
        yield
    finally:
        precision(digits)
