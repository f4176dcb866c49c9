"""`decompose`: the causes of each tracker's error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from linkplan.api.command import command
from linkplan.api.inputs import PlanLike, listed, plan_of
from linkplan.api.names import LINEAR
from linkplan.api.reporting import Progress, listener
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.settings import whole
from linkplan.studies.compare.user_tracker import TrackerLike, trackers_loaded
from linkplan.studies.output.document import Block, Report
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.result import Result
from linkplan.studies.variations.decompose import decompose as study
from linkplan.studies.variations.decompose.decomposition import Decomposition
from linkplan.studies.variations.decompose.decomposition_blocks import (
    decomposition_blocks,
    decomposition_figure,
    decomposition_report,
)


@command(
    "split each tracker's error among its causes: plan, sampling and delay, simulator, devices, model, limits",
    record="decompose",
    showing=("report",),
)
def decompose(
    plan: PlanLike,
    trackers: Sequence[TrackerLike] = LINEAR,
    *,
    imperfections: Mapping | None = None,
    samples: int = 16,
    seed: int = 0,
    progress: Progress | None = None,
) -> DecompositionResult:
    """Return each tracker's rms error on a plan, split among its causes: signed parts whose sum is the error.

    Starting from an ideal loop, the effects of a real loop are switched on one by one: discretisation of the plan, the
    feedforward that the tracker lacks, sampling and delay, the simulator, sensors and drives, model error, effort limits
    (docs/choose-a-tracker.md).

    Args:
        plan: a plan with a motion, a problem, or the name or path of either.
        trackers: built-in names, or functions of the sampled reference that return a law.
        imperfections: the table [imperfections] of a problem file; by default that of the problem or, without one, the
            default table (docs/experiments.md).
        samples: number of random machines; there is a single one if nothing is random.
        seed: seed of all random numbers.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the plan has no motion, or an argument is invalid.

    Example::

        print(linkplan.decompose(linkplan.plan("knee-reach"), ["pd"], imperfections={"payload_mass_factor": 1.2}))
    """
    say = listener(progress)
    asked = trackers_loaded(listed(trackers, "names or functions"))
    whole(seed, "seed", 0, 2**63 - 1)
    answer = plan_of(plan, say, "track")
    if imperfections is not None:
        answer = replace(answer, problem=answer.problem.replace(imperfections=imperfections))
    return DecompositionResult(decomposition=study.decompose(answer, asked, samples, seed, say), plan=answer)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class DecompositionResult(Result):
    """The causes of errors. `str(result)` is the table; `to_dict()` has every part, by cause and by joint."""

    record_name = "decompose"

    decomposition: Decomposition
    plan: Plan

    @property
    def passed(self) -> bool:
        """Whether the plan passes and every tracker's error is split."""
        return self.plan.passed and self.decomposition.found

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield decompose, every tracker's parts as bars."""
        yield "decompose", decomposition_figure(self.decomposition)

    def blocks(self) -> list[Block]:
        """Return the table and the charts of the parts."""
        return decomposition_blocks(self.decomposition)

    def document(self) -> Report:
        """Return the report."""
        return decomposition_report(self.decomposition, self.plan)

    def __repr__(self) -> str:
        return f"DecompositionResult({self.decomposition.decomposition!r}: {', '.join(self.decomposition.trackers)})"
