"""All keys of a problem file as one table, and of files of each kind as a JSON Schema (draft 2020-12).

New problem files take the comments on their keys from the table. Editors complete and check files with the schema.
"""

import types
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Union, get_args, get_origin

import msgspec

from linkplan.planner.problem.keys.kinds import MAX_NUMBER
from linkplan.planner.problem.keys.limits import SITE_LIMITS
from linkplan.planner.problem.keys.motor_list import MotorsFile
from linkplan.planner.problem.keys.phases import PhasedFile
from linkplan.planner.problem.keys.reading import range_words, without_metadata, words
from linkplan.planner.problem.keys.section import Section
from linkplan.planner.problem.keys.sections import BatchFile, ProblemFile

DIALECT = "https://json-schema.org/draft/2020-12/schema"
FILES: dict[str, type[Section]] = {"problem": ProblemFile, "phases": PhasedFile, "batch": BatchFile, "motors": MotorsFile}


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Key:
    """A key of a section and its description.

    `section` is "" for tables, "motion" for its keys, or a path to nested keys: "motion.waypoints[]", "motors.NAME".
    `default` is the value of an omitted key, None if there is no single value; `default_words` describe it in both cases. A
    `required` key has neither.
    """

    section: str
    name: str
    type: str
    unit: str
    required: bool
    default: Any
    default_words: str
    doc: str


def key_table(kind: type[Section] = ProblemFile, section: str = "") -> tuple[Key, ...]:
    """Return the keys of a file or section in the order of their definition, followed by the keys nested in them."""
    return tuple(_rows(kind, section))


def _rows(kind: type[Section], section: str) -> Iterator[Key]:
    inside = []
    for field in msgspec.structs.fields(kind):
        bare, about = without_metadata(field.type)
        value = None if field.required or field.default is msgspec.NODEFAULT else field.default
        single = isinstance(value, int | float | str) and value != ""
        shown = f"{value:g}" if isinstance(value, float) else str(value)
        yield Key(
            section=section,
            name=field.name,
            type=", ".join(filter(None, (words(field.type), _range(field.type)))),
            unit=about["unit"],
            required=field.required,
            default=value if single else None,
            default_words="" if field.required else about["otherwise"] or shown,
            doc=about["meaning"],
        )
        inside += [(one, f"{section}.{field.name}{how}".lstrip(".")) for one, how in _inside(bare, about)]
    for one, where in inside:
        yield from _rows(one, where)


def _inside(bare: Any, about: dict, how: str = "") -> Iterator[tuple[type[Section], str]]:
    """Yield the sections nested in a key's value, with the path to them."""
    container = get_origin(bare) or bare
    if isinstance(container, type) and issubclass(container, Section):
        yield container, how
    elif "shapes" in about:
        yield from ((shape, f"{how} ({shape.__name__.lower()})") for shape in about["shapes"])
    elif container in (Union, types.UnionType, list, dict):
        step = {list: "[]", dict: ".NAME"}.get(container, "")
        found: dict[Any, str] = {}
        for one in get_args(bare):
            for shape, inner in _inside(*without_metadata(one), how + step):
                found.setdefault(shape, inner)
        yield from found.items()


def _range(kind: Any) -> str:
    """Return the range of a number as text; "" if the range only excludes typing errors."""
    bare, about = without_metadata(kind)
    if get_origin(bare) in (Union, types.UnionType):
        return next(filter(None, map(_range, get_args(bare))), "")
    return range_words(about) if bare is float and about.get("le", about.get("lt", MAX_NUMBER)) < MAX_NUMBER else ""


def json_schema(file: str = "problem") -> dict[str, Any]:
    """Return the JSON Schema of a kind of file in `FILES`: a problem, one with phases, a batch or a list of motors.

    A schema cannot express everything. Only the reader checks names of joints, actuators, closures, sites and bodies, low <
    high, and combinations of keys.
    """
    (whole, *_), parts = msgspec.json.schema_components((FILES[file], *SITE_LIMITS), ref_template="#/$defs/{name}")
    name = whole["$ref"].rpartition("/")[2]
    for part in parts.values():
        part["title"] = part["title"].removesuffix("Section").removesuffix("File").lower()
        for key, entry in part["properties"].items():
            entry["title"] = f"{key} [{entry['x-unit']}]" if "x-unit" in entry else key
    found = {"$schema": DIALECT, "$defs": {}, **parts.pop(name), "title": f"linkplan {file} file"}
    found["$defs"] = _reached(found, parts)
    return _without_empty_defaults(found)


def _reached(found: dict, parts: dict) -> dict:
    """Return the parts that a schema refers to, directly or through other parts."""
    text, reached = str(found), {}
    while new := {name: part for name, part in parts.items() if f"#/$defs/{name}'" in text and name not in reached}:
        reached |= new
        text += str(new)
    return reached


def _without_empty_defaults(node: Any) -> Any:
    """Return a schema without defaults that are None or empty."""
    if isinstance(node, list):
        return [_without_empty_defaults(item) for item in node]
    if not isinstance(node, dict):
        return node
    return {
        key: _without_empty_defaults(item) for key, item in node.items() if key != "default" or item not in (None, {}, [])
    }
