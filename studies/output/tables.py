"""Tables of plain text: aligned columns, as wide as they are."""

from collections.abc import Sequence

# A longer cell is a sentence: its column is aligned to the left, and it is folded on a narrow terminal.
SENTENCE_LETTERS = 24
_GAP = "  "


def headed(head: str, unit: str) -> str:
    """Return the head of a column with its unit."""
    return f"{head} [{unit}]" if unit not in ("", "1") else head


def said(cell: object, digits: int = 4) -> str:
    """Return a cell as text."""
    if cell is None:
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "NO"
    return f"{cell:.{digits}g}" if isinstance(cell, float) else str(cell)


def to_the_left(column: int, cells: Sequence[str]) -> bool:
    """Tell if a column is aligned to the left: the first one, and columns of sentences."""
    return column == 0 or max(map(len, cells), default=0) > SENTENCE_LETTERS


def table(head: Sequence[str], rows: Sequence[Sequence[object]], digits: int = 4) -> str:
    """Return rows under a head in aligned columns, as wide as they are; numbers have `digits` significant digits."""
    columns = [[title, *(said(row[k], digits) for row in rows)] for k, title in enumerate(head)]
    for k, column in enumerate(columns):
        width, left = max(map(len, column)), to_the_left(k, column[1:])
        column.insert(1, "-" * width)
        columns[k] = [text.ljust(width) if left else text.rjust(width) for text in column]
    return "\n".join(_GAP.join(line).rstrip() for line in zip(*columns, strict=True))
