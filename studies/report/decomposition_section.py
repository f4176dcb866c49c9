"""The section of a decomposition: the parts of every tracker's error as a table and as bars, with their explanation."""

from linkplan.studies.decompose.decompose import Decomposition, decomposition_record
from linkplan.studies.decompose.decomposition_text import notes, whole_column
from linkplan.studies.decompose.ladder import RUNGS
from linkplan.studies.report.cause_sections import decomposition_charts
from linkplan.studies.report.document import Section, Table, Text


def decomposition_section(found: Decomposition, *, depth: int = 1) -> Section:
    """Return the section of a decomposition: causes in rows, trackers in columns."""
    tables = []
    for unit in dict.fromkeys(unit for one in found.trackers for unit in one.shares):
        ours = {one.name: one.shares[unit] for one in found.trackers if unit in one.shares}
        columns = [map(float, whole_column([*shares.parts, shares.rms])) for shares in ours.values()]
        rows = [list(row) for row in zip([*RUNGS.values(), "rms error, the sum of all"], *columns, strict=True)]
        heads = [("switched on", ""), *((name, unit) for name in ours)]
        tables.append(Table(title="Parts of the rms error", columns=heads, rows=rows))
    said = [Text(text=text, tone="note") for text in notes(found)]
    blocks = [*tables, *decomposition_charts(decomposition_record(found)), *said]
    return Section(title=f"Where the error comes from: {found.plan.problem.name}", blocks=blocks, depth=depth)
