"""Refusals of a model's text before MuJoCo reads it: of counts and sizes that it would allocate, and of SDF."""

import re

from linkplan.models.errors import ModelError
from linkplan.models.reading import shown

# Largest model file; the largest model of MuJoCo Menagerie has some hundred kilobytes.
MAX_MODEL_BYTES = 32_000_000

_COUNT = re.compile(rb"""\b(count|nrow|ncol|nuserdata|njmax|nconmax|nstack|memory)\s*=\s*["']([^"']*)["']""")
_SDF = re.compile(rb"<sdf[\s>]")
_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}


def refuse_oversized(content: bytes, what: str) -> None:
    """Refuse an MJCF text that is too long, contains zero bytes, has a count or size above the limits, or is SDF.

    Args:
        content: the text.
        what: name of the text in messages.

    Raises:
        ModelError: if a limit is exceeded, or with the converter of SDF.
    """
    if len(content) > MAX_MODEL_BYTES:
        raise ModelError(f"{what} has {len(content)} bytes; at most {MAX_MODEL_BYTES} are read")
    if b"\0" in content:
        raise ModelError(f"{what} does not parse: it holds zero bytes; a model is MJCF or URDF text")
    if _SDF.search(content):
        raise ModelError(
            f"{what} is SDF, and models are MJCF or URDF: sdf2mjcf (pip install sdformat-mjcf) converts it; then close its"
            " loops by <connect> elements"
        )
    for name, value in _COUNT.findall(content):
        # Bytes, numbers of 8 bytes each, and 20,000 bodies of a replicate, which take seconds and a gigabyte.
        most = {b"memory": 1e9, b"nstack": 1e8}.get(name, 20_000)
        if any(_number(word) > most for word in value.decode("utf-8", "replace").split()):
            text = shown(value.decode("utf-8", "replace"), 40)
            raise ModelError(f'{what} has {name.decode()} = "{text}"; at most {most:g} is read')


def _number(word: str) -> float:
    """Return the number of a word with an optional unit letter, or 0 for another word, which MuJoCo refuses."""
    try:
        return float(word.rstrip("KMGTPEkmgtpe")) * _UNITS.get(word[-1:].upper(), 1)
    except ValueError:
        return 0.0
