"""The keys of problem and batch files as a JSON Schema (draft 2020-12), with which editors complete and check them."""

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

    A schema cannot express everything. The reader alone checks names of joints, actuators, closures and sites, low < high,
    and which keys go together.
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
