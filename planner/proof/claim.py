"""A claim on every instant of a motion: a quantity as a series, the interval in which it lies, and the bounds on it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.planner.proof.finding import Finding
from linkplan.planner.proof.motion import Kinetics, State
from linkplan.planner.proof.taylor import TaylorForm, Verdict
from linkplan.planner.proof.walk import Ball


@dataclass(frozen=True, eq=False, slots=True)
class Claim:
    """low - slack[0] <= f(t) <= high + slack[1] at every instant. Every value of `values` at a state must satisfy it.

    Numbers are in SI; a number times `per_unit` is in `unit`. The default slack is the allowance for rounding.
    """

    name: str
    unit: str
    bounds: Sequence[float] | np.ndarray
    values: Callable[[State], list[Ball]]
    slack: tuple[float, float] | None = None
    per_unit: float = 1.0

    @property
    def allowed(self) -> tuple[float, float]:
        """The allowances on [low, high]. For rounding, as in the certificate: 1e-9, or 1e-9 of a limit above one."""
        low, high = (ROUNDING_SHARE * max(1.0, abs(float(x))) if np.isfinite(x) else 0.0 for x in self.bounds)
        return (low, high) if self.slack is None else self.slack

    @property
    def marks(self) -> tuple[float, float]:
        """The limits [low, high], extended by their allowances."""
        return float(self.bounds[0]) - self.allowed[0], float(self.bounds[1]) + self.allowed[1]


def of_kinetics(of: Callable[[Kinetics], Ball]) -> Callable[[State], list[Ball]]:
    """Return the values of a quantity for the one or two `Kinetics` of a motion."""
    return lambda state: [of(kinetics) for kinetics in state.kinetics]


# A bound whose remainder is more than this share of it is loose.
_LOOSE_SHARE = 1e-2


@dataclass(eq=False, slots=True, kw_only=True)
class Record:
    """The bounds found so far on the quantity of one claim. The sweep over the boxes extends them."""

    least: float = math.inf
    greatest: float = -math.inf
    least_at: float = 0.0
    greatest_at: float = 0.0
    boxes: int = 0
    refuted: Verdict | None = None
    refuted_at: float = 0.0
    undecided: list[tuple[float, float]] = field(default_factory=list)

    def loosened_by(self, verdict: Verdict, form: TaylorForm, claim: Claim) -> bool:
        """Return True if a bound would extend the known range and consists mostly of the Taylor form's remainder."""
        extends = verdict.least < self.least or verdict.greatest > self.greatest
        size = max(
            abs(verdict.least), abs(verdict.greatest), max(claim.allowed) if claim.bounds[0] == claim.bounds[1] else 0.0
        )
        return extends and not form.remainder <= _LOOSE_SHARE * size

    def add(self, verdict: Verdict, time_s: float) -> None:
        """Extend the known range by the bounds on a box."""
        if verdict.least < self.least:
            self.least, self.least_at = verdict.least, time_s
        if verdict.greatest > self.greatest:
            self.greatest, self.greatest_at = verdict.greatest, time_s


def undecided_reason(boxes: list[tuple[float, float]]) -> str:
    """Return the reason that lists the undecided boxes (begin, end) [s]."""
    begin, end = boxes[0]
    more = f" and in {len(boxes) - 1} more boxes" if len(boxes) > 1 else ""
    return f"not decided between t = {begin:.9g} s and {end:.9g} s{more}"


def finding_of_claim(claim: Claim, record: Record) -> Finding:
    """Return the finding on a claim from the bounds in its record."""
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
