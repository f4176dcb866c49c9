"""The result of `linkplan compare` and `track`, whose fields are the record `compare.json`, and its sections."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct

from linkplan.controllers.rollout import Rollout
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.problem.default_gains import tracking_of
from linkplan.planner.problem.keys.imperfections import QUANTITIES
from linkplan.studies.compare.compare import Comparison, RunTime, run_figures, tracking_reference
from linkplan.studies.compare.comparison_blocks import (
    comparison_blocks,
    comparison_figure,
    comparison_notes,
    effort_plots,
    gap_plots,
    joint_plots,
    largest,
    site_plots,
)
from linkplan.studies.compare.named_run import NamedRun, save_time_series
from linkplan.studies.output.animation import Run, animation, frames_of
from linkplan.studies.output.document import Block, Report, Section, Text, table_of
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.paths import drawn
from linkplan.studies.output.plan_sections import group_of, plan_sections
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class TrackingResult(Result, Struct, frozen=True, kw_only=True, eq=False, omit_defaults=True):
    """Errors in deg or m, efforts, share at the limits and closure gap of each tracker's run on one plan.

    `loop` has the simulator's settings. `mismatch` has the same for the runs with a mismatch. `tracker` is the tracker of
    `track`, and `sample` the repeated sample of an experiment.
    """

    has_parquet = True

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
    comparison: Beside[Comparison] = NOT_READ

    @property
    def record_name(self) -> str:
        """The name of the record: that of the command."""
        return "compare" if self.tracker is None else "track"

    @property
    def passed(self) -> bool:
        """Whether the plan passes and every run is stable."""
        if self.sample is not None:
            return self.sample["failure"] is None and self.stable
        return self.comparison.plan.passed and self.stable

    @property
    def runs(self) -> dict[str, NamedRun]:
        """The runs by tracker with the nominal model, or the mismatch of `track`: logs at the control instants."""
        return self._named(self.comparison.nominal)

    @property
    def mismatched(self) -> dict[str, NamedRun]:
        """The runs by tracker with the mismatch of `compare`; empty without a mismatch."""
        return self._named(self.comparison.mismatched)

    def _named(self, runs: Mapping[str, Rollout]) -> dict[str, NamedRun]:
        mechanism = self.comparison.plan.problem.mechanism
        return {tracker: NamedRun.of(run, mechanism) for tracker, run in runs.items()}

    @property
    def stable(self) -> bool:
        """Whether every run stayed finite and none oscillated between its limits."""
        return all(run.stable for run in (*self.comparison.nominal.values(), *self.comparison.mismatched.values()))

    def blocks(self) -> list[Block]:
        """Return the tables of errors and efforts, and the machine of a sample."""
        found = comparison_blocks(self.comparison)
        if self.sample is None:
            return found
        lost = [Text(text=self.sample["failure"], tone="bad")] if self.sample["failure"] else []
        return [*found, *lost, *machine_section(self.sample).blocks]

    def document(self) -> Report:
        """Return the report of trackers' runs on a plan, or of a repeated sample of an experiment."""
        name, sections = self.comparison.plan.problem.name, whole_comparison(self.comparison)
        if (sample := self.sample) is not None:
            result = sample["failure"] or ("success" if sample["success"] else "outside the tube")
            verdict = f"{self.tracker} on machine {sample['sample']}: {result}"
            passed, sections = bool(sample["success"]) and sample["failure"] is None, [machine_section(sample), *sections]
            return report_of(f"A machine of the experiment on {name}", verdict, passed, sections)
        runs = self.comparison.nominal
        stable, lost = ([tracker for tracker, run in runs.items() if run.stable == is_so] for is_so in (True, False))
        verdict = f"{self.case}: {', '.join(stable) or 'no tracker'} stable" + (f", {', '.join(lost)} NOT" if lost else "")
        return report_of(f"Trackers on {name}", verdict, bool(stable), sections)

    def write_files(self, place: Path, *, parquet: bool) -> None:
        """Write every run's time series."""
        save_time_series(self.comparison, place, parquet=parquet)

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield every tracker's motion, error and effort."""
        yield self.record_name, comparison_figure(self.comparison)

    def plot(self, path: str | Path | None = None, *, every_joint: bool = False) -> "Figure":
        """Return the figure of motion, error and effort of every tracker, saved at `path` if it is given.

        It is at most one screen high; with `every_joint` it has all joints, dependent ones too, and all actuators.
        """
        return drawn(path, lambda: comparison_figure(self.comparison, every_joint=every_joint))

    def __repr__(self) -> str:
        return f"TrackingResult({self.plan['name']!r}: {', '.join(self.trackers)})"


