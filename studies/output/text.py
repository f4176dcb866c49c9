"""A document as plain text, complete or in brief, for pipes, files and `print`, and as HTML for notebooks."""

import math
import re
from collections.abc import Iterable, Sequence
from html import escape

from msgspec.structs import replace

from linkplan.studies.output.document import Block, Checklist, Code, Facts, Table, Text

# Digits of a document's numbers, which are rounded already.
ROUNDED_DIGITS = 9
# Of more rows of a kind, a summary shows only the worst. A mechanism of four joints is shown completely.
MOST_OF_A_KIND = 4


def text_of(blocks: Sequence[Block]) -> str:
    """Return the text of the blocks; plots and animations have none. Blank lines separate tables."""
    text, below_table = "", True
    for block in blocks:
        if not (lines := _lines(block)):
            continue
        is_table = isinstance(block, Table | Checklist | Code)
        text += ("\n" if text else "") + ("\n" if text and (is_table or below_table) else "") + "\n".join(lines)
        below_table = is_table
    return text


def _lines(block: Block) -> list[str]:
    if isinstance(block, Text):
        return [f"note: {block.text}" if block.tone == "note" else block.text]
    if isinstance(block, Facts):
        return [f"{label}: {value}" for label, value in block.rows]
    if isinstance(block, Code):
        return [f"{block.title}:", "", *(f"  {line}" for line in block.text.splitlines())]
    if isinstance(block, Checklist):
        block = checks(block)
    if not isinstance(block, Table):
        return []
    title = [block.title] if block.title else []
    return [*title, table([headed(*column) for column in block.columns], block.rows, digits=ROUNDED_DIGITS)]


def checks(block: Checklist) -> Table:
    """Return a checklist as a table."""
    rows = [[one.label, one.passed, one.worst, one.limit, one.unit or None, one.instant_s] for one in block.items]
    columns = [(head, "") for head in ("check", "passed", "worst", "limit", "unit")]
    return Table(title=block.title, columns=[*columns, ("at", "s")], rows=rows)


# A longer cell is a sentence: its column is aligned to the left and wraps on a narrow terminal.
SENTENCE_LETTERS = 24
_GAP = "  "


def headed(head: str, unit: str) -> str:
    """Return the head of a column with its unit."""
    return f"{head} [{unit}]" if unit not in ("", "1") else head


def cell_text(cell: object, digits: int = 4) -> str:
    """Return a cell as text."""
    if cell is None:
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "NO"
    return f"{cell:.{digits}g}" if isinstance(cell, float) else str(cell)


def limits_text(low: float, high: float, unit: str, before: str = "") -> str:
    """Return limits as text: the words `before` and "-5 to 5 N.m", or only "no limit"."""
    return "no limit" if low == -math.inf and high == math.inf else f"{before}{low:g} to {high:g} {unit}"


def to_the_left(column: int, cells: Sequence[str]) -> bool:
    """Tell if a column is aligned to the left: the first one, and columns of sentences."""
    return column == 0 or max(map(len, cells), default=0) > SENTENCE_LETTERS


def table(head: Sequence[str], rows: Sequence[Sequence[object]], digits: int = 4) -> str:
    """Return rows under a head in aligned columns, without wrapping; numbers have `digits` significant digits."""
    columns = [[title, *(cell_text(row[k], digits) for row in rows)] for k, title in enumerate(head)]
    for k, column in enumerate(columns):
        width, left = max(map(len, column)), to_the_left(k, column[1:])
        column.insert(1, "-" * width)
        columns[k] = [text.ljust(width) if left else text.rjust(width) for text in column]
    return "\n".join(_GAP.join(line).rstrip() for line in zip(*columns, strict=True))


def in_brief(blocks: Iterable[Block]) -> list[Block]:
    """Return a document with the brief forms of its texts, facts and tables."""
    found = []
    for block in blocks:
        if not isinstance(block, Text | Facts | Table) or block.brief is None:
            found.append(block)
        elif not isinstance(block, Text):
            found += [replace(block, rows=block.brief, brief=None)] if block.brief else []
        elif block.brief:
            found.append(replace(block, text=block.brief, brief=None))
    return found


