"""Conversion of a file's tables to typed sections, or a refusal in one line."""

from collections.abc import Mapping
from typing import Any, TypeVar, get_args

import msgspec

from linkplan.models.deadline import one_thread_at_a_time
from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.planner.problem.keys.kinds import Known
from linkplan.planner.problem.keys.sections import ProblemFile

# The tables of a problem file and their keys; the keys of [motors] are names of actuators.
_FIELDS = {name: get_args(kind)[0] for name, kind in ProblemFile.__annotations__.items()}
KEYS: Mapping[str, tuple[str, ...]] = {
    name: getattr(kind, "__struct_fields__", ()) for name, kind in _FIELDS.items() if name != "description"
}
Read = TypeVar("Read")


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
        raise error(f"{where} holds what is no text") from refused
    except (msgspec.ValidationError, AttributeError) as refused:  # AttributeError: an object that only resembles a table
        from linkplan.planner.problem.keys.refusals import fault  # imported only when it is needed

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
    from linkplan.planner.problem.keys.refusals import unknown_key

    found = [unknown_key(ProblemFile, tables, "")]
    found += [unknown_key(kind_of(name), table, name) for name, table in tables.items() if name in _FIELDS]
    if any(found):
        raise ProblemError(next(filter(None, found)))