def tracking_result(
    comparison: Comparison, tracker: str | None = None, sample: Mapping[str, Any] | None = None
) -> TrackingResult:
    """Return the result of a comparison's runs, or of one `tracker`, perhaps on a `sample` of an experiment."""
    plan, mismatch = comparison.plan, comparison.mismatch
    gains = tracking_of(plan.problem)
    return TrackingResult(
        case=comparison.title,
        plan={
            "name": plan.problem.name,
            "status": plan.status,
            "message": plan.message,
            "objective": plan.objective,
            "duration_s": plan.trajectory.duration_s,
            "certificate_passed": plan.certificate.passed,
        },
        gains={"kp": gains.kp, "kd": gains.kd},
        **_side(comparison, comparison.nominal),
        notes=comparison_notes(comparison),
        run_time=comparison.run_time,
        mismatch=None if mismatch is None else {"name": mismatch.name, **_side(comparison, comparison.mismatched)},
        tracker=tracker,
        sample=sample,
        comparison=comparison,
    )


def _side(comparison: Comparison, runs: Mapping[str, Rollout]) -> dict[str, Any]:
    trackers = {name: run_figures(comparison.plan, run) for name, run in runs.items()}
    return {"loop": next(iter(runs.values())).conditions, "trackers": trackers}


def machine_section(sample: Mapping) -> Section:
    """Return the section of one sample's machine with its imperfections; `sample` is the record of its run."""
    units = [QUANTITIES[name.partition(".")[0]].unit for name in sample["imperfections"]]
    values = zip(sample["imperfections"].items(), units, strict=True)
    rows = [[name, value, None if unit == "1" else unit] for (name, value), unit in values]
    table = table_of("Imperfections", ["imperfection", "value", "unit"], rows, digits=6)
    return Section(title=f"Machine {sample['sample']}", blocks=[table])


# With more joints or actuators, those with the largest errors and efforts are shown and the others are collapsed.
_MAX_JOINTS_SHOWN = 6


def comparison_sections(comparison: Comparison) -> list[Section]:
    """Return the sections of trackers' runs on a plan, without those of the plan."""
    mechanism, blocks = comparison.plan.problem.mechanism, [_animation(comparison), *comparison_blocks(comparison)]
    found = [Section(title=f"Tracking: {comparison.plan.problem.name}", blocks=blocks)]
    for title, runs in comparison.cases:  # over time, the joints and actuators with the largest errors and efforts first
        chosen, pushed = largest(runs.values(), _MAX_JOINTS_SHOWN)
        others = [k for k in range(mechanism.dof) if k not in chosen], [j for j in range(mechanism.n_u) if j not in pushed]
        blocks = [*joint_plots(comparison, runs, chosen), *site_plots(comparison, runs)]
        blocks += [*effort_plots(comparison, runs, pushed), *gap_plots(comparison, runs)]
        found.append(Section(title=f"Over time: {title}", blocks=[*_left_out(mechanism, *others), *blocks], depth=2))
        if any(others):
            blocks = [*joint_plots(comparison, runs, others[0]), *effort_plots(comparison, runs, others[1])]
            found.append(Section(title=f"Other joints: {title}", blocks=blocks, depth=2, folded=True))
    return found


def whole_comparison(comparison: Comparison) -> list[Section]:
    """Return the sections of a comparison and those of its plan."""
    return [*comparison_sections(comparison), *plan_sections(comparison.plan, animated=False)]


def _animation(comparison: Comparison) -> Block:
    """Return the animation of the planned motion over the tracked time, with every run as a ghost."""
    plan = comparison.plan
    mechanism, reference = plan.problem.mechanism, tracking_reference(plan)
    cases = comparison.cases
    n_runs = sum(len(runs) for _, runs in cases)
    frames = np.unique(np.linspace(0, reference.n - 1, frames_of(mechanism, 1 + n_runs)).astype(int))
    ghosts = {}
    for k, (_, runs) in enumerate(cases):
        for name, run in runs.items():
            seen = np.flatnonzero(np.isfinite(run.pose_rad).all(axis=1))
            last = int(seen[-1]) if len(seen) else 0  # a diverged run keeps its last finite pose, with zero effort
            at, ran = np.minimum(frames, last), (frames <= last)[:, None]
            drawn = Run(poses=np.nan_to_num(run.pose_rad[at]), effort=np.where(ran, run.applied[at], 0.0))
            ghosts[name if k == 0 else f"{name}, with the mismatch"] = drawn
    return animation(
        mechanism,
        f"{mechanism.name} along {plan.problem.name}, planned and as tracked",
        group_of(plan),
        reference.time_s[frames],
        reference.pose_rad[frames],
        effort=reference.effort[frames],
        effort_limit=effort_bounds(plan.problem),
        ghosts=ghosts,
        sites=plan.problem.sites,
    )


def _left_out(mechanism: Mechanism, joints: list[int], actuators: list[int]) -> list[Text]:
    if not joints and not actuators:
        return []
    said = (
        f"The plots show the {mechanism.dof - len(joints)} of {mechanism.dof} joints with the largest errors and the"
        f" {mechanism.n_u - len(actuators)} of {mechanism.n_u} actuators with the largest efforts; the section below shows"
        " the others."
    )
    return [Text(text=said, tone="note")]
