"""`track` and `compare`: built-in and user-defined trackers on a plan in MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.controllers.rollout import Rollout
from linkplan.paths import drawn, path_of
from linkplan.planner.files.folders import plain_record
from linkplan.planner.plan import Plan
from linkplan.planner.problem.build import tracking_from_tables
from linkplan.reporting import Progress, listener
from linkplan.studies.compare import compare as study
from linkplan.studies.compare.comparison_blocks import comparison_blocks
from linkplan.studies.compare.comparison_notes import comparison_record
from linkplan.studies.compare.user_tracker import TrackerLike
from linkplan.studies.output.text import html_of, in_brief, text_of
from linkplan.subjects import listed, tracking_table, with_motion

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def track(
    plan: Plan,
    tracker: TrackerLike = "lqr",
    *,
    mass_factor: float = 1.0,
    delay_periods: float = 0,
    tracking: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> TrackingResult:
    """Return one tracker's run on a plan in MuJoCo.

    Args:
        plan: with a motion.
        tracker: "pd", "pd+ff", "lqr", "lqi", "gs-pd+ff", "ct" or "mpc"; or a `Tracker`: an object with a `name` and
            `effort(k, position_rad, velocity_rad_s)`; or a function of the sampled reference that returns a tracker. The
            reference has `period_s`, and at the control instants `time_s` (n,), `position_rad`, `velocity_rad_s` (n, n_s),
            `pose_rad` (n, n_q) and the needed `effort` (n, n_u) [N.m or N]; slides are in m and m/s. `effort` of a tracker
            returns efforts (n_u,) at instant k for the measured position and velocity (n_s,) of the independent joints;
            the loop adds saturation, sampling and delay.
        mass_factor: on mass and inertia of the payload in the simulator, or of all moving bodies without a payload.
        delay_periods: further control periods (also a fraction) before a command acts, in addition to those of the problem.
        tracking: settings that replace the problem's: kp, kd, period_s, delay_periods, duration_s, lqr_position_deg, ...
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the plan has no motion, or the tracker or another argument is invalid.

    Example::

        print(linkplan.track(linkplan.plan("knee-reach"), "lqr"))
    """
    answer, say = _to_track(plan, tracking), listener(progress)
    mismatch = study.mismatch_of(answer, mass_factor, delay_periods)
    say(f"{answer.problem.name}: one tracker")
    run = study.track(answer, tracker, mismatch)
    title = "nominal" if mismatch is None else mismatch.name
    return TrackingResult(comparison=study.Comparison(plan=answer, nominal={run.tracker: run}, title=title))


def compare(
    plan: Plan,
    trackers: Sequence[TrackerLike] = study.LINEAR,
    *,
    mass_factor: float = 1.2,
    delay_periods: float = 1,
    tracking: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> TrackingResult:
    """Return trackers' runs on a plan in MuJoCo, with the nominal model and with a mismatch.

    Args:
        plan: with a motion.
        trackers: each as for `track`, with different names.
        mass_factor: of the mismatch, on mass and inertia of the payload, or of all moving bodies without a payload.
        delay_periods: of the mismatch, further control periods of delay. With a factor of 1 and no delay there is none.
        tracking: settings that replace the problem's, as for `track`.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: as for `track`.

    Example::

        print(linkplan.compare(linkplan.plan("knee-reach"), ["pd", "lqr"]))
    """
    answer = _to_track(plan, tracking)
    listed(trackers, "names, objects or functions")
    mismatch = study.mismatch_of(answer, mass_factor, delay_periods)
    return TrackingResult(comparison=study.compare(answer, mismatch, listener(progress), trackers))


def _to_track(plan: Plan, tracking: object) -> Plan:
    """Return a plan with a motion, with new tracking settings if any are given."""
    problem = with_motion(plan, "track").problem
    table = tracking_table(problem, tracking)
    if tracking is None:
        return plan
    return replace(plan, problem=replace(problem, tracking=tracking_from_tables({"tracking": table}, problem.mechanism)))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class TrackingResult:
    """Trackers' runs on one plan. `str(result)` is the table; `to_dict()` has every value, with units in the names."""

    comparison: study.Comparison

    @property
    def runs(self) -> dict[str, Rollout]:
        """The runs by tracker with the nominal model, or the mismatch of `track`: logs at control instants, in SI units."""
        return dict(self.comparison.nominal)

    @property
    def mismatched(self) -> dict[str, Rollout]:
        """The runs by tracker with the mismatch of `compare`; empty without a mismatch."""
        return dict(self.comparison.mismatched)

    @property
    def stable(self) -> bool:
        """Whether every run stayed finite and none oscillated between its limits."""
        return all(run.stable for run in (*self.comparison.nominal.values(), *self.comparison.mismatched.values()))

    def to_dict(self) -> dict:
        """Return all values by name, in JSON types: errors in deg or m, efforts, share at the limits, loop gap."""
        return plain_record(comparison_record(self.comparison))

    def save(self, folder: str | Path) -> Path:
        """Write every run's time series into a folder, whole or not at all, with the record and the figure; return its path.

        `nominal-pd.csv` and `.npz` have a row for each control instant, with units in the heads; `mismatch-pd.csv` has the
        same for the mismatch.

        Raises:
            LinkplanError: if the folder has other files, or cannot be written.
        """
        from linkplan.planner.files.folders import write_json, write_whole
        from linkplan.studies.compare.comparison_blocks import comparison_figure
        from linkplan.studies.compare.time_series import save_time_series
        from linkplan.studies.report.render import save_report
        from linkplan.studies.report.reports import comparison_report

        target = path_of(folder, "folder")

        def write(place: Path) -> None:
            write_json(place / "compare.json", self.to_dict())
            save_report(comparison_report(self.comparison), place, page=False)
            save_time_series(self.comparison, place)
            comparison_figure(self.comparison, place / "compare.png")

        write_whole(target, write, "compare.json")
        return target

    def report(self, path: str | Path) -> Path:
        """Write the runs' report, one HTML file that opens offline, and return its path.

        Raises:
            LinkplanError: if another file exists at the path.
        """
        from linkplan.studies.report.render import write_report
        from linkplan.studies.report.reports import comparison_report

        place = path_of(path, "path")
        write_report(comparison_report(self.comparison), place)
        return place

    def plot(self, path: str | Path | None = None, *, every_joint: bool = False) -> Figure:
        """Return the figure of motion, error and effort of every tracker, saved at `path` if it is given.

        It is at most one screen high; with `every_joint` it has all joints, dependent ones too, and all actuators.
        """
        from linkplan.studies.compare.comparison_blocks import comparison_figure

        return drawn(path, lambda place: comparison_figure(self.comparison, place, every_joint=every_joint))

    def _repr_html_(self) -> str:
        return html_of(in_brief(comparison_blocks(self.comparison)))

    def __str__(self) -> str:
        return text_of(in_brief(comparison_blocks(self.comparison)))

    def __repr__(self) -> str:
        names = ", ".join(self.comparison.nominal)
        return f"TrackingResult({self.comparison.plan.problem.name!r}: {names})"
