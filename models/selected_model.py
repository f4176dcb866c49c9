"""A mechanism's model as MJCF text: what was selected of it, with its payload and the softness of its loops."""

import contextlib
import ctypes
import os
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from linkplan.models.kinematics import CONNECT, HINGE, tied_points
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
    _write_parameters(spec, mechanism)
    for equality, solref, solimp in zip(spec.equalities, model.eq_solref, model.eq_solimp, strict=True):
        equality.solref, equality.solimp = solref, solimp
    for closure in mechanism.closures:
        first, second = int(model.eq_obj1id[closure.index]), int(model.eq_obj2id[closure.index])
        if closure.kind in ("joint", "tendon") and second >= 0:  # a stiff one may be written the other way round
            coupling, named = spec.equalities[closure.index], model.joint if closure.kind == "joint" else model.tendon
            coupling.name1, coupling.name2 = named(first).name, named(second).name
            coupling.data[:5] = model.eq_data[closure.index, :5]
    for index in {*mechanism.shifted, *_placed_anew(mechanism)}:
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


# Fields of a compiled model that parameters set: the elements of a specification with their attribute of that field.
_ELEMENTS = {
    "body_mass": ("bodies", "mass"), "body_ipos": ("bodies", "ipos"), "body_inertia": ("bodies", "inertia"),
    "body_pos": ("bodies", "pos"), "jnt_pos": ("joints", "pos"), "jnt_axis": ("joints", "axis"),
    "jnt_stiffness": ("joints", "stiffness"), "site_pos": ("sites", "pos"), "eq_data": ("equalities", "data"),
    "tendon_stiffness": ("tendons", "stiffness"), "tendon_damping": ("tendons", "damping"),
    "tendon_armature": ("tendons", "armature"), "tendon_frictionloss": ("tendons", "frictionloss"),
    "actuator_armature": ("actuators", "armature"), "actuator_damping": ("actuators", "damping"),
    "actuator_gear": ("actuators", "gear"),
}  # fmt: skip
# Those of degrees of freedom and of springs' rest positions, whose rows are the joint's.
_OF_JOINTS = {
    "dof_armature": "armature", "dof_damping": "damping", "dof_frictionloss": "frictionloss", "qpos_spring": "springref",
}  # fmt: skip


def _placed_anew(mechanism: Mechanism) -> list[int]:
    """Return the connects between bodies whose second end the compiler would place anew, as if parameters moved it."""
    model = mechanism.model
    if not any(one.moves_pins for one in mechanism.parameters):
        return []
    of_bodies = [one.index for one in mechanism.closures if one.kind == "point" and one.index < model.neq]
    kind = int(mujoco.mjtObj.mjOBJ_SITE)
    return [k for k in of_bodies if int(model.eq_type[k]) == CONNECT and int(model.eq_objtype[k]) != kind]


def _write_parameters(spec: mujoco.MjSpec, mechanism: Mechanism) -> None:
    """Write the values of a mechanism's parameters into the specification of its model."""
    model = mechanism.model
    for field, (row, *_) in (entry for one in mechanism.parameters for entry in one.sets):
        if field in _OF_JOINTS:
            rests = field == "qpos_spring"
            joint = int(np.flatnonzero(model.jnt_qposadr == row)[0] if rests else model.dof_jntid[row])
            element, attribute = spec.joints[joint], _OF_JOINTS[field]
        else:
            kind, attribute = _ELEMENTS[field]
            element = getattr(spec, kind)[row]
        value = getattr(model, field)[row]
        if field == "qpos_spring" and spec.compiler.degree and int(model.jnt_type[joint]) == HINGE:
            value = np.degrees(value)
        if field in ("body_mass", "body_ipos", "body_inertia"):
            body = spec.body(model.body(row).name)
            body.explicitinertial, body.mass, body.ipos = True, model.body_mass[row], model.body_ipos[row]
            body.iquat, body.inertia, body.fullinertia = model.body_iquat[row], model.body_inertia[row], [np.nan] * 6
        elif isinstance(getattr(element, attribute), np.ndarray):
            values = np.atleast_1d(value)
            getattr(element, attribute)[: len(values)] = values
        else:
            setattr(element, attribute, float(value))


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
