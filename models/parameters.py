"""Parameters: numbers of a model that have a name, a unit and a value.

A parameter sets entries of the compiled model, each a function of its value. One description serves both sides: values are
written into the compiled model, which is simulated, and symbols stand in its place in the equations (`SymbolicModel`).

    body.mass, body.com_x, body.inertia_x     mass, centre of mass, moments about the principal axes
    body.pos_x                                place of the body's frame in its parent, with all that hangs on it
    body.length                               distance of the two pins of a link that has exactly two
    joint.pos_x, joint.axis_x                 anchor and axis in the body's frame
    joint.armature, damping, friction, stiffness, rest
    site.pos_x                                place of a site in its body
    closure.pos_x                             point of a connect or weld in its first body
    closure.ratio, closure.offset             of a coupling y = offset + ratio x + ...
    tendon.stiffness, damping, armature, friction
    actuator.gear, armature, damping
    payload.mass, com_x, inertia_x            of the problem's payload

A link's second pin moves along the line from the first; what hangs on it moves along, and the link's mass, centre of mass
and inertia stay. An element's quantities are named after it; where two elements share a name and a quantity, the name begins
with the kind: "actuator A.armature".
"""

import copy
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.closure.equations import equality_name
from linkplan.models.errors import ModelError, nearest
from linkplan.models.kinematics import BALL, FREE, HINGE, SLIDE, joints_of, make_dry, tied_points
from linkplan.models.payload import BODY_NAME
from linkplan.models.symbolic_model import Entry, SymbolicModel
from linkplan.models.tree.coordinates import joint_label, rotation_from_quaternion
from linkplan.models.tree.tendons import tendon_label

# Pins of a link nearer to one another than this share of its size are one pin.
_SAME_PIN = 1e-9
# MuJoCo's least mass [kg] and moment of inertia [kg m2] of a body with joints (mjMINVAL).
_LEAST_INERTIA = 1e-15
# Names that the elements of a model's payload have.
_PAYLOAD = "payload"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Parameter:
    """A number of a model: its name, unit and value in SI, its least value, and the entries that it sets.

    Each entry of the compiled model is affine in the parameter: `sets` has its value at zero and its slope.
    """

    name: str
    unit: str
    value: float
    least: float = -np.inf
    sets: Mapping[Entry, tuple[float, float]]

    def entries(self, value: Any) -> dict[Entry, Any]:
        """Return each number of the compiled model that the parameter sets, for a value or its symbol."""
        return {entry: at_zero + slope * value for entry, (at_zero, slope) in self.sets.items()}

    @property
    def moves_pins(self) -> bool:
        """Whether the parameter changes where pins, axes and sites are, and with them the closed poses."""
        return any(field in _GEOMETRY for field, _ in self.sets)


_GEOMETRY = {"body_pos", "jnt_pos", "jnt_axis", "site_pos", "eq_data"}


def parameters_of(model: mujoco.MjModel) -> dict[str, Parameter]:
    """Return all numbers of a compiled model that can be parameters, by name."""
    found: dict[str, list[tuple[str, Parameter]]] = {}
    for kind, one in _every(model):
        found.setdefault(one.name, []).append((kind, one))
    named: dict[str, Parameter] = {}
    for name, of_name in found.items():
        for kind, one in of_name:
            own = name if len(of_name) == 1 else f"{kind} {name}"
            named[own] = Parameter(name=own, unit=one.unit, value=one.value, least=one.least, sets=one.sets)
    return named


def chosen_parameters(model: mujoco.MjModel, names: Iterable[str]) -> tuple[Parameter, ...]:
    """Return parameters of a model by their names.

    Raises:
        ModelError: if the model has none of that name, or two of them set the same number.
    """
    known = parameters_of(model)
    chosen = tuple(_named(known, name) for name in names)
    owner: dict[Entry, str] = {}
    for one in chosen:
        for entry in one.sets:
            if entry in owner:
                raise ModelError(f"parameters '{owner[entry]}' and '{one.name}' set the same number of the model")
            owner[entry] = one.name
    return chosen


