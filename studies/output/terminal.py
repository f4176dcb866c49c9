"""A document on a terminal, drawn by rich: tables in its width, verdicts in colours. It is loaded for terminals only."""

import os
from collections.abc import Sequence
from typing import TextIO

from rich import box
from rich.console import Console
from rich.table import Table as Drawn
from rich.text import Text as Words

from linkplan.studies.output.document import Block, Checklist, Table, Text
from linkplan.studies.output.text import ROUNDED_DIGITS, SENTENCE_LETTERS, cell_text, checks, headed, text_of, to_the_left

_TONES = {"good": "green", "bad": "red", "note": "yellow"}
_VERDICTS = {"NO": "red", "infeasible": "red", "failed": "red", "optimal": "green", "passed": "green"}
# Longer words are broken.
_LONGEST_WORD_LETTERS = 36
# The number of blanks between two columns of a table.
_GAP_LETTERS = 2


def console_of(stream: TextIO) -> Console:
    """Return the console of a terminal, without colours if NO_COLOR is set (no-color.org) or the terminal is dumb."""
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM", "dumb") in ("", "dumb")
    return Console(file=stream, color_system=None if plain else "auto", highlight=False, markup=False, emoji=False)


def drawn(stream: TextIO, blocks: Sequence[Block]) -> str:
    """Return a document as text for a terminal, with control sequences."""
    console = console_of(stream)
    with console.capture() as written:
        below_text = False
        for block in blocks:
            if isinstance(block, Checklist):
                block = checks(block)
            if isinstance(block, Table):
                title = [Words(block.title, style="bold")] if block.title else []
                console.print(*([Words("")] if below_text else []), *title, *_parts(block, console.width), sep="\n")
                below_text = False
            elif text := text_of([block]):
                console.print(Words(text, style=_TONES.get(block.tone, "") if isinstance(block, Text) else ""))
                below_text = True
    return written.get()


def _parts(block: Table, width: int) -> list[Drawn | Words]:
    """Return a table divided into parts that fit into a width; each part has the first column.

    An empty line follows each part.
    """
    heads = [headed(*column) for column in block.columns]
    cells = [[cell_text(row[k], ROUNDED_DIGITS) for row in block.rows] for k in range(len(heads))]
    least = [_least(head, column) for head, column in zip(heads, cells, strict=True)]
    parts: list[list[int]] = [[0]]
    for k in range(1, len(heads)):
        if len(parts[-1]) > 1 and _total([least[i] for i in (*parts[-1], k)]) > width:
            parts.append([0])
        parts[-1].append(k)
    found: list[Drawn | Words] = []
    for part in parts:
        widths = [max(map(len, (heads[k], *cells[k]))) for k in part]
        while _total(widths) > width and (able := [(w, i) for i, w in enumerate(widths) if w > least[part[i]]]):
            widths[max(able)[1]] -= 1
        one = Drawn(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1), collapse_padding=True)
        for k, w in zip(part, widths, strict=True):
            left = to_the_left(k, cells[k]) or max(map(len, cells[k]), default=0) > w
            head = heads[k] if len(heads[k]) <= w else heads[k].replace(" [", "\n[")  # a unit is never wrapped
            one.add_column(Words(head), justify="left" if left else "right", width=w, overflow="fold", vertical="top")
        for row in zip(*(cells[k] for k in part), strict=True):
            one.add_row(*(Words(text, style=_VERDICTS.get(text, "")) for text in row))
        found += [one, Words("")]
    return found


def _least(head: str, cells: Sequence[str]) -> int:
    """Return the least width of a column: that of its short cells, and of single words in its head and its long cells."""
    title, bracket, unit = head.partition(" [")
    words = [*title.split(), bracket[1:] + unit]
    words += [word for text in cells if len(text) > SENTENCE_LETTERS for word in text.split()]
    short = [len(text) for text in cells if len(text) <= SENTENCE_LETTERS]
    long = SENTENCE_LETTERS if len(short) < len(cells) else 0
    return max(min(max(map(len, words), default=0), _LONGEST_WORD_LETTERS), long, *short, 0)


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + _GAP_LETTERS * (len(widths) - 1)
