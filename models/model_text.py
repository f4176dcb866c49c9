"""How much an MJCF text may ask for: counts and sizes that no mechanism needs are refused before MuJoCo makes them."""

import re

from linkplan.models.errors import ModelError
from linkplan.models.reading import shown

# The largest model of MuJoCo Menagerie has some hundred kilobytes; more than this is no model.
MAX_MODEL_BYTES = 32_000_000
# A replicate of so many bodies, or a height field of so many rows, takes seconds and a gigabyte.
MAX_COUNT = 20_000
MAX_ARENA_BYTES = 1e9
_COUNT = re.compile(rb"""\b(count|nrow|ncol|nuserdata|njmax|nconmax|nstack|memory)\s*=\s*["']([^"']*)["']""")
_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}


def refuse_oversized(content: bytes, what: str) -> None:
    """Refuse an MJCF text that is too long, holds zero bytes, or asks for more than a mechanism can need.

    Args:
        content: of the text.
        what: it is, in the refusal's first words.

    Raises:
        ModelError: naming what is too large.
    """
    if len(content) > MAX_MODEL_BYTES:
        raise ModelError(f"{what} has {len(content)} bytes; at most {MAX_MODEL_BYTES} are read")
    if b"\0" in content:
        raise ModelError(f"{what} does not parse: it holds zero bytes; a model is MJCF or URDF text")
    for name, value in _COUNT.findall(content):
        most = MAX_ARENA_BYTES if name == b"memory" else MAX_COUNT
        if any(_number(word) > most for word in value.decode("utf-8", "replace").split()):
            text = shown(value.decode("utf-8", "replace"), 40)
            raise ModelError(f'{what} has {name.decode()} = "{text}"; at most {most:g} is read')


def _number(word: str) -> float:
    """Return the number that a word begins with, in units of its letter; 0 where it is none (MuJoCo says so)."""
    try:
        return float(word.rstrip("KMGTPEkmgtpe")) * _UNITS.get(word[-1:].upper(), 1)
    except ValueError:
        return 0.0
