"""[parameters]: the numbers of the model that are named, their values and ranges, and the box of machines of [robust]."""

from collections.abc import Mapping
from typing import Any

from linkplan.models.errors import ProblemError, nearest
from linkplan.models.mechanism import Mechanism
from linkplan.models.parameters import is_affine_in_efforts, is_payload_s_weight
from linkplan.planner.problem.keys.reading import kind_of, read
from linkplan.planner.problem.keys.sections import ParameterTable, ProblemFile

# Keys of an actuator in [mechanism] that set the same number as a quantity of a parameter.
_OF_ACTUATORS = {"gear": "gear", "rotor_inertia": "armature"}
# Keys of a payload with the names of the parameters that are their numbers.
_OF_PAYLOADS = {
    "mass_kg": ("payload.mass",),
    "com_m": tuple(f"payload.com_{axis}" for axis in "xyz"),
    "inertia_kgm2": tuple(f"payload.inertia_{axis}" for axis in "xyz"),
}


def read_parameters(tables: Mapping[str, Any]) -> dict[str, ParameterTable]:
    """Return the decoded tables of [parameters] by name; a number is a table with that value.

    Raises:
        ProblemError: for a value or a table that is not legal.
    """
    found = read(kind_of("parameters"), dict(tables), "parameters")
    return {name: one if isinstance(one, ParameterTable) else ParameterTable(value=one) for name, one in found.items()}


def parameter_values(tables: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the values [SI] of a table [parameters], None where the model's own is kept."""
    return {name: one.value for name, one in read_parameters(tables).items()}


def refuse_two_values(section: Mapping[str, Any], tables: Mapping[str, Any]) -> None:
    """Refuse a number that a table [mechanism] and a table [parameters] both set, and not to one value."""
    values = parameter_values(tables)
    for key, quantity in _OF_ACTUATORS.items():
        for actuator in section.get(key, {}):
            if {f"{actuator}.{quantity}", f"actuator {actuator}.{quantity}"} & values.keys():
                raise ProblemError(f"mechanism.{key} and parameters.'{actuator}.{quantity}' set the same number; keep one")
    payload = section.get("payload")
    for key, names in _OF_PAYLOADS.items() if isinstance(payload, Mapping) else ():
        given = payload.get(key)
        for name, number in zip(names, given if isinstance(given, list) else [given], strict=False):
            value = values.get(name)
            if number is not None and value is not None and value != number:
                raise ProblemError(
                    f"mechanism.payload.{key} is {number:g}, but parameters.'{name}' {value:g}; keep one of them"
                )


def ranges_of(tables: Mapping[str, ParameterTable], mechanism: Mechanism) -> dict[str, tuple[float, float]]:
    """Return the ranges [SI] of the parameters that have one.

    Raises:
        ProblemError: for a range that does not contain the value.
    """
    values = {one.name: one.value for one in mechanism.parameters}
    found = {name: (one.range[0], one.range[1]) for name, one in tables.items() if one.range is not None}
    for name, (low, high) in found.items():
        if not low <= values[name] <= high:
            raise ProblemError(
                f"parameters.'{name}'.range must contain the value {values[name]:.6g}, got [{low:g}, {high:g}]"
            )
    return found


def box_of(asked: ProblemFile, mechanism: Mechanism) -> tuple[tuple[str, float, float], ...]:
    """Return the parameters that [robust] names, with the ends of their ranges [SI].

    Raises:
        ProblemError: for a range that does not contain the value, a name without a range or named twice, or a number whose
            corners say nothing on the machines between them.
    """
    known = {one.name: one for one in mechanism.parameters}
    tables, named = read_parameters(asked.to_dict().get("parameters", {})), asked.robust.parameters
    ranges = ranges_of(tables, mechanism)
    for name in named:
        if name not in tables:
            raise ProblemError(
                f"robust.parameters names '{name}', which is not in [parameters]{nearest(name, list(tables))}"
            )
        if name not in ranges:
            given = f"those with one are {', '.join(ranges)}" if ranges else "none has one"
            raise ProblemError(f"robust.parameters names '{name}', which needs a range in [parameters]; {given}")
        if named.count(name) > 1:
            raise ProblemError(f"robust.parameters names '{name}' twice")
        if is_payload_s_weight(name) and tuple(asked.robust.payload_factor) != (1.0, 1.0):
            raise ProblemError(f"robust.payload_factor and robust.parameters both vary '{name}'; keep one")
        if name.endswith(".friction"):
            raise ProblemError(f"robust.parameters names '{name}'; ranges of dry friction are robust.coulomb_friction")
        if not is_affine_in_efforts(known[name]):
            raise ProblemError(
                f"robust.parameters names '{name}', in which efforts are not affine, so that corners say nothing on machines"
                " between them; legal are masses, moments of inertia, armatures, damping and springs"
            )
    return tuple((name, *ranges[name]) for name in named)
