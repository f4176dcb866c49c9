"""Choosing among names: one line with what was asked, what is legal, and the nearest legal name."""

import difflib
from collections.abc import Iterable

from linkplan.models.errors import ModelError


def nearest(asked: str, legal: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" for the legal name closest to `asked`, or nothing where none is close."""
    matches = difflib.get_close_matches(str(asked), list(legal), n=1, cutoff=0.5)
    return f" (did you mean '{matches[0]}'?)" if matches else ""


def choose(what: str, asked: str, legal: Iterable[str], error: type[Exception] = ModelError) -> str:
    """Return `asked` if it is legal.

    Raises:
        error: with one line naming the legal values, if it is not.
    """
    legal = list(legal)
    if asked in legal:
        return asked
    raise error(f"unknown {what} '{asked}'{nearest(asked, legal)}; legal: {', '.join(legal) or 'none'}")