def brief_rows(rows: Sequence[Sequence], margins: Sequence, units: Sequence[str], names: Iterable[str]) -> list | None:
    """Return rows with only the worst one of each kind above `MOST_OF_A_KIND`, or None if there is no such kind.

    Args:
        rows: each with its label first. Rows of a kind have the same unit, and their labels differ only in names.
        margins: of the rows (n,); the worst row has the least margin.
        units: of the rows (n,).
        names: of the model's parts.
    """
    pattern, kinds = pattern_of(names), {}
    for k, row in enumerate(rows):
        kinds.setdefault((kind_of(row[0], pattern), units[k]), []).append(k)
    if max(map(len, kinds.values()), default=0) <= MOST_OF_A_KIND:
        return None
    kept = []
    for alike in kinds.values():
        worst = min(alike, key=lambda k: margins[k])
        label, *cells = rows[worst]
        few = len(alike) <= MOST_OF_A_KIND
        kept += [rows[k] for k in alike] if few else [[f"{label}, the worst of {len(alike)}", *cells]]
    return kept


def notes_of(sentences: Iterable[str], names: Iterable[str]) -> list[Text]:
    """Return notes; in brief, only the first one of each larger kind, with the number of the others."""
    notes = []
    for first, *others in by_kind(sentences, names):
        few = len(others) < MOST_OF_A_KIND
        brief = None if few else f"{first} (and {len(others)} more of this kind)"
        notes.append(Text(text=first, tone="note", brief=brief))
        notes += [Text(text=text, tone="note", brief=None if few else "") for text in others]
    return notes


def by_kind(sentences: Iterable[str], names: Iterable[str]) -> list[list[str]]:
    """Return the sentences grouped by kind, in the order of the first of each."""
    pattern, kinds = pattern_of(names), {}
    for sentence in sentences:
        kinds.setdefault(kind_of(sentence, pattern), []).append(sentence)
    return list(kinds.values())


def kind_of(sentence: str, names: re.Pattern | None) -> str:
    """Return a sentence without names and numbers, in which sentences of a kind differ."""
    return re.sub(r"(geom )?-?\d[\d.e+-]*", "_", sentence if names is None else names.sub("_", sentence))


def pattern_of(names: Iterable[str]) -> re.Pattern | None:
    """Return the pattern that matches any of the names as a whole word, the longest first; None without a name."""
    known = sorted({re.escape(name) for name in names if name}, key=len, reverse=True)
    return re.compile(rf"(?<![\w-])(?:{'|'.join(known)})(?![\w])") if known else None


_TONES = {"good": "color:#116b3a", "bad": "color:#b3261e;font-weight:600", "note": "opacity:.75"}


def html_of(blocks: Sequence[Block]) -> str:
    """Return the text of the blocks as HTML, with names escaped; plots and animations have none."""
    return "<div>" + "".join(map(_html, blocks)) + "</div>"


def _html(block: Block) -> str:
    if isinstance(block, Text):
        return f'<p style="{_TONES.get(block.tone, "")}">{escape(block.text)}</p>'
    if isinstance(block, Facts):
        return _table("", [], block.rows)
    if isinstance(block, Code):
        return f"<p>{escape(block.title)}</p><pre>{escape(block.text)}</pre>"
    if isinstance(block, Checklist):
        block = checks(block)
    if not isinstance(block, Table):
        return ""
    return _table(block.title, [headed(*column) for column in block.columns], block.rows)


def _table(title: str, heads: Sequence[str], rows: Sequence[Sequence]) -> str:
    caption = f"<caption>{escape(title)}</caption>" if title else ""
    head = f"<thead><tr>{''.join(f'<th>{escape(one)}</th>' for one in heads)}</tr></thead>" if heads else ""
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    return f"<table>{caption}{head}<tbody>{body}</tbody></table>"


def _cell(value: object) -> str:
    return f"<td>{'<b>NO</b>' if value is False else escape(cell_text(value, 6))}</td>"
