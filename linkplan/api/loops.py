"""`bode` and `tune`: feedback loops about operating points, and gains for requirements on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from linkplan.api.command import command
from linkplan.api.inputs import Poses, Subject, numbers, plan_of, poses_of, read_subject, tracking_table
from linkplan.api.names import LINEAR, Frequencies, Law
from linkplan.api.reporting import Progress, listener
from linkplan.models.errors import ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.build import tracking_from_tables
from linkplan.planner.problem.default_gains import with_gains
from linkplan.planner.problem.keys.reading import kind_of, read
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import Tracking, number, to_toml_types
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.bode.bode_report import BodeStudy
from linkplan.studies.feedback.bode.further_studies import along_motion, large_study, map_study
from linkplan.studies.feedback.bode.plant_blocks import PlantStudy
from linkplan.studies.feedback.bode.plant_study import plant_study
from linkplan.studies.feedback.bode.poses import loop_poses
from linkplan.studies.feedback.frequency.excitation import Setup
from linkplan.studies.feedback.frequency.feedback_loops import operating_point, refuse_several_freedoms, sampled_law
from linkplan.studies.feedback.tune import tune as study
from linkplan.studies.feedback.tune.requirements import Requirements
from linkplan.studies.feedback.tune.tune_report import Tuning
from linkplan.studies.output.paths import check_flags

if TYPE_CHECKING:
    pass


@command(
    "frequency response, margins and sampled stability of a feedback loop, predicted and measured in MuJoCo",
    saved=True,
    showing=("report",),
)
def bode(
    subject: Subject,
    *,
    tracker: Law = "pd",
    kp: float | None = None,
    kd: float | None = None,
    period_s: float | None = None,
    delay_periods: float | None = None,
    tracking: Mapping[str, float | Mapping[str, float]] | None = None,
    at_deg: Poses = (),
    at_m: Poses = (),
    from_effort: Sequence[str] = (),
    to_position: Sequence[str] = (),
    measure: bool = True,
    frequency_hz: Frequencies | None = None,
    amplitude_deg: float | None = None,
    map: bool = False,  # noqa: A002 (the option's name)
    large: bool = False,
    along: bool = False,
    progress: Progress | None = None,
) -> BodeStudy | PlantStudy:
    """Return a loop's frequency response, margins and sampled stability: predicted, and measured in MuJoCo.

    With `from_effort` and `to_position` it returns the plant's response instead: poles and zeros, gain and phase from each
    effort to each position, with all other efforts constant. The tracker then only holds the plant for the measurement.

    Args:
        subject: a mechanism with an actuator, a `Problem`, or the name or path of either. Joints that no actuator drives
            move along; `plant to JOINT` is the response to them.
        tracker: a linear feedback law: "pd", "pd+ff" or "lqr". The other trackers have no frequency response.
        kp: proportional gain of every joint [N.m/rad or N/m]; by default the problem's. In Python `tracking` can set
            this and the next three, too.
        kd: derivative gain [N.m.s/rad or N.s/m]; by default the problem's.
        period_s: control period [s]; by default the problem's.
        delay_periods: computing delay in control periods, which may be a fraction.
        tracking: settings that replace the problem's, by the keys of its [tracking] table: kp, kd, period_s,
            lqr_position_deg, ...
        at_deg: poses to analyse, each the independent hinges' angles [deg] by joint name, or a number for the only joint; by
            default five over the problem's motion, seven over the reach, or home with several degrees of freedom.
        at_m: likewise, for slides [m].
        from_effort: inputs of the plant: names of actuators, or of driven joints for the total effort on the joint.
        to_position: outputs of the plant: names of joints; "foot.z" for a site's coordinate in the world; "body.shank" for
            the angle of a body that turns about one axis.
        measure: whether responses are measured in MuJoCo, by a sinestream.
        frequency_hz: frequencies to measure [Hz], below half the sampling rate; by default twenty around the crossover,
            or around a plant's resonances.
        amplitude_deg: amplitude of the test signal's motion at the joint, in degrees (metres on a slide); by default small.
        map: whether the stable gains are mapped over all positions and tried in MuJoCo next to the stability boundary.
        large: whether signals beyond the effort limit are measured and compared with the describing function.
        along: whether the tracked motion of the problem is analysed: margins at frozen instants, Floquet multipliers.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if a pose cannot be held, or an argument is invalid.

    Example::

        loop = linkplan.bode("optimus-knee", at_deg=[{"O": 0.0}], measure=False)
        print(loop.stable, loop.message)
    """
    choose("tracker", str(tracker), LINEAR, ProblemError)
    check_flags(measure=measure, map=map, large=large, along=along)
    is_plant = _asks_for_plant(from_effort, to_position, {"map": map, "large": large, "along": along})
    say = listener(progress)
    given = {"kp": kp, "kd": kd, "period_s": period_s, "delay_periods": delay_periods}
    mechanism, problem, settings, limit = loop_of(subject, tracking, given)
    if along and problem is None:
        raise ProblemError("along needs a problem with a motion, got a model")
    for name, is_asked in (("map", map), ("large", large)):
        if is_asked:
            refuse_several_freedoms(mechanism, name)
    amplitude = None if amplitude_deg is None else number(amplitude_deg, "amplitude_deg", positive=True)
    joint = mechanism.independent_joints[0]
    most = joint.shown(np.pi if joint.kind == "hinge" else mechanism.extent_m)
    if amplitude is not None and amplitude > most:
        raise ProblemError(f"amplitude_deg must be at most {most:.4g} {joint.unit}, got {amplitude:g}")
    looked = loop_poses(mechanism, problem, limit, poses_of(mechanism, at_deg, at_m))
    setup = Setup(amplitude=None if amplitude is None else joint.read(amplitude)) if measure else None
    at_hz = None if frequency_hz is None else np.array(numbers(frequency_hz, "frequency_hz", positive=True))
    common = {"law": tracker, "setup": setup, "frequency_hz": at_hz, "note": looked.said(mechanism, "bode")}
    if is_plant:
        named = list(from_effort), list(to_position)
        return plant_study(mechanism, looked.positions, *named, settings, limit, say, **common)
    study = bode_study(mechanism, looked.positions, settings, limit, say, line=looked.line, **common)
    further = {
        "map": map_study(study, say) if map else None,
        "large": large_study(study, None if problem is None else problem.limits, say) if large else None,
        "along": along_motion(plan_of(problem, say, "analyse"), tracker, study.law.settings, say)
        if along and problem
        else None,
    }
    return structs.replace(study, **further)


def _asks_for_plant(efforts: object, positions: object, others: Mapping[str, bool]) -> bool:
    """Tell if a plant is asked for.

    Refuse an input without output or the reverse, and a plant together with studies of a loop.
    """
    for name, value in (("from_effort", efforts), ("to_position", positions)):
        if isinstance(value, str) or not isinstance(value, Sequence) or not all(isinstance(one, str) for one in value):
            raise ProblemError(f"{name} must be a list of names, got {value!r}")
    if bool(efforts) != bool(positions):
        given, missing = ("from_effort", "to_position") if efforts else ("to_position", "from_effort")
        raise ProblemError(f"{given} also needs {missing}: a plant has inputs and outputs")
    for name, is_asked in others.items():
        if efforts and is_asked:
            raise ProblemError(
                f"{name} analyses the loop of a tracker; it cannot be combined with from_effort and to_position"
            )
    return bool(efforts)


def loop_of(
    subject: Subject, tracking: object, given: Mapping[str, float | None]
) -> tuple[Mechanism, Problem | None, Tracking, np.ndarray]:
    """Return the mechanism, its problem or None, the tracking settings and the effort limits (n_u, 2)."""
    mechanism, problem, own = read_subject(subject)
    asked = {key: read(kind_of(f"tracking.{key}"), to_toml_types(x), key) for key, x in given.items() if x is not None}
    settings = tracking_from_tables({"tracking": tracking_table(own, tracking) | asked}, mechanism)
    if not settings.acts:
        raise ProblemError("kp and kd are both 0: there is no feedback")
    settings = with_gains(settings, mechanism, (lambda: mechanism.home) if problem is None else problem.start_pose)
    limit = mechanism.effort_limit if problem is None else problem.limits.actuators_effort
    return mechanism, problem, settings, limit


@command(
    "find PD gains or LQR weights for a bandwidth and margins at the worst pose",
    saved=True,
    showing=("report",),
)
def tune(
    subject: Subject,
    *,
    bandwidth_hz: float,
    phase_margin_deg: float = 60.0,
    sensitivity_peak: float | None = None,
    settling_s: float | None = None,
    damping_ratio: float = 0.4,
    stiffness: float | None = None,
    tracker: Law = "pd",
    period_s: float | None = None,
    delay_periods: float | None = None,
    tracking: Mapping[str, float | Mapping[str, float]] | None = None,
    at_deg: Poses = (),
    at_m: Poses = (),
    progress: Progress | None = None,
) -> Tuning:
    """Return gains that meet the requirements at the worst pose, or the nearest gains with the reason why none meet them.

    With several degrees of freedom every joint has its own PD gains, found one loop at a time with the others closed.

    Args:
        subject: a mechanism with an actuator, a `Problem`, or the name or path of either.
        bandwidth_hz: least bandwidth of every joint's loop [Hz]: the first frequency at which the complementary
            sensitivity is below -3 dB.
        phase_margin_deg: least phase margin [deg].
        sensitivity_peak: the largest allowed peak of the sensitivity; by default there is no limit.
        settling_s: the longest time [s] in which an error settles to 2 %; by default 5 over the bandwidth.
        damping_ratio: the least damping ratio of the closed loop's poles.
        stiffness: the least stiffness at rest [N.m/rad or N/m] of every joint; by default so that a joint settles within 5 %
            of a small step of its reference, in spite of weight and springs.
        tracker: a linear feedback law: "pd", "pd+ff" or "lqr". The other trackers have no frequency response.
        period_s: control period [s]; by default the problem's.
        delay_periods: computing delay in control periods, which may be a fraction.
        tracking: settings that replace the problem's, as for `bode`; only the period and the delay matter.
        at_deg: poses to look at, each the independent hinges' angles [deg] by joint name, or a number for the only joint; by
            default as for `bode`.
        at_m: likewise, for slides [m].
        progress: called with lines on the progress.

    Raises:
        LinkplanError: for a bandwidth above half the sampling rate, LQR with several degrees of freedom, or an
            invalid argument.

    Example::

        gains = linkplan.tune("optimus-knee", bandwidth_hz=10.0, at_deg=[{"O": 0.0}])
        print(gains.tracking)
    """
    choose("tracker", str(tracker), LINEAR, ProblemError)
    say = listener(progress)
    wanted = Requirements(
        bandwidth_hz=number(bandwidth_hz, "bandwidth_hz", positive=True),
        phase_margin_deg=number(phase_margin_deg, "phase_margin_deg", at_least_zero=True),
        sensitivity_peak=None if sensitivity_peak is None else number(sensitivity_peak, "sensitivity_peak", positive=True),
        **({} if settling_s is None else {"settling_s": number(settling_s, "settling_s", positive=True)}),
        damping_ratio=number(damping_ratio, "damping_ratio", at_least_zero=True),
        stiffness=None if stiffness is None else number(stiffness, "stiffness", positive=True),
    )
    mechanism, problem, settings, limit = loop_of(subject, tracking, {"period_s": period_s, "delay_periods": delay_periods})
    looked = loop_poses(mechanism, problem, limit, poses_of(mechanism, at_deg, at_m))
    points = [operating_point(mechanism, position, limit) for position in looked.positions]
    law = sampled_law(mechanism, tracker, settings, limit)
    return study.tune(points, wanted, law, say=say, line=looked.line, note=looked.said(mechanism, "tune"))
