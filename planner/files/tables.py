"""Problem files as tables: reading TOML and built-in problems, setting single keys, and writing tables as TOML text.

`tomllib` reads the text back as the same tables.
"""

import math
import os
import re
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from linkplan.models.catalogue import PAYLOADS, unknown_source
from linkplan.models.errors import ProblemError, choose
from linkplan.models.errors import shown as shown_name
from linkplan.models.reading import key_text, parse_toml, quoted, read_toml

_PROBLEMS = resources.files("linkplan.planner").joinpath("problems")
BUILT_IN = tuple(sorted(Path(file.name).stem for file in _PROBLEMS.iterdir() if file.name.endswith(".toml")))

# The file that identifies the folder of a saved plan, and its other files.
PLAN_FILE = "plan.json"
PLAN_FILES = (PLAN_FILE, "trajectory.npz", "trajectory.csv", "trajectory.parquet", "plan.png")

# The file that identifies the folder of a saved plan in phases.
PHASES_FILE = "phases.json"

Tables = dict[str, dict]


def toml_text(tables: Mapping[str, object]) -> str:
    """Return the TOML text of tables: first single values, then the sections, with nested tables on one line.

    Raises:
        ProblemError: naming the key of a value that TOML cannot express.
    """
    lines = [f"{key_text(key)} = {inline(value, key)}" for key, value in tables.items() if not isinstance(value, Mapping)]
    for name, section in tables.items():
        if isinstance(section, Mapping):
            lines += ["", f"[{key_text(name)}]"]
            lines += [f"{key_text(key)} = {_value(value, f'{name}.{key}')}" for key, value in section.items()]
    return "\n".join(lines).lstrip("\n") + "\n"


def _value(value: object, where: str) -> str:
    """Return a section's value; a text of several lines, such as MJCF, is enclosed in triple quotes."""
    if isinstance(value, str) and "\n" in value and "'''" not in value and not re.search(r"[\x00-\x08\x0b-\x1f\x7f]", value):
        return f"'''\n{value}'''"
    return inline(value, where)


def inline(value: object, where: str = "value") -> str:
    """Return a value in TOML's syntax, on one line.

    Raises:
        ProblemError: for a value that is not a word, number, list or table.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    if isinstance(value, int):
        return repr(int(value))
    if isinstance(value, float):
        return repr(float(value))  # because numpy's floats have another repr
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(inline(item, where) for item in value) + "]"
    if isinstance(value, Mapping):
        pairs = [f"{key_text(key)} = {inline(item, f'{where}.{key}')}" for key, item in value.items()]
        return "{ " + ", ".join(pairs) + " }" if pairs else "{}"
    raise ProblemError(f"{where} must be numbers, words, lists or tables, got {value!r}")


def built_in_text(name: str) -> str:
    """Return the TOML text of a built-in problem."""
    return _PROBLEMS.joinpath(f"{name}.toml").read_text(encoding="utf-8")


def read_tables(source: str | Path) -> tuple[str, Tables, Path | None]:
    """Return a problem's name, its tables and the folder of its file (None for a built-in, and for the text of a file)."""
    text = str(source)
    if "\n" in text:
        return "problem", parse_toml(text, "the problem"), None
    if text in BUILT_IN:
        return text, tomllib.loads(built_in_text(text)), None
    if not text.strip():
        raise ProblemError(f"a problem's name is empty; a problem is a TOML file or one of {', '.join(BUILT_IN)}")
    path, shown = Path(text), text if len(text) < 200 else f"{text[:100]}..."
    refuse_saved_plan(text, "problem", f"a problem is a TOML file or one of {', '.join(BUILT_IN)}")
    if os.path.isdir(path):
        raise ProblemError(f"problem '{text}' is a folder; a problem is a TOML file or one of {', '.join(BUILT_IN)}")
    if not os.path.exists(path):
        raise ProblemError(unknown_source("problem", text, BUILT_IN))
    if path.suffix in (".xml", ".mjcf"):
        raise ProblemError(f"problem '{shown}' is a model, for check and new; a problem is a TOML file")
    tables = read_toml(path, f"problem '{text}'")
    if "motion" not in tables and ("sweep" in tables or "case" in tables):
        raise ProblemError(f"'{shown}' is a batch file, for batch; a problem has [mechanism] and [motion]")
    return shown_name(path.stem), tables, path.parent


