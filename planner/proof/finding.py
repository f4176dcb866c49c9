"""The result of a proof: claims on the whole motion, each proved, refuted, undecided or sampled."""

import math

from msgspec import Struct

from linkplan.planner.files.structs import Beside, InJson

ANSWERS = ("proved", "refuted", "undecided", "sampled")
# The beginning of the names of findings on a motion of the model near a plan.
OWN_MOTION = "the model's own motion under the planned efforts"


class Finding(Struct, frozen=True, kw_only=True):
    """One claim and its answer.

    `bound` bounds the worst value on the whole motion, in `unit`. For a refuted claim it is a value that certainly occurs,
    at `time_s`. `mark` is the limit plus its allowance. `margin` is the distance from bound to mark, negative beyond it.
    `boxes` counts the boxes of time on which the claim was evaluated. `reason` says why a claim is not proved. A refuted
    claim on a limit has the `limit`'s key and its `part`: an actuator, joint, closure, tendon or site.
    """

    name: str
    answer: str
    unit: str = ""
    bound: float | None = None
    mark: float | None = None
    margin: float | None = None
    boxes: int = 0
    time_s: float | None = None
    reason: str = ""
    limit: str = ""
    part: str = ""

    def sentence(self) -> str:
        """Return the finding in one sentence."""
        if self.answer == "proved":
            return f"{self.name}: proved, margin {self.margin:.3g} {self.unit}".rstrip()
        return f"{self.name}: {self.answer}, {self.reason}"


class Proof(Struct, frozen=True, kw_only=True):
    """The findings on one motion. `boxes` counts the boxes; `seconds` is the processor time of the claims on them.

    `existence_seconds` is the additional processor time of the claim that a motion of the model exists near the plan.
    """

    findings: Beside[tuple[Finding, ...]]
    boxes: int
    seconds: float
    existence_seconds: float = 0.0

    def of(self, answer: str) -> tuple[Finding, ...]:
        """Return the findings with an answer: "proved", "refuted", "undecided" or "sampled"."""
        return tuple(finding for finding in self.findings if finding.answer == answer)

    proved = InJson(lambda self: self.of("proved"))
    refuted = InJson(lambda self: self.of("refuted"))
    undecided = InJson(lambda self: self.of("undecided"))
    sampled = InJson(lambda self: self.of("sampled"))

    @property
    def passed(self) -> bool:
        """True if no claim is refuted."""
        return not self.of("refuted")

    @InJson
    def complete(self) -> bool:
        """True if no claim is refuted or undecided."""
        return self.passed and not self.of("undecided")

    @InJson
    def verdict(self) -> str:
        """The verdict in a word: "proved", "undecided" or "refuted"."""
        return "proved" if self.complete else "undecided" if self.passed else "refuted"

    def sentence(self) -> str:
        """Return a sentence with the verdict and its cost."""
        counts = ", ".join(f"{len(self.of(answer))} {answer}" for answer in ANSWERS if self.of(answer))
        besides = f", existence in {self.existence_seconds:.2g} s" if self.existence_seconds >= 0.01 else ""
        return f"{self.verdict}: {counts}; {self.boxes} boxes in {self.seconds:.2g} s{besides}"

    def __repr__(self) -> str:
        return f"Proof({self.sentence()})"


def finding_of(name: str, value: float, mark: float, unit: str, time_s: float | None = None, where: str = "") -> Finding:
    """Return the finding on a number that a computation without boxes gave: proved if it is at most `mark`, else refuted."""
    kept = value <= mark
    reason = "" if kept else f"{value:.4g} {unit} instead of at most {mark:.4g}{where}".replace("  ", " ")
    margin = mark - value if math.isfinite(value) else None
    answer = "proved" if kept else "refuted"
    return Finding(name=name, answer=answer, unit=unit, bound=value, mark=mark, margin=margin, time_s=time_s, reason=reason)


def no_motion(why: str) -> Finding:
    """Return the finding that no motion of the model is proved near a plan."""
    return Finding(name=OWN_MOTION, answer="sampled", reason=f"by an integration with error control: {why}")
