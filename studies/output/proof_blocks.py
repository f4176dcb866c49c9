"""A proof as a document: what is proved, refuted and undecided at every instant, and what is checked at samples."""

from collections.abc import Sequence

from linkplan.planner.proof.finding import Finding, Proof
from linkplan.studies.output.document import Block, Table, Text, table_of

_TITLES = {
    "refuted": "Refuted: the motion certainly breaks these",
    "undecided": "Undecided: the smallest boxes did not decide these",
    "proved": "Proved at every instant, for the model and the polynomials of the plan",
}


def proof_blocks(proof: Proof | None) -> list[Block]:
    """Return a proof's verdict and its findings by answer; nothing without a proof."""
    if proof is None:
        return []
    blocks: list[Block] = [Text(text=f"proof: {proof.sentence()}", tone="good" if proof.complete else "plain")]
    blocks += [_table(title, proof.of(answer)) for answer, title in _TITLES.items() if proof.of(answer)]
    sampled = [[finding.name, finding.reason] for finding in proof.of("sampled")]
    return [*blocks, *([table_of("Sampled, not proved", ["claim", "reason"], sampled)] if sampled else [])]


def _table(title: str, findings: Sequence[Finding]) -> Table:
    heads = ["claim", "worst value", "at most or at least", "margin", "unit", "boxes", "time [s]"]
    rows = [
        [
            f.name,
            _digits(f.bound),
            _digits(f.mark),
            None if f.margin is None else f"{f.margin:.3g}",
            f.unit,
            f.boxes,
            f.time_s,
        ]
        for f in findings
    ]
    if any(finding.reason for finding in findings):
        heads, rows = [*heads, "reason"], [[*row, f.reason] for row, f in zip(rows, findings, strict=True)]
    return table_of(title, heads, rows)


def _digits(value: float | None) -> str | None:
    return None if value is None else f"{value:.9g}"
