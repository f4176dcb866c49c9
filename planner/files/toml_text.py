"""Tables as TOML text, which `tomllib` reads back as the same tables."""

import math
import re
from collections.abc import Mapping

from linkplan.models.errors import ProblemError

# Keys that need no quotes (TOML 1.0, "Keys").
_BARE = re.compile(r"[A-Za-z0-9_-]+")
# Characters that a basic string must escape (TOML 1.0, "String"), and the short escapes.
_ESCAPED = re.compile(r'[\x00-\x1f\x7f"\\]')
_SHORT = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t", "\r": "\\r"}


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
        ProblemError: for a value that is no word, number, list or table.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    if isinstance(value, int):
        return repr(int(value))
    if isinstance(value, float):
        return repr(float(value))  # numpy's floats have another repr
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(inline(item, where) for item in value) + "]"
    if isinstance(value, Mapping):
        pairs = [f"{key_text(key)} = {inline(item, f'{where}.{key}')}" for key, item in value.items()]
        return "{ " + ", ".join(pairs) + " }" if pairs else "{}"
    raise ProblemError(f"{where} is numbers, words, lists or tables, got {value!r}")


def key_text(key: str) -> str:
    """Return a key in TOML's syntax, quoted if necessary."""
    return key if _BARE.fullmatch(key) else _quoted(key)


def _quoted(text: str) -> str:
    return '"' + _ESCAPED.sub(lambda found: _SHORT.get(found[0], f"\\u{ord(found[0]):04x}"), text) + '"'
