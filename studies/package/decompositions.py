"""`decompose`: the causes of each tracker's error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.controllers.trackers.names import LINEAR
from linkplan.paths import drawn
from linkplan.planner.plan import Plan
from linkplan.planner.problem.settings import whole
from linkplan.reporting import Progress, listener
from linkplan.studies.compare.user_tracker import TrackerLike
from linkplan.studies.decompose import decompose as study
from linkplan.studies.decompose.decomposition_blocks import decomposition_blocks
from linkplan.studies.output.text import html_of, text_of
from linkplan.subjects import listed, with_imperfections, with_motion

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

    Example::

        print(linkplan.decompose(linkplan.plan("knee-reach"), ["pd"], samples=4))
    """
    with_motion(plan, "track")
    listed(trackers, "names or functions")
    whole(seed, "seed", 0, 2**63 - 1)
    given = with_imperfections(plan, imperfections)
    return DecompositionResult(decomposition=study.decompose(given, trackers, samples, seed, listener(progress)))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class DecompositionResult:
    """The causes of errors. `str(result)` is the table; `to_dict()` has every part, by cause and by joint."""

    decomposition: study.Decomposition

    def to_dict(self) -> dict:
        """Return all parts by name, in JSON types: the sum of "parts" is "rms_error", in deg or m."""
        return study.decomposition_record(self.decomposition)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the figure of every tracker's parts as bars, saved at `path` if it is given."""
        from linkplan.studies.decompose.decomposition_blocks import decomposition_figure

        return drawn(path, lambda place: decomposition_figure(self.decomposition, place))

    def _repr_html_(self) -> str:
        return html_of(decomposition_blocks(self.decomposition))

    def __str__(self) -> str:
        return text_of(decomposition_blocks(self.decomposition))

    def __repr__(self) -> str:
        names = ", ".join(one.name for one in self.decomposition.trackers)
        return f"DecompositionResult({self.decomposition.plan.problem.name!r}: {names})"
