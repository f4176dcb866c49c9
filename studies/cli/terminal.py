"""Output for terminals, unlike pipes and files: colours, and lines of the terminal's width."""

import os
import re
import textwrap
from typing import TextIO

from linkplan.studies.output.tables import TABLE_WIDTH

# ECMA-48, "Select graphic rendition".
_CODES = {"red": "31", "green": "32", "yellow": "33", "bold": "1", "dim": "2"}
# The patterns of verdicts in a result, and the colours of the words; all other words are red.
_VERDICTS = (
    r"^(PROBLEM|note)(?=:)",
    r"(?<=^certificate: )(passed|NOT passed)$",
    r"(?<=: )(optimal|infeasible|failed)$",
    r"(?<=  )(optimal|infeasible|failed|NO)(?=  |$)",
    r"^no problems found$",
)
_COLOURS = {"optimal": "green", "passed": "green", "no problems found": "green", "note": "yellow"}
_RULE = re.compile(r"-+(  -+)*")


def is_terminal(stream: TextIO | None) -> bool:
    """Tell if a stream is a terminal."""
    try:
        return stream is not None and stream.isatty()
    except (OSError, ValueError):  # closed
        return False


def moves(stream: TextIO | None) -> bool:
    """Tell if a stream is a terminal on which a line can be overwritten."""
    return is_terminal(stream) and os.environ.get("TERM", "dumb") not in ("", "dumb")


def has_colours(stream: TextIO | None) -> bool:
    """Tell if a stream is a terminal with colours, unless NO_COLOR is set (no-color.org)."""
    return moves(stream) and not os.environ.get("NO_COLOR")


def width_of(stream: TextIO | None) -> int:
    """Return the number of columns of a terminal; the standard width if it is unknown."""
    try:
        return os.get_terminal_size(stream.fileno()).columns or TABLE_WIDTH
    except (AttributeError, OSError, ValueError):
        return TABLE_WIDTH


def coloured(text: str, colour: str) -> str:
    """Return a text in a colour."""
    return f"\x1b[{_CODES[colour]}m{text}\x1b[0m"


def wrapped(text: str, width: int) -> str:
    """Return a text with sentences wrapped at a width; the lines of tables stay unchanged."""
    lines = []
    for line in text.split("\n"):
        begin = line[: len(line) - len(line.lstrip())]
        if len(line) <= width or "  " in line.strip():
            lines.append(line)
        else:
            below = f"{begin}  "
            lines += textwrap.wrap(line, max(width, 20), subsequent_indent=below, break_on_hyphens=False)
    return "\n".join(lines)


def painted(text: str) -> str:
    """Return a text with coloured verdicts and bold heads of tables."""
    lines = text.split("\n")
    heads = set()
    for rule in [k for k, line in enumerate(lines) if _RULE.fullmatch(line)]:
        above = rule - 1
        while above >= 0 and lines[above] and (above == rule - 1 or "  " in lines[above]):
            heads.add(above)
            above -= 1
    return "\n".join(coloured(line, "bold") if k in heads else _judged(line) for k, line in enumerate(lines))


def _judged(line: str) -> str:
    for pattern in _VERDICTS:
        line = re.sub(pattern, lambda found: coloured(found[0], _COLOURS.get(found[0], "red")), line)
    return line
