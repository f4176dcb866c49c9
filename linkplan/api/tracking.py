"""`track` and `compare`: built-in and user-defined trackers on a plan in MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import structs

from linkplan.api.command import command
from linkplan.api.inputs import AnyPlan, Source, any_plan_of, listed, source_of, tracking_table
from linkplan.api.names import LINEAR
from linkplan.api.reporting import Listener, Progress, listener
from linkplan.models.errors import ProblemError
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.settings import number, whole
from linkplan.studies.compare import compare as study
from linkplan.studies.compare.tracking_result import TrackingResult, tracking_result
from linkplan.studies.compare.user_tracker import TrackerLike, trackers_loaded

if TYPE_CHECKING:
    from linkplan.planner.plan.phased import PhasedRecord
    from linkplan.studies.compare.ground_tracking import GroundTracking


@command("run one tracker on a plan in MuJoCo", saved=True, showing=("all", "report", "parquet"))
def track(
    plan: AnyPlan,
    tracker: TrackerLike = "pd+ff",
    *,
    sample: int | None = None,
    mass_factor: float = 1.0,
    delay_periods: float = 0,
    tracking: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> TrackingResult | GroundTracking:
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
    if not isinstance(answer, Plan):
        return _on_ground(answer, [asked], (factor, delay), say, alone=True)
    mismatch = study.mismatch_of(answer, factor, delay)
    say(f"{answer.problem.name}: one tracker")
    run = study.track(answer, asked, mismatch)
    title, stem = ("nominal", "nominal") if mismatch is None else (mismatch.name, "mismatch")
    comparison = study.Comparison(plan=answer, nominal={run.tracker: run}, title=title, stem=stem)
    return tracking_result(comparison, run.tracker)


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
    return tracking_result(comparison, name, said)


@command(
    "run trackers on a plan and compare them, nominal and with a mismatch",
    saved=True,
    showing=("all", "report", "parquet"),
)
def compare(
    plan: AnyPlan,
    trackers: Sequence[TrackerLike] = LINEAR,
    *,
    mass_factor: float = 1.2,
    delay_periods: float = 1,
    tracking: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> TrackingResult | GroundTracking:
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
    if not isinstance(answer, Plan):
        return _on_ground(answer, asked, (factor, delay), say)
    comparison = study.compare(answer, study.mismatch_of(answer, factor, delay), say, asked)
    return tracking_result(comparison)


def _on_ground(
    plan: PhasedRecord,
    asked: Sequence[TrackerLike],
    unequal: tuple[float, float],
    say: Listener,
    *,
    alone: bool = False,
) -> GroundTracking:
    """Return trackers' runs on a plan in phases on the ground."""
    from linkplan.studies.compare.ground_tracking import ground_tracking

    mismatch = study.mismatch_of(plan.plans[0], *unequal) if plan.plans else None
    return ground_tracking(plan, asked, mismatch, say, alone=alone)


def _checked(mass_factor: object, delay_periods: object) -> tuple[float, float]:
    """Return the numbers of a mismatch, checked before a plan is made."""
    return number(mass_factor, "mass_factor", positive=True), study.delay_of(delay_periods, "delay_periods")


def _to_track(plan: AnyPlan, tracking: object, say: Listener) -> Plan | PhasedRecord:
    """Return a plan with a motion, or one in phases, with new tracking settings if any are given."""
    answer = any_plan_of(plan, say, "track")
    if tracking is None:
        return answer
    if isinstance(answer, Plan):
        return _with_tracking(answer, tracking)
    return structs.replace(answer, plans=tuple(_with_tracking(phase, tracking) for phase in answer.plans))


def _with_tracking(plan: Plan, tracking: object) -> Plan:
    table = tracking_table(plan.problem.to_dict().get("tracking", {}), tracking)
    return replace(plan, problem=plan.problem.replace(tracking=table))