def refuse_saved_plan(source: str, what: str, legal: str) -> None:
    """Refuse the folder of a saved plan, or a file in it, where something else is expected.

    Args:
        source: a path.
        what: the expected thing, in a word.
        legal: its description, in a sentence.

    Raises:
        ProblemError: for the folder of a saved plan, or a file in it.
    """
    path = Path(source)
    try:
        is_plan, in_plan = (
            (path / PLAN_FILE).is_file(),
            path.name in PLAN_FILES and (path.parent / PLAN_FILE).is_file(),
        )
    except (OSError, ValueError):
        return
    if is_plan or in_plan:
        is_what = "a saved plan" if is_plan else f"a file of the saved plan '{path.parent}'"
        raise ProblemError(f"{what} '{source}' is {is_what}; {legal}")


def resolve_path(path: str, folder: Path | None) -> Path:
    """Return a path in a problem file, relative to the file's folder if it exists there, else to the working folder."""
    try:
        there = folder is not None and (folder / path).exists()
    except (OSError, ValueError):  # an impossible file name
        there = False
    return folder / path if folder is not None and there else Path(path)


def apply_override(tables: Tables, override: str) -> None:
    """Set one key of `tables` from "section.key=value"; the value is in TOML syntax, or a bare word for a string."""
    key, equals, text = override.partition("=")
    if not equals:
        raise ProblemError(f"a setting must be section.key=value, got '{override}'")
    set_key(tables, key, parse_value(text.strip(), override))


def set_key(tables: Tables, key: str, value: object) -> None:
    """Set one key of `tables`, "section.key" or a deeper one; None removes it. A payload's name on the path becomes a table.

    Raises:
        ProblemError: when the key is malformed, or a value is on its path.
    """
    path = [part.strip() for part in key.split(".")]
    if path[0] == "parameters" and len(path) > 2:  # names of parameters have a dot: parameters.shank.mass.value
        path[1:3] = [".".join(path[1:3])]
    if len(path) < 2 or not all(path):
        raise ProblemError(f"a setting must be section.key=value, got '{key}'")
    node: dict[str, Any] = tables
    for depth, part in enumerate(path[:-1]):
        child = node.setdefault(part, {})
        if path[: depth + 1] == ["mechanism", "payload"] and isinstance(child, str) and child in PAYLOADS:
            from linkplan.models.payload import BUILT_IN  # imports the simulator, which a list of names does not need

            child = node[part] = BUILT_IN[child].table()
        if depth == 1 and path[0] == "parameters" and isinstance(child, int | float):
            child = node[part] = {"value": child}
        if path[: depth + 1] == ["phases"] and isinstance(child, list):  # phases.push.duration_s: that of the phase "push"
            names = {one["name"]: one for one in child if isinstance(one, dict) and "name" in one}
            child = {name: names[name] for name in [choose("phase", path[1], names, ProblemError)]}
        if not isinstance(child, dict):
            what = "a list, whose entries only the file sets" if isinstance(child, list) else "a value, not a table"
            raise ProblemError(f"setting '{key}': '{'.'.join(path[: depth + 1])}' is {what}")
        node = child
    if value is None:
        node.pop(path[-1], None)
    else:
        node[path[-1]] = value


def parse_value(text: str, where: str) -> object:
    """Return a TOML value; a bare word is a string.

    Raises:
        ProblemError: when the text is neither.
    """
    try:
        found = parse_toml(f"value = {text}", "the value")
        if len(found) > 1:  # TOML reads additional lines as additional keys
            raise ProblemError(f"setting '{where}' must be one value, got {len(found)} lines of keys")
        return found["value"]
    except ProblemError as error:
        if re.fullmatch(r"[^\s\"'\[\]{}=,]+", text):
            return text
        raise ProblemError(
            f"setting '{where}': '{text}' is neither TOML nor a bare word; write 1.5, true, \"two words\", [1, 2] or"
            " { O = 1 }"
        ) from error
