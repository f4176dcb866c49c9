"""A document as plain text, for pipes, files and `print`, and as a piece of HTML for notebooks, where names are escaped."""

from collections.abc import Sequence
from html import escape

from linkplan.studies.output.document import Block, Checklist, Code, Facts, Table, Text

# Digits of a document's numbers, which are rounded already.
ROUNDED_DIGITS = 9


def text_of(blocks: Sequence[Block]) -> str:
    """Return the blocks that have a text; plots and animations have none. A blank line is next to tables."""
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


_TONES = {"good": "color:#116b3a", "bad": "color:#b3261e;font-weight:600", "note": "opacity:.75"}


def html_of(blocks: Sequence[Block]) -> str:
    """Return the blocks that have a text as HTML; plots and animations have none."""
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
    if value is None:
        return "<td>-</td>"
    if isinstance(value, bool):
        return f"<td>{'yes' if value else '<b>NO</b>'}</td>"
    return f"<td>{escape(f'{value:.6g}' if isinstance(value, float) else str(value))}</td>"
