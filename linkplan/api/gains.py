"""`tune`: gains of a feedback loop for requirements."""

from __future__ import annotations

from collections.abc import Mapping

from linkplan.api.command import command
from linkplan.api.inputs import Poses, Subject, poses_of
from linkplan.api.loops import loop_of
from linkplan.api.names import LINEAR, Law
from linkplan.api.reporting import Progress, listener
from linkplan.models.errors import ProblemError, choose
from linkplan.planner.problem.settings import number
from linkplan.studies.feedback.bode.poses import loop_poses
from linkplan.studies.feedback.frequency.feedback_loops import operating_point, sampled_law
from linkplan.studies.feedback.tune import tune as study
from linkplan.studies.feedback.tune.requirements import Requirements
from linkplan.studies.feedback.tune.tune_report import Tuning


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
