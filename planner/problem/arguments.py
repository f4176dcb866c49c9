"""Arguments of a problem's builders, in users' types, as entries of a problem file's tables."""

from collections.abc import Mapping

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.names import nearest
from linkplan.planner.files.tables import Tables, set_key
from linkplan.planner.keys.reading import KEYS
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.problem.values import plain

# Arguments that are whole tables of a problem file, those that are keys of a table, and those that no file holds.
_SECTIONS = ("reference", "limits", "motors", "guess", "mesh", "solver", "tracking", "robust", "imperfections")
_MOTION = tuple(key for key in KEYS["motion"] if key != "kind")
_MECHANISM = tuple(key for key in KEYS["mechanism"] if key != "model")
_EXTRAS = ("extra_costs", "extra_limits")


def refuse_unknown_arguments(said: Mapping[str, object]) -> None:
    """Refuse names that are no arguments of `replace`."""
    legal = ("mechanism", *_MECHANISM, *_MOTION, "minimize", *_SECTIONS, "reserve", *_EXTRAS, "name")
    for key in said:
        if key not in legal:
            raise ProblemError(f"unknown argument '{key}' of replace{nearest(key, legal)}; arguments are {', '.join(legal)}")


def fill(tables: Tables, said: Mapping[str, object]) -> None:
    """Set arguments in a file's tables; None removes what was set before."""
    tables["motion"] = _updated(tables["motion"], {key: value for key, value in said.items() if key in _MOTION})
    if "minimize" in said:
        tables["objective"] = _updated(tables.get("objective", {}), {"minimize": said["minimize"]})
    sections = {key: value for key, value in said.items() if key in _SECTIONS}
    kept = _updated(tables, sections)
    if "reserve" in said:
        kept["limits"] = _updated(kept.get("limits", {}), {"reserve": said["reserve"]})
    tables.clear()
    tables.update(kept)


def apply_settings(tables: Tables, settings: object) -> None:
    """Set single values in a file's tables, by dotted key."""
    if not isinstance(settings, Mapping):
        raise ProblemError(f"settings are a table of section.key = value, got {settings!r}")
    for key, value in settings.items():
        set_key(tables, str(key), plain(value))


def asked_mechanism(said: Mapping[str, object], default: Mechanism | None = None) -> Mechanism:
    """Return the mechanism of the argument `mechanism`, or the default, with the other arguments of a mechanism."""
    found = said.get("mechanism")
    if found is None and default is not None:
        found = default
    if not isinstance(found, Mechanism):
        found = mechanism_from_tables({"mechanism": {"model": plain(found)}})
    asked = {key: value for key, value in said.items() if key in _MECHANISM}
    return mechanism_from_tables({"mechanism": _updated(found.source, asked)}) if asked else found


def given_extras(said: Mapping[str, object]) -> dict:
    """Return the arguments that are Python code, which tables cannot hold."""
    return {key: () if said[key] is None else said[key] for key in _EXTRAS if key in said}


def checked_name(name: object) -> str:
    """Return a problem's name if it can be shown."""
    if not isinstance(name, str) or not name.strip() or not name.isprintable() or len(name) > 500:
        raise ProblemError(f"a problem's name is a word of at most 500 characters that can be shown, got {name!r}")
    return name


def _updated(table: Mapping, said: Mapping[str, object]) -> dict:
    """Return a table with new values, without the keys whose new value is None."""
    found = {key: value for key, value in table.items() if key not in said}
    return found | {key: plain(value) for key, value in said.items() if value is not None}
