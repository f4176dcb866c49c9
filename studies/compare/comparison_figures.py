"""The result of `linkplan compare` and `track`, whose fields are the record `compare.json`."""

from collections.abc import Mapping
from typing import Any

from msgspec import Struct

from linkplan.controllers.rollout import Rollout
from linkplan.studies.compare.compare import Comparison, run_figures
from linkplan.studies.compare.comparison_notes import comparison_notes
from linkplan.studies.compare.run_time import RunTime


class ComparisonFigures(Struct, frozen=True, kw_only=True, eq=False, omit_defaults=True):
    """Errors in deg or m, efforts, share at the limits and closure gap of each tracker's run on one plan.

    `loop` has the simulator's settings. `mismatch` has the same for the runs with a mismatch. `tracker` is the tracker of
    `track`, and `sample` the repeated sample of an experiment.
    """

    case: str
    plan: dict[str, Any]
    gains: dict[str, Any]
    loop: dict[str, Any]
    trackers: dict[str, dict[str, Any]]
    notes: list[str]
    run_time: dict[str, RunTime]
    mismatch: dict[str, Any] | None = None
    tracker: str | None = None
    sample: Mapping[str, Any] | None = None


def comparison_figures(comparison: Comparison) -> ComparisonFigures:
    """Return the figures of a comparison's runs."""
    plan, mismatch = comparison.plan, comparison.mismatch
    return ComparisonFigures(
        case=comparison.title,
        plan={
            "name": plan.problem.name,
            "status": plan.status,
            "message": plan.message,
            "objective": plan.objective,
            "duration_s": plan.trajectory.duration_s,
            "certificate_passed": plan.certificate.passed,
        },
        gains={"kp": plan.problem.tracking.kp, "kd": plan.problem.tracking.kd},
        **_side(comparison, comparison.nominal),
        notes=comparison_notes(comparison),
        run_time=comparison.run_time,
        mismatch=None if mismatch is None else {"name": mismatch.name, **_side(comparison, comparison.mismatched)},
    )


def _side(comparison: Comparison, runs: Mapping[str, Rollout]) -> dict[str, Any]:
    trackers = {name: run_figures(comparison.plan, run) for name, run in runs.items()}
    return {"loop": next(iter(runs.values())).conditions, "trackers": trackers}