def _named(known: Mapping[str, Parameter], name: str) -> Parameter:
    """Return one of a model's parameters.

    Raises:
        ModelError: if there is none of this name, or elements of several kinds have it.
    """
    if name in known:
        return known[name]
    several = [one for one in known if one.partition(" ")[2] == name]
    if several:
        raise ModelError(f"parameter '{name}' is that of several elements: write {' or '.join(map(repr, several))}")
    raise ModelError(f"unknown parameter '{name}'{nearest(name, list(known))}; `check` with `parameters` lists all")


def set_parameters(model: mujoco.MjModel, values: Mapping[str, float | None]) -> tuple[Parameter, ...]:
    """Write values [SI] by name into a compiled model; return its payload's parameters and the named ones.

    None keeps the model's own value.

    Raises:
        ModelError: for a name that the model has not, two parameters that set the same number, or a value out of bounds.
    """
    carries = any(model.body(body).name == BODY_NAME for body in range(model.nbody))
    payload = [name for name in parameters_of(model) if name.startswith(f"{_PAYLOAD}.")] if carries else []
    names = (*payload, *(name for name in values if name not in payload))
    written = {name: value for name, value in values.items() if value is not None}
    if written:
        write_values(model, chosen_parameters(model, written), list(written.values()))
    return chosen_parameters(model, names)


def is_payload_s_weight(name: str) -> bool:
    """Return whether a parameter of this name is a payload's mass or one of its moments of inertia."""
    return name.startswith((f"{_PAYLOAD}.mass", f"{_PAYLOAD}.inertia"))


def is_of_forces(one: Parameter) -> bool:
    """Return whether a parameter changes the forces that a motion needs, and neither poses nor moment arms."""
    return not one.moves_pins and not any(field == "actuator_gear" for field, _ in one.sets)


def is_affine_in_efforts(one: Parameter) -> bool:
    """Return whether the efforts that a motion needs are affine in a parameter, the others fixed.

    They are in masses, moments of inertia, armatures, damping and springs. They are quadratic in a centre of mass, and a
    pin, an axis or a gear changes poses or moment arms.
    """
    return is_of_forces(one) and not any(field == "body_ipos" for field, _ in one.sets)


def with_symbols(model: mujoco.MjModel, parameters: Sequence[Parameter], symbols: ca.SX) -> mujoco.MjModel:
    """Return a model to read equations from, with symbols (n,) in place of its parameters."""
    entries: dict[Entry, ca.SX] = {}
    for one, symbol in zip(parameters, ca.vertsplit(symbols), strict=True):
        entries |= {entry: ca.SX(value) for entry, value in one.entries(symbol).items()}
    return cast("mujoco.MjModel", SymbolicModel(model, entries))  # it is read like a compiled model


def write_values(model: mujoco.MjModel, parameters: Sequence[Parameter], values: Sequence[float]) -> None:
    """Write values [SI] of parameters into a compiled model, and what follows from them.

    Raises:
        ModelError: for a value out of its bounds, or an inertia that no body can have.
    """
    for one, value in zip(parameters, values, strict=True):
        if not (np.isfinite(value) and value >= one.least):
            bound = f"a number of at least {one.least:g} {one.unit}" if np.isfinite(one.least) else "a finite number"
            raise ModelError(f"parameter '{one.name}' must be {bound}, got {value:g}")
        for (field, index), entry in one.entries(float(value)).items():
            getattr(model, field)[index] = float(entry)
    lengths = np.linalg.norm(model.jnt_axis, axis=1)
    if np.any(lengths < _SAME_PIN):
        raise ModelError(f"the axis of joint '{joint_label(model, int(np.argmin(lengths)))}' has no direction")
    model.jnt_axis[:] /= np.where(np.abs(lengths - 1) > 1e-15, lengths, 1.0)[:, None]
    for body in range(1, model.nbody):
        moments = np.sort(model.body_inertia[body])
        if moments[2] > moments[:2].sum() * (1 + 1e-9) or moments[0] < 0:  # 1e-9 is rounding of typed numbers
            raise ModelError(
                f"body '{model.body(body).name}' is no rigid body: its largest moment exceeds the sum of the other two, got"
                f" {model.body_inertia[body].tolist()} kg m2"
            )
    derive(model)


