"""`bode` and `tune`: a tracker's feedback loop over the mechanism's poses, and gains for requirements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from linkplan.controllers.trackers.names import LINEAR
from linkplan.models.errors import ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.paths import drawn
from linkplan.planner.files.folders import plain_record
from linkplan.planner.problem.build import tracking_from_tables
from linkplan.planner.problem.settings import Tracking, number
from linkplan.reporting import Progress, listener
from linkplan.studies.bode.bode import BodePoint, BodeStudy, bode_study
from linkplan.studies.bode.bode_blocks import summary
from linkplan.studies.bode.poses import loop_poses
from linkplan.studies.frequency.excitation import Setup
from linkplan.studies.frequency.feedback_loops import QUANTITIES, operating_point, sampled_law
from linkplan.studies.frequency.margins import frequency_grid
from linkplan.studies.output.text import html_of, text_of
from linkplan.studies.tune import tune as tuning
from linkplan.studies.tune import tune_report
from linkplan.studies.tune.judged import LEAST_DAMPING_RATIO, Wanted
from linkplan.subjects import Subject, numbers, poses_of, subject_of, tracking_table

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure


def bode(
    subject: Subject,
    *,
    tracker: str = "pd",
    tracking: Mapping[str, float | Mapping[str, float]] | None = None,
    at_deg: Sequence[Mapping[str, float]] = (),
    at_m: Sequence[Mapping[str, float]] = (),
    measure: bool = True,
    frequency_hz: Sequence[float] | None = None,
    amplitude_deg: float | None = None,
    progress: Progress | None = None,
) -> BodeResult:
    """Return a loop's frequency response, margins and sampled stability: predicted, and measured in MuJoCo.

    Args:
        subject: a mechanism, a `Problem`, or the name or path of either; every degree of freedom has an actuator.
        tracker: a linear feedback law: "pd", "pd+ff" or "lqr". The other trackers have no frequency response.
        tracking: settings that replace the problem's, by the keys of its [tracking] table: kp [N.m/rad], kd [N.m.s/rad],
            period_s, delay_periods (here it may be a fraction), lqr_position_deg, ...
        at_deg: poses to analyse, each the independent hinges' angles [deg] by joint name; by default five over the problem's
            motion, seven over the reach, or home with several degrees of freedom.
        at_m: likewise, for slides [m].
        measure: whether responses are measured in MuJoCo, by a sinestream.
        frequency_hz: frequencies to measure [Hz], below half the sampling rate; by default twenty around the crossover.
        amplitude_deg: of the test signal's motion at the joint, in degrees (metres on a slide); by default small.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if a pose cannot be held, or an argument is invalid.

    Example::

        loop = linkplan.bode("optimus-knee", at_deg=[{"O": 0.0}], measure=False)
        print(loop.stable, loop.message)
    """
    choose("tracker", str(tracker), LINEAR, ProblemError)
    say = listener(progress)
    mechanism, problem, settings, limit = _loop_of(subject, tracking)
    amplitude = None if amplitude_deg is None else number(amplitude_deg, "amplitude_deg", positive=True)
    joint = mechanism.independent_joints[0]
    looked = loop_poses(mechanism, problem, limit, poses_of(mechanism, at_deg, at_m))
    study = bode_study(
        mechanism,
        looked.positions,
        settings,
        limit,
        say,
        law=tracker,
        setup=Setup(amplitude=None if amplitude is None else joint.read(amplitude)) if measure else None,
        frequency_hz=None if frequency_hz is None else np.array(numbers(frequency_hz, "frequency_hz", positive=True)),
        line=looked.line,
        note=looked.note,
    )
    return BodeResult(study=study)


def tune(
    subject: Subject,
    *,
    bandwidth_hz: float,
    phase_margin_deg: float = 60.0,
    sensitivity_peak: float | None = None,
    settling_s: float | None = None,
    damping_ratio: float = LEAST_DAMPING_RATIO,
    stiffness: float | None = None,
    tracker: str = "pd",
    tracking: Mapping[str, float | Mapping[str, float]] | None = None,
    at_deg: Sequence[Mapping[str, float]] = (),
    at_m: Sequence[Mapping[str, float]] = (),
    progress: Progress | None = None,
) -> TuneResult:
    """Return gains that meet the requirements at the worst pose, or the nearest ones with the reason why none do.

    With several degrees of freedom every joint has PD gains of its own, found one loop at a time with the others closed.

    Args:
        subject: a mechanism with one actuator for each degree of freedom, a `Problem` of one, or the name or path of either.
        bandwidth_hz: least bandwidth of every joint's loop [Hz]: the first frequency at which the complementary
            sensitivity is below -3 dB.
        phase_margin_deg: least phase margin [deg].
        sensitivity_peak: the largest sensitivity; by default any.
        settling_s: the longest time [s] in which an error settles to 2 %; by default 5 over the bandwidth.
        damping_ratio: the least damping ratio of the closed loop's poles.
        stiffness: the least stiffness at rest [N.m/rad or N/m] of every joint; by default a joint settles within 5 %
            of a small step of its reference, although weight and springs pull it away.
        tracker: a linear feedback law: "pd", "pd+ff" or "lqr". The other trackers have no frequency response.
        tracking: settings that replace the problem's, as for `bode`; only the period and the delay matter.
        at_deg: poses, as for `bode`.
        at_m: likewise, for slides [m].
        progress: called with lines on the progress.

    Raises:
        LinkplanError: for a bandwidth above half the sampling rate, LQR with several degrees of freedom, or an
            invalid argument.

    Example::

        gains = linkplan.tune("optimus-knee", bandwidth_hz=10.0)
        print(gains.tracking)
    """
    choose("tracker", str(tracker), LINEAR, ProblemError)
    say = listener(progress)
    peak = np.inf if sensitivity_peak is None else number(sensitivity_peak, "sensitivity_peak", positive=True)
    wanted = Wanted(
        bandwidth_hz=number(bandwidth_hz, "bandwidth_hz", positive=True),
        phase_margin_deg=number(phase_margin_deg, "phase_margin_deg", at_least_zero=True),
        sensitivity_peak=peak,
        settling_s=None if settling_s is None else number(settling_s, "settling_s", positive=True),
        damping_ratio=number(damping_ratio, "damping_ratio", at_least_zero=True),
        stiffness=None if stiffness is None else number(stiffness, "stiffness", positive=True),
    )
    mechanism, problem, settings, limit = _loop_of(subject, tracking)
    looked = loop_poses(mechanism, problem, limit, poses_of(mechanism, at_deg, at_m))
    points = [operating_point(mechanism, position, limit) for position in looked.positions]
    law = sampled_law(mechanism, tracker, settings, limit)
    return TuneResult(tuning=tuning.tune(points, wanted, law, say=say, line=looked.line, note=looked.note))


def _loop_of(subject: Subject, tracking: object):
    """Return the mechanism, its problem or None, the tracking settings and the effort limits (n_u, 2)."""
    mechanism, problem = subject_of(subject)
    settings = _settings(tracking_table(problem, tracking), mechanism)
    if problem is None:
        return mechanism, None, settings, mechanism.effort_limit
    return mechanism, problem, settings, problem.limits.actuators_effort


def _settings(table: dict, mechanism: Mechanism) -> Tracking:
    """Return the tracking settings of a table; its delay may be a fraction of a period."""
    settings = tracking_from_tables({"tracking": {key: x for key, x in table.items() if key != "delay_periods"}}, mechanism)
    if not settings.acts:
        raise ProblemError("tracking.kp and tracking.kd are both 0: there is no loop to look at")
    return replace(settings, delay_periods=table.get("delay_periods", 0))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class BodeResult:
    """A loop's frequency response. `str(result)` is the table; `to_dict()` has every value, with units in the names."""

    study: BodeStudy

    @property
    def stable(self) -> bool:
        """Whether the sampled loop is stable at every analysed pose."""
        return self.study.stable

    @property
    def message(self) -> str:
        """The verdict in a sentence."""
        return self.study.message

    @property
    def poses(self) -> tuple[str, ...]:
        """The names of the analysed poses, for `lti` and `frd`."""
        return tuple(dict.fromkeys(entry.point.name for entry in self.study.points))

    def lti(self, pose: str | None = None, *, closed: bool = False) -> control.StateSpace:
        """Return the sampled loop at a pose as python-control's state space, with its period as `dt` [s].

        The open loop is broken at the actuators: from commands u (n_u,) [N.m or N] to the law's output K x (n_u,) of the
        linearised plant. The closed loop goes from commands added to the law's to the state x = (s, s') (2 n_s,) [rad or m,
        and per second], with past commands as further states.

        Args:
            pose: one of `poses`; by default the first one.
            closed: whether the loop is closed.

        Raises:
            LinkplanError: for an unknown pose.
        """
        return self._entry(pose, None).sampled.system(closed=closed)

    def frd(
        self, quantity: str = "loop", pose: str | None = None, *, joint: str | None = None, measured: bool = False
    ) -> control.FrequencyResponseData:
        """Return a response at a pose as python-control's frequency response data, over frequencies in rad/s.

        Args:
            quantity: "plant", "loop", "sensitivity", "complementary", "control", "reference" or "reference+ff"; angles are
                in radians.
            pose: one of `poses`; by default the first one.
            joint: of the loop; by default the first independent joint.
            measured: whether the response is the one measured in MuJoCo, instead of the prediction.

        Raises:
            LinkplanError: for an unknown name, or a response that was not measured.
        """
        entry = self._entry(pose, joint)
        choose("response", quantity, QUANTITIES, ProblemError)
        if measured:
            if quantity not in entry.measured:
                known = ", ".join(entry.measured) or "none"
                raise ProblemError(f"no '{quantity}' was measured at {entry.point.name}; measured: {known}")
            return entry.measured[quantity].frd()
        frequency_hz = frequency_grid(self.study.law.timing.period_s)[:-1]  # below the Nyquist frequency
        return entry.sampled.response(quantity, frequency_hz, entry.channel).frd()

    def _entry(self, pose: str | None, joint: str | None) -> BodePoint:
        at, channel = (
            choose("pose", self.poses[0] if pose is None else str(pose), self.poses, ProblemError),
            self._channel(joint),
        )
        return next(entry for entry in self.study.points if entry.point.name == at and entry.channel == channel)

    def _channel(self, joint: str | None) -> int:
        """Return the index of an independent joint, by default of the first one."""
        names = [one.name for one in self.study.mechanism.independent_joints]
        return names.index(choose("independent joint", names[0] if joint is None else str(joint), names, ProblemError))

    def to_dict(self) -> dict:
        """Return all values by name, in JSON types."""
        from linkplan.studies.bode.bode_report import bode_record

        return plain_record(bode_record(self.study))

    def plot(self, path: str | Path | None = None, *, joint: str | None = None) -> Figure:
        """Return the figure of open and closed loop at every pose, saved at `path` if it is given.

        Args:
            path: of the picture.
            joint: of the loop, for several degrees of freedom; by default the first independent joint.

        Raises:
            LinkplanError: if the joint is not independent.
        """
        from linkplan.studies.bode.bode_report import bode_figure

        channel = self._channel(joint)
        entries = [entry for entry in self.study.points if entry.channel == channel]
        return drawn(path, lambda place: bode_figure(self.study, entries, place))

    def _repr_html_(self) -> str:
        return html_of(summary(self.study))

    def __str__(self) -> str:
        return text_of(summary(self.study))

    def __repr__(self) -> str:
        return f"BodeResult({self.study.mechanism.name!r}: {self.message})"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class TuneResult:
    """Gains for requirements. `str(result)` is the report; `to_dict()` has every value, with units in the names."""

    tuning: tuning.Tuning

    @property
    def found(self) -> bool:
        """Whether the gains meet the requirements at every pose; if not, they are the nearest ones."""
        return self.tuning.found

    @property
    def message(self) -> str:
        """The verdict in a sentence."""
        return self.tuning.message

    @property
    def tracking(self) -> dict[str, float | dict[str, float]]:
        """The gains as the `tracking` table of problems, `track`, `compare` and `bode`."""
        return tune_report.tracking_values(self.tuning)

    def to_dict(self) -> dict:
        """Return all values by name, in JSON types."""
        return plain_record(tune_report.tune_record(self.tuning))

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the figure of bandwidth and margins over the poses, saved at `path` if it is given."""
        return drawn(path, lambda place: tune_report.tune_figure(self.tuning, place))

    def __str__(self) -> str:
        return text_of(tune_report.tune_blocks(self.tuning))

    def __repr__(self) -> str:
        return f"TuneResult({self.tuning.mechanism.name!r}: {self.message})"
