"""A document as a piece of HTML for notebooks: its texts, facts, tables and checklists. Names are escaped."""

from collections.abc import Sequence
from html import escape

from linkplan.studies.output.document import Block, Checklist, Code, Facts, Table, Text
from linkplan.studies.output.text import checks, headed

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