def derive(model: mujoco.MjModel) -> None:
    """Compute what MuJoCo derives from the numbers of a model, except places and lengths that are numbers of their own.

    MuJoCo would place the second end of each connect and weld between bodies, and the reference lengths of tendons, anew.
    """
    make_dry(model, model.dof_frictionloss > 0)
    _separate_frames(model)
    kept = {name: getattr(model, name).copy() for name in ("eq_data", "tendon_length0", "tendon_lengthspring")}
    mujoco.mj_setConst(model, mujoco.MjData(model))
    for name, values in kept.items():
        getattr(model, name)[:] = values


def _separate_frames(model: mujoco.MjModel) -> None:
    """Clear the compiler's marks of coinciding frames, with which MuJoCo ignores places, where they no longer coincide."""
    for kind, owner in (("body", np.arange(model.nbody)), ("site", model.site_bodyid), ("geom", model.geom_bodyid)):
        place = model.body_ipos if kind == "body" else getattr(model, f"{kind}_pos")
        same = getattr(model, f"{kind}_sameframe")
        of_inertia = same == int(mujoco.mjtSameFrame.mjSAMEFRAME_INERTIA)
        origin = np.where(of_inertia[:, None], model.body_ipos[owner], 0.0)
        marked = of_inertia | (same == int(mujoco.mjtSameFrame.mjSAMEFRAME_BODY))
        same[marked & np.any(place != origin, axis=1)] = 0


def without_values(model: mujoco.MjModel, parameters: Sequence[Parameter]) -> mujoco.MjModel:
    """Return a copy of a model that does not depend on the values of parameters: every number that they set is one."""
    if not parameters:
        return model
    model = copy.copy(model)
    for one in parameters:
        for field, index in one.sets:
            getattr(model, field)[index] = 1.0
    derive(model)
    model.stat.meanmass, model.stat.meaninertia = 1.0, 1.0  # means over bodies, which only the simulator uses
    return model


def _every(model: mujoco.MjModel) -> Iterator[tuple[str, Parameter]]:
    for body in range(1, model.nbody):
        yield from (("body", one) for one in _of_body(model, body))
    for joint in range(model.njnt):
        yield from (("joint", one) for one in _of_joint(model, joint))
    for site in range(model.nsite):
        if name := model.site(site).name:
            yield from (("site", one) for one in _axes(model, f"{name}.pos", "m", "site_pos", site))
    for index in np.flatnonzero(model.eq_active0).tolist():
        yield from (("closure", one) for one in _of_closure(model, index))
    for tendon in range(model.ntendon):
        yield from (("tendon", one) for one in _of_tendon(model, tendon))
    for actuator in range(model.nactuator):
        yield from (("actuator", one) for one in _of_actuator(model, actuator))


def _plain(model: mujoco.MjModel, name: str, unit: str, field: str, *index: int, least: float = -np.inf) -> Parameter:
    """Return the parameter that is one number of a model."""
    value = float(getattr(model, field)[index])
    return Parameter(name=name, unit=unit, value=value, least=least, sets={(field, index): (0.0, 1.0)})


def _axes(
    model: mujoco.MjModel, name: str, unit: str, field: str, row: int, first: int = 0, least: float = -np.inf
) -> list[Parameter]:
    """Return the three parameters x, y and z of a row of a field, from its column `first` on."""
    return [_plain(model, f"{name}_{axis}", unit, field, row, first + k, least=least) for k, axis in enumerate("xyz")]


