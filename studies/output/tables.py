"""Tables on the terminal: plain text, right-aligned numbers, units in the head, never wider than 80 columns.

If a table is too wide, first its heads are folded, then long cells, and last its columns are divided into several blocks.
Each block repeats the first column.
"""

import re
import textwrap
from collections.abc import Sequence

# The standard width of terminals in columns.
TABLE_WIDTH = 80
_GAP = "  "
# Cells up to this length are never folded, for example "-100 to 100".
_UNFOLDED_LENGTH = 24
# Longer words are broken, so that two such columns fit.
_LONGEST_WORD = 36


def table(head: Sequence[str], rows: Sequence[Sequence[object]], width: int = TABLE_WIDTH) -> str:
    """Return rows under a head in aligned columns; the first column to the left, the others to the right.

    Args:
        head: of each column.
        rows: of cells.
        width: of the longest line.
    """
    texts = [[_text(cell) for cell in row] for row in rows]
    columns = [[title, *(row[i] for row in texts)] for i, title in enumerate(head)]
    return "\n\n".join(_block(block, width) for block in _blocks(columns, width))


def described(names: dict[str, str], width: int = TABLE_WIDTH) -> list[str]:
    """Return a line for each name with its description, in two columns; long descriptions are wrapped."""
    longest = max(map(len, names), default=0)
    lines = []
    for name, text in names.items():
        begin = f"{_GAP}{name.ljust(longest)}{_GAP}"
        lines.append(textwrap.fill(text, width, initial_indent=begin, subsequent_indent=" " * len(begin)))
    return lines


def folded(text: str, width: int = TABLE_WIDTH, below: str = _GAP) -> str:
    """Return a sentence in lines of at most `width`; those after the first start with `below`."""
    return textwrap.fill(text, width, subsequent_indent=below, break_on_hyphens=False)


def _blocks(columns: list[list[str]], width: int) -> list[list[list[str]]]:
    """Return the columns in as many blocks as they need at their least widths; each block starts with the first column."""
    first, blocks = columns[0], [[columns[0]]]
    available = width - max(_least(first), min(max(map(len, first[1:]), default=0), width // 2))
    left = available
    for column in columns[1:]:
        need = len(_GAP) + _least(column)
        if need > left and len(blocks[-1]) > 1:
            blocks.append([first])
            left = available
        blocks[-1].append(column)
        left -= need
    return blocks


def _block(columns: list[list[str]], width: int) -> str:
    """Return columns side by side, with the fewest lines of heads that fit; if none fits, long cells are folded."""
    cells = [max(map(len, column[1:]), default=0) for column in columns]
    tallest = max(len(_words(column[0])) for column in columns)
    for lines in range(1, tallest + 1):
        widths = [max(cell, _head_width(column[0], lines)) for cell, column in zip(cells, columns, strict=True)]
        if _total(widths) <= width:
            return _aligned(columns, widths)
    widths = [max(cell, _head_width(column[0], tallest)) for cell, column in zip(cells, columns, strict=True)]
    while _total(widths) > width:  # the widest foldable column becomes narrower
        able = [(w, i) for i, w in enumerate(widths) if w > _least(columns[i])]
        if not able:
            break
        widths[max(able)[1]] -= 1
    return _aligned(columns, widths)


def _aligned(columns: list[list[str]], widths: list[int]) -> str:
    folded = [
        [_fold(_words(column[0]), w), *(_fold(text.split(" "), w) for text in column[1:])]
        for column, w in zip(columns, widths, strict=True)
    ]
    long = [any(len(cell) > 1 for cell in column[1:]) for column in folded]
    left = [i == 0 or long[i] for i in range(len(columns))]
    found = []
    for number, cells in enumerate(zip(*folded, strict=True)):
        height = max(map(len, cells))
        # heads are aligned at the bottom, cells at the top
        padded = [[""] * (height - len(c)) + c if number == 0 else c + [""] * (height - len(c)) for c in cells]
        for line in zip(*padded, strict=True):
            sides = zip(line, widths, left, strict=True)
            found.append(_GAP.join(c.ljust(w) if to_left else c.rjust(w) for c, w, to_left in sides).rstrip())
        if number == 0:
            found.append(_GAP.join("-" * w for w in widths))
    return "\n".join(found)


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + len(_GAP) * (len(widths) - 1)


def _least(column: list[str]) -> int:
    """Return the least width of a column, for its unfolded cells and for the words of its head and its long cells."""
    words = [word for text in column[1:] if len(text) > _UNFOLDED_LENGTH for word in text.split(" ")] + _words(column[0])
    longest = min(max(map(len, words), default=0), _LONGEST_WORD)
    short = max((len(text) for text in column[1:] if len(text) <= _UNFOLDED_LENGTH), default=0)
    return max(longest, short, _UNFOLDED_LENGTH if any(len(text) > _UNFOLDED_LENGTH for text in column[1:]) else 0)


def _words(head: str) -> list[str]:
    """Return a head's words; its unit is one word."""
    return re.findall(r"\[[^\]]*\]|\S+", head) or [""]


def _head_width(head: str, lines: int) -> int:
    """Return the least width at which a head takes at most `lines` lines."""
    words = _words(head)
    width = min(max(map(len, words)), _LONGEST_WORD)
    while width < len(head) and len(_fold(words, width)) > lines:
        width += 1
    return width


def _fold(words: Sequence[str], width: int) -> list[str]:
    """Return words in lines of at most `width`; longer words are broken."""
    lines = [""]
    for word in words:
        if lines[-1] and len(lines[-1]) + 1 + len(word) <= width:
            lines[-1] += f" {word}"
            continue
        if lines[-1]:
            lines.append("")
        while len(word) > max(width, 1):
            lines[-1], word = word[:width], word[width:]
            lines.append("")
        lines[-1] = word
    return lines


def _text(cell: object) -> str:
    if cell is None:
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "NO"
    if isinstance(cell, float):
        return f"{cell:.4g}"
    return str(cell)
