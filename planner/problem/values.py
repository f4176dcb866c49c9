"""Conversion of a problem's values, and the joints that they belong to.

Illegal values are refused in one line that names the key of problem files. Values of joints stand in a table of joint =
value under a key that carries the unit. If a motion is stated in other joints than the driven ones, these become
independent.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.equilibrium import sprung_freedoms
from linkplan.planner.keys.kinds import AtLeastZero, Number, Positive, Section
from linkplan.planner.keys.reading import read

# The default of a field that __post_init__ sets: readers of the field find its type, and never None.
DERIVED: Any = None
# Keys with tables of joint = value in [motion], its waypoints and [reference].
_STATES = ("start", "goal", "start_speed", "goal_speed", "at", "speed", "amplitude", "bias")


def frozen(value: object) -> np.ndarray:
    """Return a read-only array of floats."""
    array = np.array(value, dtype=float)
    array.flags.writeable = False
    return array


def number(value: object, key: str, *, positive: bool = False, at_least_zero: bool = False) -> float:
    """Return a finite number.

    Raises:
        ProblemError: naming the key, when it is anything else.
    """
    kind: Any = Positive if positive else AtLeastZero if at_least_zero else Number
    return read(kind, plain(value), key)


def interval(value: list[float], key: str, *, point: bool = False) -> tuple[float, float]:
    """Return [low, high] with low < high, or low <= high for a `point`; ends may be infinite."""
    low, high = (end if np.isinf(end) else number(end, key) for end in value)
    if not (low < high or (point and low == high)):
        raise ProblemError(f"{key} is [low, high] with low {'<=' if point else '<'} high, got [{low:g}, {high:g}]")
    return low, high


def whole(value: object, key: str, low: int, high: int) -> int:
    """Return a whole number from `low` to `high`.

    Raises:
        ProblemError: naming the key, when it is anything else.
    """
    value = plain(value)
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ProblemError(f"{key} is a whole number from {low} to {high}, got {value!r}")
    return value


def plain(value: Any) -> Any:
    """Return a copy of a value in the types of a TOML file; values without such a type are returned unchanged."""
    if isinstance(value, np.generic | np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple | range):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, PurePath) else value


def joint_values(section: Section, key: str, table_name: str, mechanism: Mechanism) -> dict[int, Any]:
    """Return {joint index: value} of `key`_deg and `key`_m (before any _s), units checked against the joints.

    Raises:
        ProblemError: for an unknown joint, or a joint of the other kind.
    """
    found = {}
    stem, rate = (key[: -len("_s")], "_s") if key.endswith("_s") else (key, "")
    for unit, kind, other in (("deg", "hinge", "m"), ("m", "slide", "deg")):
        name = f"{stem}_{unit}{rate}"
        for joint, value in getattr(section, name).items():
            index = mechanism.joint_index(joint, ProblemError)
            if mechanism.joints[index].kind != kind:
                raise ProblemError(
                    f"joint '{joint}' is a {mechanism.joints[index].kind}; use {table_name}.{stem}_{other}{rate}, not {name}"
                )
            found[index] = value
    return found


def other_coordinates(tables: Mapping[str, dict], mechanism: Mechanism) -> list[str] | None:
    """Return the joints that a motion names and that should be independent; None to keep the mechanism's coordinates.

    The coordinates are kept if the motion names all independent joints, if mechanism.independent is given, or if it names
    more joints than there are degrees of freedom, because it is then unclear which of them follow from the loops.

    Args:
        tables: tables of a problem file.
        mechanism: with its default coordinates.
    """
    if "independent" in mechanism.source:
        return None
    named = [joint.name for joint in mechanism.joints if joint.name in set(_named(tables))]
    resting = {int(mechanism.independent[column]) for column in sprung_freedoms(mechanism)} | set(mechanism.passive_dofs)
    missing = [mechanism.joints[i].name for i in mechanism.independent.tolist() if i not in resting]
    missing = [name for name in missing if name not in named]
    others = set(named) - {joint.name for joint in mechanism.independent_joints}
    return named if missing and others and len(named) <= mechanism.dof else None


def coordinates_note(mechanism: Mechanism, named: list[str]) -> str:
    """Return the note that a motion is planned in the joints that it names."""
    unnamed = [joint.name for joint in mechanism.independent_joints if joint.name not in named]
    return (
        f"the motion names {', '.join(named)} and not {', '.join(unnamed)}: it is planned in these joints"
        f" (mechanism.independent = {json.dumps(named)})"
    )


def _named(tables: Mapping[str, dict]) -> Iterator[str]:
    """Yield the joints that a motion, its waypoints and its reference name."""
    motion = tables.get("motion", {})
    for table in (motion, tables.get("reference", {}), *motion.get("waypoints", [])):
        for state in _STATES:
            for unit in ("deg", "m", "deg_s", "m_s"):
                yield from table.get(f"{state}_{unit}", ())
