"""Choosing among names: one line with what was asked, what is legal, and the nearest legal name."""

from collections.abc import Iterable

from linkplan.models.errors import ModelError

# Names count as close from this share of common letters on (`difflib`'s ratio): half of them.
_CLOSE = 0.5
# What is written in another unit than files have: the key in ours is meant, however many letters are alike.
_UNITS = {"rad": "deg", "mm": "m", "cm": "m", "ms": "s", "us": "s", "g": "kg", "kw": "w", "khz": "hz", "kn": "n"}


def nearest(asked: str, legal: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" for the legal name closest to `asked`, or nothing where none is close."""
    match = closest(asked, legal)
    return "" if match is None else f" (did you mean '{match}'?)"


def closest(asked: str, legal: Iterable[str]) -> str | None:
    """Return the legal name closest to `asked`: the same in our units, or by its letters; None where none is close.

    Capitals are not counted.
    """
    folded: dict[str, str] = {}
    for name in legal:
        folded.setdefault(name.casefold(), name)
    in_our_units = "_".join(_UNITS.get(part, part) for part in str(asked).casefold().split("_"))
    if in_our_units in folded:
        return folded[in_our_units]
    import difflib

    matches = difflib.get_close_matches(str(asked).casefold(), list(folded), n=1, cutoff=_CLOSE)
    return folded[matches[0]] if matches else None


def choose(what: str, asked: str, legal: Iterable[str], error: type[Exception] = ModelError) -> str:
    """Return `asked` if it is legal.

    Raises:
        error: with one line naming the legal values, if it is not.
    """
    legal = list(legal)
    if asked in legal:
        return asked
    raise error(f"unknown {what} '{asked}'{nearest(asked, legal)}; legal: {', '.join(legal) or 'none'}")
