"""`decompose`: the causes of each tracker's error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.controllers.trackers.names import LINEAR
from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.paths import drawn
from linkplan.plain import plain
from linkplan.planner.problem.imperfections import imperfections_of
from linkplan.planner.problem.values import whole
from linkplan.plans import Plan
from linkplan.reporting import Progress, listener
from linkplan.studies.compare.user_tracker import TrackerLike
from linkplan.studies.decompose import decompose as study
from linkplan.studies.decompose.decomposition_text import decomposition_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def decompose(
    plan: Plan,
    trackers: Sequence[TrackerLike] = LINEAR,
    *,
    imperfections: Mapping | None = None,
    samples: int = study.DEFAULT_SAMPLES,
    seed: int = 0,
    progress: Progress | None = None,
) -> DecompositionResult:
    """Return each tracker's rms error on a plan, split among its causes: signed parts whose sum is the error.

    Starting from an ideal loop, the effects of a real loop are switched on one by one: discretisation of the plan, the
    feedforward that the tracker lacks, sampling and delay, the simulator, sensors and drives, model error, effort limits
    (docs/choose-a-tracker.md).

    Args:
        plan: with a motion.
        trackers: built-in names, or functions of the sampled reference that return a law.
        imperfections: the table [imperfections] of a problem file; by default that of the problem or, without one, the
            default table (docs/experiments.md).
        samples: number of random machines; there is a single one if nothing is random.
        seed: of all random numbers.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the plan has no motion, or an argument is invalid.
    """
    if not isinstance(plan, Plan):
        raise ProblemError(f"what is tracked is a Plan, got {plan!r}")
    if plan.answer.trajectory is None:
        raise LinkplanError(f"nothing to track, the plan has no motion: {plan.message}")
    if isinstance(trackers, str) or not isinstance(trackers, Sequence):
        raise ProblemError(f"trackers are a list of names or functions, got {trackers!r}")
    whole(seed, "seed", 0, 2**63 - 1)
    answer, problem = plan.answer, plan.answer.problem
    if imperfections is not None:
        table = plain(imperfections)
        imperfections_of(table, problem.mechanism)
        answer = replace(answer, problem=replace(problem, source={**problem.source, "imperfections": table}))
    return DecompositionResult(decomposition=study.decompose(answer, trackers, samples, seed, listener(progress)))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class DecompositionResult:
    """The causes of errors. `str(result)` is the table; `to_dict()` has every part, by cause and by joint."""

    decomposition: study.Decomposition

    def to_dict(self) -> dict:
        """Return all parts by name, in JSON types: the sum of "parts" is "rms_error", in deg or m."""
        return study.decomposition_record(self.decomposition)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the figure of every tracker's parts as bars, saved at `path` if it is given."""
        from linkplan.studies.decompose.draw_decomposition import decomposition_figure

        return drawn(path, lambda place: decomposition_figure(self.decomposition, place))

    def __str__(self) -> str:
        return decomposition_text(self.decomposition)

    def __repr__(self) -> str:
        names = ", ".join(one.name for one in self.decomposition.trackers)
        return f"DecompositionResult({self.decomposition.plan.problem.name!r}: {names})"