def _of_body(model: mujoco.MjModel, body: int) -> Iterator[Parameter]:
    own = model.body(body).name
    name = _PAYLOAD if own == BODY_NAME else own
    if not name:
        return
    if model.body_weldid[body] != 0:
        least = _LEAST_INERTIA if model.body_dofnum[body] else 0.0  # of a body with joints, as MuJoCo's compiler requires
        yield _plain(model, f"{name}.mass", "kg", "body_mass", body, least=least)
        yield from _axes(model, f"{name}.com", "m", "body_ipos", body)
        yield from _axes(model, f"{name}.inertia", "kg m2", "body_inertia", body, least=least)
    if own != BODY_NAME and not any(int(model.jnt_type[joint]) == FREE for joint in joints_of(model, body)):
        yield from _axes(model, f"{name}.pos", "m", "body_pos", body)
    length = _length(model, body, name)
    if length is not None:
        yield length


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Pin:
    """A pin of a link: its place (3,) [m] in the link's frame, whether it is its own joint, and what moves with it."""

    place: np.ndarray
    own: bool
    moves: list[tuple[str, int, int]]  # field, row and first column of places in the link's frame


def _pins(model: mujoco.MjModel, body: int) -> list[_Pin]:
    """Return the pins of a body at its reference pose: its own joint, its children's joints, and its closures' points."""
    found: list[tuple[np.ndarray, bool, list[tuple[str, int, int]]]] = []
    for joint in joints_of(model, body):
        if int(model.jnt_type[joint]) in (HINGE, BALL):
            found.append((np.array(model.jnt_pos[joint]), True, []))
    for child in range(body + 1, model.nbody):
        if int(model.body_parentid[child]) != body:
            continue
        hinges = [joint for joint in joints_of(model, child) if int(model.jnt_type[joint]) in (HINGE, BALL)]
        turn = rotation_from_quaternion(model.body_quat[child])
        for joint in hinges[:1]:
            place = model.body_pos[child] + turn @ model.jnt_pos[joint]
            found.append((place, False, [("body_pos", child, 0)]))
    for index in np.flatnonzero(model.eq_active0).tolist():
        found += [(place, False, moves) for place, moves in _tied(model, index, body)]
    size = max((float(np.linalg.norm(place)) for place, _, _ in found), default=0.0)
    pins: list[_Pin] = []
    for place, own, moves in found:
        same = next((pin for pin in pins if np.linalg.norm(pin.place - place) <= _SAME_PIN * size), None)
        if same is None:
            pins.append(_Pin(place=place, own=own, moves=list(moves)))
        else:
            same.moves.extend(moves)
    for site in range(model.nsite):
        for pin in pins:
            if int(model.site_bodyid[site]) == body and np.linalg.norm(pin.place - model.site_pos[site]) <= _SAME_PIN * size:
                pin.moves.append(("site_pos", site, 0))
    return pins


def _tied(model: mujoco.MjModel, index: int, body: int) -> Iterator[tuple[np.ndarray, list[tuple[str, int, int]]]]:
    """Return a closure's points on a body (3,) [m], each with its own place in the model; a site's is the site."""
    at_sites = int(model.eq_objtype[index]) == int(mujoco.mjtObj.mjOBJ_SITE)
    for end, (tied, place) in enumerate(tied_points(model, index)):
        if tied == body:
            column = 3 * end if int(model.eq_type[index]) == int(mujoco.mjtEq.mjEQ_CONNECT) else 3 * (1 - end)
            yield np.array(place), [] if at_sites else [("eq_data", index, column)]


def link_size(model: mujoco.MjModel, body: int) -> Parameter:
    """Return the factor on a link's size: it scales all points fixed to the link, and to a payload, about its joint."""
    joints = joints_of(model, body)
    about = model.jnt_pos[joints[0]].copy() if len(joints) else np.zeros(3)
    places = [(field, (row, start + k), at[k]) for field, row, start, at in _fixed(model, body, about) for k in range(3)]
    sets = {(field, at): (float(centre), float(getattr(model, field)[at] - centre)) for field, at, centre in places}
    return Parameter(name=f"size of {model.body(body).name}", unit="", value=1.0, least=_SAME_PIN, sets=sets)


def _fixed(model: mujoco.MjModel, body: int, about: np.ndarray) -> Iterator[tuple[str, int, int, np.ndarray]]:
    """Return the places fixed to a body as field, row and first column, each with the point that it is scaled about."""
    yield "body_ipos", body, 0, about
    for field, owner in (
        ("body_pos", model.body_parentid),
        ("site_pos", model.site_bodyid),
        ("geom_pos", model.geom_bodyid),
    ):
        yield from ((field, row, 0, about) for row in np.flatnonzero(owner == body).tolist())
    for index in range(model.neq):
        yield from ((*move, about) for _, moves in _tied(model, index, body) for move in moves)
    for child in np.flatnonzero(model.body_parentid == body).tolist():
        if child != body and model.body_dofnum[child] == 0:
            yield from _fixed(model, child, np.zeros(3))


