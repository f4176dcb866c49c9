"""Conversion of a file's tables to typed sections, or a refusal in one line: the key, the legal values, and the value.

msgspec's messages name no keys. They have a path but not the part that is wrong ("Expected `float | array`, got `str` - at
`$.a[...]`"). So the module walks through a refused value by its type, down to the part that msgspec refuses.

Names from other programs and plain speech are answered with the keys that they stand for.
"""

import math
import types
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec

from linkplan.models.deadline import one_thread_at_a_time
from linkplan.models.errors import LinkplanError, ProblemError, closest
from linkplan.planner.problem.keys.kinds import MAX_NUMBER, Known, Place
from linkplan.planner.problem.keys.sections import ProblemFile

# The tables of a problem file and their keys; the keys of [motors] are names of actuators.
_FIELDS = {name: get_args(kind)[0] for name, kind in ProblemFile.__annotations__.items()}
KEYS: Mapping[str, tuple[str, ...]] = {
    name: getattr(kind, "__struct_fields__", ()) for name, kind in _FIELDS.items() if name != "description"
}
Read = TypeVar("Read")
# If a synonym has several keys, the one that belongs to the table is suggested.
SYNONYMS: Mapping[str, tuple[str, ...]] = {
    "torque": ("effort",),
    "force": ("effort", "closure_force"),
    "torque_rate": ("effort_rate",),
    "position_deg": ("range_deg", "start_deg"),
    "velocity_deg_s": ("speed_deg_s",),
    "time": ("duration_s", "time_s"),
    "duration": ("duration_s",),
    "cost": ("minimize", "objective"),
    "type": ("kind",),
    "from_deg": ("start_deg",),
    "to_deg": ("goal_deg",),
    "end_deg": ("goal_deg",),
    "via": ("waypoints",),
    "file": ("model",),
    "robot": ("mechanism",),
    "mass": ("mass_kg",),
    "method": ("scheme",),
    "nodes": ("intervals",),
    "timeout_s": ("max_time_s",),
    "dt": ("period_s",),
    "delay": ("delay_periods",),
}
# Keys of earlier versions, and instructions.
REMOVED_KEYS = {"solver.name": "linkplan always uses IPOPT; this key was removed: delete it"}
# Attributes of msgspec's `Meta` that bound a number or the length of a list.
_BOUNDS = ("ge", "gt", "le", "lt", "max_length")


@one_thread_at_a_time
def read(
    kind: type[Read],
    value: object,
    where: str,
    known: Known | None = None,
    error: type[LinkplanError] = ProblemError,
) -> Read:
    """Return a file's value converted to a type: a table to a section, an integer to a number.

    Args:
        kind: a section, or the type of a key.
        value: as TOML has it.
        where: its key, as in "motion.duration_s".
        known: checks names in a refused value; it is called with the kind of object, the name and the table's key, and
            raises for an unknown name.
        error: the exception to raise.

    Raises:
        error: for a value of another type, in one line that names its key.
    """
    try:
        return msgspec.convert(value, kind)
    except UnicodeEncodeError as refused:
        raise error(f"{where} contains something that is not text") from refused
    except (
        msgspec.ValidationError,
        AttributeError,
    ) as refused:  # AttributeError: an object resembles a table
        raise error(fault(kind, value, where, known) or f"{where}: {refused}") from refused


def checked(key: str, value: object) -> Any:
    """Return a value converted to the type that it has in a problem file under "section.key".

    Raises:
        ProblemError: naming the key, when the value is illegal.
    """
    return read(kind_of(key), value, key)


def kind_of(key: str) -> Any:
    """Return the type of "section" or "section.key" of a problem file."""
    section, _, name = key.partition(".")
    return _FIELDS[section].__annotations__[name] if name else ProblemFile.__annotations__[section]


def refuse_unknown_keys(tables: Mapping[str, object]) -> None:
    """Refuse unknown tables and unknown keys, whatever their values are.

    Raises:
        ProblemError: naming the first of them and the nearest known name.
    """
    found = [unknown_key(ProblemFile, tables, "")]
    found += [unknown_key(kind_of(name), table, name) for name, table in tables.items() if name in _FIELDS]
    if any(found):
        raise ProblemError(next(filter(None, found)))


