"""Reading: a table of a file to its typed section, or a refusal in one line."""

from collections.abc import Mapping
from typing import Any, TypeVar, get_args

import msgspec

from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.planner.keys.kinds import Known
from linkplan.planner.keys.sections import ProblemFile

# The tables of a problem file, and their keys; those of [motors] are names of actuators.
_FIELDS = {name: get_args(kind)[0] for name, kind in ProblemFile.__annotations__.items()}
KEYS: Mapping[str, tuple[str, ...]] = {
    name: getattr(kind, "__struct_fields__", ()) for name, kind in _FIELDS.items() if name != "description"
}
Read = TypeVar("Read")


def read(
    kind: type[Read],
    value: object,
    where: str,
    known: Known | None = None,
    error: type[LinkplanError] = ProblemError,
) -> Read:
    """Return what a file's value means as one of a kind: a section of its table, a number of its integer.

    Args:
        kind: a section, or what a key takes.
        value: as TOML has it.
        where: the key that it stands under, "motion.duration_s".
        known: is called with a noun, a name and its table's key for names in tables of which something is wrong; it raises
            where there is no such thing, which is then the fault to be named.
        error: to raise.

    Raises:
        error: for a value that is none of this kind, in one line that names its key.
    """
    try:
        return msgspec.convert(value, kind)
    except UnicodeEncodeError as refused:
        raise error(f"{where} holds what is no text") from refused
    except (msgspec.ValidationError, AttributeError) as refused:  # the latter of what only looks like a table
        from linkplan.planner.keys.refusals import fault  # only those who are refused wait for its words

        raise error(fault(kind, value, where, known) or f"{where}: {refused}") from refused


def read_section(kind: type[Read], tables: dict, name: str, known: Known | None = None) -> Read:
    """Return one section of a file's tables, its defaults where it is left out."""
    return read(kind, tables.get(name, {}), name, known)


def checked(key: str, value: object) -> Any:
    """Return a value, made of the type that it has in a problem file, if it can stand under "section.key".

    Raises:
        ProblemError: naming the key, when it cannot.
    """
    return read(kind_of(key), value, key)


def kind_of(key: str) -> Any:
    """Return what stands under "section" or "section.key" of a problem file."""
    section, _, name = key.partition(".")
    return _FIELDS[section].__annotations__[name] if name else ProblemFile.__annotations__[section]


def refuse_unknown_keys(tables: Mapping[str, object]) -> None:
    """Refuse tables that are none, and keys that are none of theirs, whatever the keys' values are.

    Raises:
        ProblemError: naming the first of them, with the nearest that there is.
    """
    if all(_has_known_keys(name, table) for name, table in tables.items()):
        return
    from linkplan.planner.keys.refusals import unknown_key

    found = [unknown_key(ProblemFile, tables, "")]
    found += [unknown_key(kind_of(name), table, name) for name, table in tables.items() if name in _FIELDS]
    raise ProblemError(next(filter(None, found)))


def _has_known_keys(name: str, table: object) -> bool:
    if name == "description":
        return isinstance(table, str)
    return name in KEYS and isinstance(table, dict) and (name == "motors" or table.keys() <= set(KEYS[name]))
