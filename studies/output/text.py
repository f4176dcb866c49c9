"""A document as plain text, for pipes, files and `print`: its texts, facts, tables and checklists, none of them folded."""

from collections.abc import Sequence

from linkplan.studies.output.document import Block, Checklist, Code, Facts, Table, Text
from linkplan.studies.output.tables import headed, table

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
