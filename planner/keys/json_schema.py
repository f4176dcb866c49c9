"""The keys of problem and batch files as a JSON Schema (draft 2020-12), by which editors complete and check them."""

from typing import Any

import msgspec

from linkplan.planner.keys.batch_sections import BatchFile
from linkplan.planner.keys.limits_section import SITE_LIMITS
from linkplan.planner.keys.section import Section
from linkplan.planner.keys.sections import ProblemFile

DIALECT = "https://json-schema.org/draft/2020-12/schema"
FILES: dict[str, type[Section]] = {"problem": ProblemFile, "batch": BatchFile}


def json_schema(file: str = "problem") -> dict[str, Any]:
    """Return the JSON Schema of a problem file, or of a batch file ("batch").

    What a schema cannot say stays with the reader: names of joints, actuators, closures and sites, low < high, and what goes
    with what.
    """
    (whole, *_), parts = msgspec.json.schema_components((FILES[file], *SITE_LIMITS), ref_template="#/$defs/{name}")
    name = whole["$ref"].rpartition("/")[2]
    for part in parts.values():
        part["title"] = part["title"].removesuffix("Section").removesuffix("File").lower()
        for key, said in part["properties"].items():
            said["title"] = f"{key} [{said['x-unit']}]" if "x-unit" in said else key
    found = {"$schema": DIALECT, "$defs": {}, **parts.pop(name), "title": f"linkplan {file} file"}
    found["$defs"] = _reached(found, parts)
    return _without_nothing(found)


def _reached(found: dict, parts: dict) -> dict:
    """Return those parts that a schema refers to, and that those refer to."""
    text, reached = str(found), {}
    while new := {name: part for name, part in parts.items() if f"#/$defs/{name}'" in text and name not in reached}:
        reached |= new
        text += str(new)
    return reached


def _without_nothing(node: Any) -> Any:
    """Return a schema without defaults that say nothing: of keys that are left out, and empty tables."""
    if isinstance(node, list):
        return [_without_nothing(item) for item in node]
    if not isinstance(node, dict):
        return node
    return {key: _without_nothing(item) for key, item in node.items() if key != "default" or item not in (None, {}, [])}
