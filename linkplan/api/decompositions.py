"""`decompose`: the causes of each tracker's error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from linkplan.api.command import command
from linkplan.api.inputs import PlanLike, listed, plan_of
from linkplan.api.names import LINEAR
from linkplan.api.reporting import Progress, listener
from linkplan.planner.problem.settings import whole
from linkplan.studies.compare.user_tracker import TrackerLike, trackers_loaded
from linkplan.studies.variations.decompose import decompose as study
from linkplan.studies.variations.decompose.decomposition import Decomposition


@command(
    "split each tracker's error among its causes: plan, sampling and delay, simulator, devices, model, limits",
    saved=True,
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
) -> Decomposition:
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
    return study.decompose(answer, asked, samples, seed, say)