def suggestion(asked: str, legal: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" for the name of a synonym or the closest legal name; "" if none is close."""
    legal = list(legal)
    synonyms = (name for name in SYNONYMS.get(str(asked).casefold(), ()) if name in legal)
    match = next(synonyms, None) or closest(asked, legal)
    return "" if match is None else f" (did you mean '{match}'?)"


def fault(kind: Any, value: object, where: str, known: Known | None = None) -> str | None:
    """Return a message if a value is not of the type `kind`, else None."""
    if _is_valid(kind, value):
        return None
    bare, about = without_metadata(kind)
    if get_origin(bare) in (Union, types.UnionType):
        return _union_fault(kind, bare, value, where, known)
    if _is_section(bare):
        return _section_fault(bare, value, where, known)
    container = get_origin(bare) or bare
    if container is dict and isinstance(value, dict) and value:
        return _table_fault(bare, about, value, where, known)
    if container is list and isinstance(value, list):
        return _list_fault(kind, bare, about, value, where, known)
    choices = get_args(bare) if container is Literal else ()
    if len(choices) > 1 and (isinstance(value, str) or "choices" in about):
        return _choice_fault(about, choices, str(value), where)
    if bare is float:
        return _number_fault(kind, about, value, where)
    return f"{where} must be {words(kind)}, got {got(value)}"


def unknown_key(kind: Any, value: object, where: str) -> str | None:
    """Return a message on a section that is not a table or has an unknown key; None if there is no fault."""
    bare = without_metadata(kind)[0]
    if bare is str:
        return fault(kind, value, where)
    # None for a table by name, whose keys are arbitrary.
    legal: tuple[str, ...] | None = getattr(bare, "__struct_fields__", None)
    if not isinstance(value, dict):
        inner = legal is not None and "." in where
        what = f"a table with keys {', '.join(legal or ())}" if inner else f"a table ([{where}])"
        return f"{where if inner else repr(where)} must be {what}, got {got(value)}"
    if legal is None:
        return None
    for key in value:
        if key not in legal and where:
            path = f"{where}.{key}"
            why = f": {REMOVED_KEYS[path]}" if path in REMOVED_KEYS else suggestion(key, legal)
            return f"unknown key '{path}'{why}; keys are {', '.join(legal)}"
        if key not in legal:
            homes = [f"[{field.name}]" for field in msgspec.structs.fields(bare) if key in _keys(field.type)]
            why = f": it belongs to {' or '.join(homes)}" if homes else suggestion(key, legal)
            return f"unknown table or key '{key}'{why}; legal are {', '.join(legal)}"
    return None


def _keys(kind: Any) -> tuple[str, ...]:
    """Return the keys of a section's type; () for other types."""
    return getattr(without_metadata(kind)[0], "__struct_fields__", ())


def words(kind: Any) -> str:
    """Return a phrase that describes a type: "a positive number", "[low, high]", "one of reach, hold, periodic, track"."""
    bare, about = without_metadata(kind)
    if "said" in about:
        return about["said"]
    if get_origin(bare) in (Union, types.UnionType):
        return " or ".join(words(one) for one in get_args(bare))
    container: Any = get_origin(bare) or bare
    if container is Literal:
        named = get_args(bare)
        return f"one of {', '.join(named)}" if len(named) > 1 else f'"{"".join(named)}"'
    if container is dict:
        return f"a table of {about['of']}"
    if container is list:
        return "a list"
    if bare is int:
        return f"a whole number from {about['ge']} to {about['le']}"
    if bare is float:
        least, above = about.get("ge", -math.inf), about.get("gt", -math.inf)
        return "a positive number" if least > 0 or above >= 0 else "a number of at least 0" if least == 0 else "a number"
    return "a text" if bare is str else "a table"


def range_words(about: dict[str, Any]) -> str:
    """Return a phrase that describes the range of a number."""
    low, high = about.get("ge", about.get("gt", -MAX_NUMBER)), about.get("le", about.get("lt", MAX_NUMBER))
    return about.get("range", f"from {low:g} to {'below ' if 'lt' in about else ''}{high:g}")


def without_metadata(kind: Any) -> tuple[Any, dict[str, Any]]:
    """Return a type without its metadata, and the metadata as one table: its bounds, and its words for messages."""
    if get_origin(kind) is not Annotated:
        return kind, {}
    about: dict[str, Any] = {}
    for meta in kind.__metadata__:
        about |= {name: end for name in _BOUNDS if (end := getattr(meta, name)) is not None}
        about |= meta.extra or {}
    return kind.__origin__, about


def got(value: object) -> str:
    """Return a value as messages quote it."""
    try:
        return repr(value)
    except ValueError:  # Python does not print integers of thousands of digits
        return "a number of thousands of digits"


def _is_section(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _is_valid(kind: Any, value: object) -> bool:
    try:
        msgspec.convert(value, kind)
    except (msgspec.ValidationError, AttributeError):
        return False
    return True


def _union_fault(kind: Any, bare: Any, value: object, where: str, known: Known | None) -> str | None:
    """Return a message on a value that has none of several types; it names the most similar type, or all of them."""
    for one in get_args(bare):
        inner = without_metadata(one)[0]
        container = get_origin(inner) or inner
        is_section = _is_section(container)
        alike = (
            (container is dict or is_section) and isinstance(value, dict) and value,
            container is list and isinstance(value, list),
            container is float and isinstance(value, int | float) and not isinstance(value, bool),
            container is Literal and isinstance(value, str) and len(get_args(inner)) > 1,
        )
        if any(alike):
            return fault(one, value, where, known)
    if kind == Place and isinstance(value, int | float):  # a number probably means a joint's position
        stem, _, name = where.rpartition(".")
        joint = f"joint {name}'s position is {stem.removesuffix('_at')}_deg.{name}"
        return f"{where} must be a site's place, {words(kind)}, got {got(value)}; {joint}"
    return f"{where} must be {words(kind)}, got {got(value)}"


def _section_fault(kind: type[msgspec.Struct], value: object, where: str, known: Known | None) -> str | None:
    found = unknown_key(kind, value, where)
    if found is not None or not isinstance(value, dict):
        return found
    fields = msgspec.structs.fields(kind)
    path = {field.name: f"{where}.{field.name}" if where else field.name for field in fields}
    for field in fields:
        found = fault(field.type, value[field.name], path[field.name], known) if field.name in value else None
        if found:
            return found
    for field in fields:
        if field.required and field.name not in value:
            inner = without_metadata(field.type)[0]
            is_section = _is_section(inner)
            missing = f"{path[field.name]} is missing; it must be {words(field.type)}"
            return fault(inner, {}, path[field.name], known) if is_section else missing
    return None


def _list_fault(kind: Any, bare: Any, about: dict, value: list, where: str, known: Known | None) -> str:
    if len(value) > about.get("max_length", len(value)):
        return f"{where} must be {words(kind)}, got {len(value)} of them"
    inner = get_args(bare)[0]
    found = (fault(inner, item, f"{where}[{k}]" if "numbered" in about else where, known) for k, item in enumerate(value))
    return next(filter(None, found), f"{where} must be {words(kind)}, got {got(value)}")


def _table_fault(bare: Any, about: dict, value: dict, where: str, known: Known | None) -> str | None:
    names, inner = get_args(bare)
    legal = get_args(names) if get_origin(names) is Literal else None
    for name, one in value.items():
        if legal is not None and name not in legal:
            return f"unknown key '{where}.{name}'{suggestion(name, legal)}; it is one of {', '.join(legal)}"
        if known is not None and "noun" in about:
            known(about["noun"], name, where)
        found = fault(inner, one, where + about["item"].format(name) if "item" in about else f"{where}.{name}", known)
        if found:
            return found
    return None


def _choice_fault(about: dict[str, Any], choices: tuple[str, ...], value: str, where: str) -> str:
    legal = about.get("choices") or f"legal: {', '.join(choices)}"
    return f"unknown {where} '{value}'{suggestion(value, choices)}; {legal}"


def _number_fault(kind: Any, about: dict[str, Any], value: object, where: str) -> str:
    wanted = f"{where} must be {words(kind)}"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"{wanted}, got {got(value)}"
    if isinstance(value, int) and abs(value) > MAX_NUMBER:
        return f"{wanted} below {MAX_NUMBER:g}, got one of {int(math.log10(abs(value))) + 1} digits"
    if not math.isfinite(value) or (value <= 0 and about.get("ge", about.get("gt", -1)) >= 0):
        return f"{wanted}, got {got(value)}"
    short = f"{value:g}"
    return f"{where} must be {range_words(about)}, got {short if float(short) == value else got(value)}"
