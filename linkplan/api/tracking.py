"""`track` and `compare`: built-in and user-defined trackers on a plan in MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import structs

from linkplan.api.command import command
from linkplan.api.inputs import PlanLike, Source, listed, plan_of, source_of, tracking_table
from linkplan.api.names import LINEAR
from linkplan.api.reporting import Listener, Progress, listener
from linkplan.controllers.rollout import Rollout
from linkplan.models.errors import ProblemError
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.settings import number, whole
from linkplan.studies.compare import compare as study
from linkplan.studies.compare.comparison_blocks import comparison_blocks, comparison_figure
from linkplan.studies.compare.comparison_figures import ComparisonFigures, comparison_figures
from linkplan.studies.compare.named_run import NamedRun
from linkplan.studies.compare.time_series import save_time_series
from linkplan.studies.compare.user_tracker import TrackerLike, trackers_loaded
from linkplan.studies.output.document import Block, Report, Text
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.paths import drawn
from linkplan.studies.output.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@command("run one tracker on a plan in MuJoCo", record="track", showing=("all", "report", "parquet"))
def track(
    plan: PlanLike,
    tracker: TrackerLike = "pd+ff",
    *,
    sample: int | None = None,
    mass_factor: float = 1.0,
    delay_periods: float = 0,
    tracking: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> TrackingResult:
    """Return one tracker's run on a plan in MuJoCo, or on a machine of an experiment.

    Args:
        plan: a plan with a motion, a problem, or the name or path of either. With `sample`, an experiment's folder.
        tracker: "pd", "pd+ff", "lqr", "lqi", "gs-pd+ff", "ct" or "mpc"; or a `Tracker`: an object with a `name` and
            `effort(k, position_rad, velocity_rad_s)`; or a function of the sampled reference that returns a tracker. The
            reference has `period_s`, and at the control instants `time_s` (n,), `position_rad`, `velocity_rad_s` (n, n_s),
            `pose_rad` (n, n_q) and the needed `effort` (n, n_u) [N.m or N]; slides are in m and m/s. A tracker's `effort`
            returns efforts (n_u,) at instant k for the measured position and velocity (n_s,) of the independent joints; the
            loop adds saturation, sampling and delay. Also "module:object", or the name of a tracker of an installed package.
        sample: the sample of the experiment to run again, with identical results.
        mass_factor: factor on mass and inertia of the payload in the simulator, or of all moving bodies without a payload.
        delay_periods: additional delay of commands in control periods, which may be a fraction.
        tracking: settings that replace the problem's: kp, kd, period_s, delay_periods, duration_s, lqr_position_deg, ...
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the plan has no motion, or the tracker or another argument is invalid.

    Example::

        print(linkplan.track(linkplan.plan("knee-reach"), "lqr"))
    """
    say = listener(progress)
    if sample is not None:
        if not isinstance(plan, Source | str | Path):
            raise ProblemError(f"with sample, plan must be the folder of an experiment, got {plan!r}")
        source = source_of(plan)
        given = {
            "set": source.settings,
            "anyway": source.anyway,
            "mass_factor": mass_factor != 1.0,
            "delay_periods": delay_periods != 0,
            "tracking": tracking is not None,
        }
        if named := [name for name, is_given in given.items() if is_given]:
            raise ProblemError(f"{', '.join(named)} cannot be combined with sample, which repeats a run of an experiment")
        return _replayed(source.name, tracker, sample)
    factor, delay = _checked(mass_factor, delay_periods)
    asked = trackers_loaded([tracker])[0]
    answer = _to_track(plan, tracking, say)
    mismatch = study.mismatch_of(answer, factor, delay)
    say(f"{answer.problem.name}: one tracker")
    run = study.track(answer, asked, mismatch)
    title, stem = ("nominal", "nominal") if mismatch is None else (mismatch.name, "mismatch")
    comparison = study.Comparison(plan=answer, nominal={run.tracker: run}, title=title, stem=stem)
    figures = structs.replace(comparison_figures(comparison), tracker=run.tracker)
    return TrackingResult(figures=figures, comparison=comparison, record_name="track")


def _replayed(place: str, tracker: TrackerLike, sample: int) -> TrackingResult:
    """Return the run of a tracker on a machine of an experiment's folder."""
    from linkplan.studies.variations.experiment.block import replay
    from linkplan.studies.variations.experiment.study import refuse_changed_tracker, saved_experiment

    folder, name = Path(place), str(tracker)
    experiment = saved_experiment(folder)
    refuse_changed_tracker(folder, name)
    run, said = replay(experiment, name, whole(sample, "sample", 0, 2**31))
    title, stem = f"sample {sample}", f"sample-{sample}"
    comparison = study.Comparison(plan=experiment.plan, nominal={name: run}, title=title, stem=stem)
    figures = structs.replace(comparison_figures(comparison), tracker=name, sample=said)
    return TrackingResult(figures=figures, comparison=comparison, record_name="track")


