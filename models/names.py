"""Names as text, and the choice among legal ones, with a suggestion for a misspelled name."""

from collections.abc import Iterable, Sequence

from linkplan.models.errors import ModelError

# Other units in a key, and the unit that files use.
_UNITS = {"rad": "deg", "mm": "m", "cm": "m", "ms": "s", "us": "s", "g": "kg", "kw": "w", "khz": "hz", "kn": "n"}


def listed(names: Sequence[str], most: int) -> str:
    """Return names as text; of more than `most`, the first and the number of the others: "a, b and 3 more"."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def nearest(asked: str, legal: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" for the legal name closest to `asked`, or an empty text if no name is close."""
    match = closest(asked, legal)
    return "" if match is None else f" (did you mean '{match}'?)"


def closest(asked: str, legal: Iterable[str]) -> str | None:
    """Return the legal name closest to `asked`, or None if no name is close.

    A name that differs only in its units comes first. Upper and lower case count as equal.
    """
    folded: dict[str, str] = {}
    for name in legal:
        folded.setdefault(name.casefold(), name)
    in_our_units = "_".join(_UNITS.get(part, part) for part in str(asked).casefold().split("_"))
    if in_our_units in folded:
        return folded[in_our_units]
    import difflib

    matches = difflib.get_close_matches(str(asked).casefold(), list(folded), n=1, cutoff=0.5)
    return folded[matches[0]] if matches else None


def choose(what: str, asked: str, legal: Iterable[str], error: type[Exception] = ModelError) -> str:
    """Return `asked` if it is legal.

    Raises:
        error: if it is not; the message lists the legal values.
    """
    legal = list(legal)
    if asked in legal:
        return asked
    raise error(f"unknown {what} '{asked}'{nearest(asked, legal)}; legal: {', '.join(legal) or 'none'}")