def _length(model: mujoco.MjModel, body: int, name: str) -> Parameter | None:
    """Return the distance of the two pins of a link, or None if it has not exactly two."""
    pins = _pins(model, body)
    if len(pins) != 2:
        return None
    first, second = pins if pins[0].own or not pins[1].own else pins[::-1]
    if second.own:
        return None
    way = second.place - first.place
    length = float(np.linalg.norm(way))
    places = [(field, (row, start + k), way[k]) for field, row, start in second.moves for k in range(3) if way[k]]
    sets = {(field, at): (float(getattr(model, field)[at] - along), float(along / length)) for field, at, along in places}
    return Parameter(name=f"{name}.length", unit="m", value=length, least=_SAME_PIN, sets=sets)


def _of_joint(model: mujoco.MjModel, joint: int) -> Iterator[Parameter]:
    name, kind, dof = joint_label(model, joint), int(model.jnt_type[joint]), int(model.jnt_dofadr[joint])
    if kind in (HINGE, BALL):
        yield from _axes(model, f"{name}.pos", "m", "jnt_pos", joint)
    if kind not in (HINGE, SLIDE):
        return
    position, effort = ("rad", "N.m") if kind == HINGE else ("m", "N")
    yield from _axes(model, f"{name}.axis", "", "jnt_axis", joint)
    yield _plain(model, f"{name}.armature", "kg m2" if kind == HINGE else "kg", "dof_armature", dof, least=0.0)
    yield _plain(model, f"{name}.damping", f"{effort}.s/{position}", "dof_damping", dof, least=0.0)
    yield _plain(model, f"{name}.friction", effort, "dof_frictionloss", dof, least=0.0)
    yield _plain(model, f"{name}.stiffness", f"{effort}/{position}", "jnt_stiffness", joint, least=0.0)
    yield _plain(model, f"{name}.rest", position, "qpos_spring", int(model.jnt_qposadr[joint]))


def _of_closure(model: mujoco.MjModel, index: int) -> Iterator[Parameter]:
    name, ends = equality_name(model, index), tied_points(model, index)
    if not ends:
        yield _plain(model, f"{name}.offset", "", "eq_data", index, 0)
        if int(model.eq_obj2id[index]) >= 0:
            yield _plain(model, f"{name}.ratio", "", "eq_data", index, 1)
    elif int(model.eq_objtype[index]) != int(mujoco.mjtObj.mjOBJ_SITE):  # the point of a site is the site's
        first = 0 if int(model.eq_type[index]) == int(mujoco.mjtEq.mjEQ_CONNECT) else 3
        yield from _axes(model, f"{name}.pos", "m", "eq_data", index, first)


def _of_tendon(model: mujoco.MjModel, tendon: int) -> Iterator[Parameter]:
    name = tendon_label(model, tendon)
    units = {"stiffness": "N/m", "damping": "N.s/m", "armature": "kg", "frictionloss": "N"}
    for field, unit in units.items():
        yield _plain(model, f"{name}.{field.removesuffix('loss')}", unit, f"tendon_{field}", tendon, least=0.0)


def _of_actuator(model: mujoco.MjModel, actuator: int) -> Iterator[Parameter]:
    name = model.actuator(actuator).name
    if not name:
        return
    if int(model.actuator_trntype[actuator]) != int(mujoco.mjtTrn.mjTRN_SITE):
        yield _plain(model, f"{name}.gear", "", "actuator_gear", int(model.actuator_outadr[actuator]), 0)
    yield _plain(model, f"{name}.armature", "kg m2", "actuator_armature", actuator, least=0.0)
    yield _plain(model, f"{name}.damping", "N.m.s/rad", "actuator_damping", actuator, least=0.0)