@command(
    "run trackers on a plan and compare them, nominal and with a mismatch",
    record="compare",
    showing=("all", "report", "parquet"),
)
def compare(
    plan: PlanLike,
    trackers: Sequence[TrackerLike] = LINEAR,
    *,
    mass_factor: float = 1.2,
    delay_periods: float = 1,
    tracking: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> TrackingResult:
    """Return trackers' runs on a plan in MuJoCo, with the nominal model and with a mismatch.

    Args:
        plan: with a motion; or its problem, or the name or path of either.
        trackers: each as for `track`, with different names.
        mass_factor: of the mismatch, factor on mass and inertia of the payload, or of all moving bodies without a payload.
        delay_periods: of the mismatch, additional control periods of delay. With a factor of 1 and no delay there is
            no mismatch.
        tracking: settings that replace the problem's, as for `track`.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: as for `track`.

    Example::

        print(linkplan.compare(linkplan.plan("knee-reach"), ["pd", "lqr"]))
    """
    say = listener(progress)
    asked = trackers_loaded(listed(trackers, "names, objects or functions"))
    factor, delay = _checked(mass_factor, delay_periods)
    answer = _to_track(plan, tracking, say)
    comparison = study.compare(answer, study.mismatch_of(answer, factor, delay), say, asked)
    return TrackingResult(figures=comparison_figures(comparison), comparison=comparison)


def _checked(mass_factor: object, delay_periods: object) -> tuple[float, float]:
    """Return the numbers of a mismatch, checked before a plan is made."""
    return number(mass_factor, "mass_factor", positive=True), study.delay_of(delay_periods, "delay_periods")


def _to_track(plan: PlanLike, tracking: object, say: Listener) -> Plan:
    """Return a plan with a motion, with new tracking settings if any are given."""
    answer = plan_of(plan, say, "track")
    if tracking is None:
        return answer
    table = tracking_table(answer.problem.to_dict().get("tracking", {}), tracking)
    return replace(answer, problem=answer.problem.replace(tracking=table))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class TrackingResult(Result):
    """Trackers' runs on one plan. `str(result)` is the table; `to_dict()` has every value, with units in the names."""

    has_parquet = True
    figures: ComparisonFigures
    comparison: study.Comparison
    record_name: str = "compare"

    @property
    def passed(self) -> bool:
        """Whether the plan passes and every run is stable."""
        sample = self.figures.sample
        lost = sample is not None and sample["failure"] is not None
        plan = self.comparison.plan.passed or sample is not None
        return plan and not lost and self.stable

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
        if (sample := self.figures.sample) is None:
            return comparison_blocks(self.comparison)
        from linkplan.studies.variations.experiment.experiment_sections import machine_section

        failure = sample["failure"]
        lost = [Text(text=failure, tone="bad")] if failure else []
        return [*comparison_blocks(self.comparison), *lost, *machine_section(sample).blocks]

    def document(self) -> Report:
        """Return the report."""
        from linkplan.studies.compare.tracking_sections import comparison_report
        from linkplan.studies.variations.experiment.experiment_sections import replay_report

        if self.figures.sample is not None:
            return replay_report(self.comparison, self.figures.sample)
        return comparison_report(self.comparison)

    def write_files(self, place: Path, *, parquet: bool) -> None:
        """Write every run's time series."""
        save_time_series(self.comparison, place, parquet=parquet)

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield every tracker's motion, error and effort."""
        yield self.record_name, comparison_figure(self.comparison)

    def plot(self, path: str | Path | None = None, *, every_joint: bool = False) -> Figure:
        """Return the figure of motion, error and effort of every tracker, saved at `path` if it is given.

        It is at most one screen high; with `every_joint` it has all joints, dependent ones too, and all actuators.
        """
        return drawn(path, lambda: comparison_figure(self.comparison, every_joint=every_joint))

    def __repr__(self) -> str:
        names = ", ".join(self.comparison.nominal)
        return f"TrackingResult({self.comparison.plan.problem.name!r}: {names})"
