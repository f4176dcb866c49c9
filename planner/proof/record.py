"""The bounds on a claim, collected while boxes are evaluated, and its finding."""

import math
from dataclasses import dataclass, field

from linkplan.planner.proof.claim import Claim
from linkplan.planner.proof.finding import Finding
from linkplan.planner.proof.taylor import TaylorForm, Verdict

# A bound whose remainder is more than this share of it is loose.
_LOOSE_SHARE = 1e-2


@dataclass(eq=False, slots=True, kw_only=True)
class Record:
    """The bounds on one claim so far; the sweep over the boxes extends them."""

    least: float = math.inf
    greatest: float = -math.inf
    least_at: float = 0.0
    greatest_at: float = 0.0
    boxes: int = 0
    refuted: Verdict | None = None
    refuted_at: float = 0.0
    undecided: list[tuple[float, float]] = field(default_factory=list)

    def loosened_by(self, verdict: Verdict, form: TaylorForm, claim: Claim) -> bool:
        """Return True if a bound would extend the known range, and is mostly the remainder."""
        extends = verdict.least < self.least or verdict.greatest > self.greatest
        size = max(abs(verdict.least), abs(verdict.greatest), max(claim.slack) if claim.low == claim.high else 0.0)
        return extends and not form.remainder <= _LOOSE_SHARE * size

    def add(self, verdict: Verdict, time_s: float) -> None:
        """Extend the known range by the bounds on a box."""
        if verdict.least < self.least:
            self.least, self.least_at = verdict.least, time_s
        if verdict.greatest > self.greatest:
            self.greatest, self.greatest_at = verdict.greatest, time_s


def undecided_reason(boxes: list[tuple[float, float]]) -> str:
    """Return a phrase on the boxes (begin, end) [s] that are not decided."""
    begin, end = boxes[0]
    more = f" and in {len(boxes) - 1} more boxes" if len(boxes) > 1 else ""
    return f"not decided between t = {begin:.9g} s and {end:.9g} s{more}"


def finding_of_claim(claim: Claim, record: Record) -> Finding:
    """Return the finding of a claim from its record."""
    k, (low, high) = claim.per_unit, claim.marks
    if record.refuted is not None:
        upper = record.refuted.least > high
        value, mark = (record.refuted.least, high) if upper else (record.refuted.greatest, low)
        reason = f"{value * k:.9g} {claim.unit} at t = {record.refuted_at:.9g} s, beyond {mark * k:.9g}"
        shared = {"answer": "refuted", "margin": -abs(value - mark) * k, "time_s": record.refuted_at, "reason": reason}
    else:
        upper = high - record.greatest <= record.least - low
        value, mark = (record.greatest, high) if upper else (record.least, low)
        margin, when = min(high - record.greatest, record.least - low) * k, record.greatest_at if upper else record.least_at
        reason = undecided_reason(record.undecided) if record.undecided else ""
        answer = "undecided" if record.undecided else "proved"
        shared = {"answer": answer, "margin": margin, "time_s": when, "reason": reason}
    return Finding(name=claim.name, unit=claim.unit, bound=value * k, mark=mark * k, boxes=record.boxes, **shared)
