"""Gains from requirements: PD gains or LQR weights for a bandwidth and margins at the worst pose.

Every candidate is evaluated at every pose with the sampled loop in the simulator's steps: stability, bandwidth of the
complementary sensitivity (-3 dB), phase margin, sensitivity peak, settling time and damping ratio. Candidates lie on a grid
of natural frequency and damping ratio around the required bandwidth, then on finer grids around the best. Among those that
meet the requirements, the best has the smallest damping gain, because this gain amplifies the noise of measured velocities.
With several degrees of freedom every joint has PD gains of its own, found one loop at a time with the others closed.
"""

from collections.abc import Callable, Sequence

import numpy as np

from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.search.planning import silent
from linkplan.studies.feedback.bode.bode import SAME_POSE_SHARE, SCAN_POSITIONS
from linkplan.studies.feedback.bode.scan import PoseLine, judge_of
from linkplan.studies.feedback.frequency.feedback_loops import (
    OperatingPoint,
    SampledLaw,
    operating_point,
    outputs_of,
)
from linkplan.studies.feedback.frequency.plant_modes import plant_modes
from linkplan.studies.feedback.frequency.worst import refined_minima
from linkplan.studies.feedback.tune.requirements import (
    UNSTABLE_SHORTFALL,
    EvaluatedGains,
    Requirements,
    evaluated,
    shortfall,
)
from linkplan.studies.feedback.tune.search import MAX_ROUNDS, found_gains
from linkplan.studies.feedback.tune.tune_report import Tuning
from linkplan.studies.feedback.tune.tuning import gains_by_motor, tracking_values


def tune(
    points: Sequence[OperatingPoint],
    wanted: Requirements,
    law: SampledLaw,
    *,
    say: Callable[[str], None] = silent,
    line: PoseLine | None = None,
    note: str | None = None,
) -> Tuning:
    """Return gains that meet the requirements at every point, or the closest gains and the reason.

    With a line, the requirements hold everywhere on it: the line's worst poses for the gains found are added to the points,
    and the search is repeated until no pose violates the requirements.

    Args:
        points: of one mechanism; one pose or more.
        wanted: the requirements at the worst point.
        law: pd, pd+ff or lqr with its timing; its gains and weights are replaced.
        say: receives progress messages.
        line: the line that the points sample; None if the user gave the poses.
        note: on the choice of the points, for the report.

    Raises:
        LinkplanError: for a bandwidth from the Nyquist frequency on, or LQR with several degrees of freedom.
    """
    mechanism, timing = points[0].mechanism, law.timing
    if law.by_errors and len(mechanism.channels) > 1:
        raise LinkplanError(
            f"tune finds LQR weights for one degree of freedom only, and '{mechanism.name}' has {len(mechanism.channels)}:"
            " use pd or pd+ff, which have gains for each joint; bode shows the margins of given LQR weights"
        )
    if wanted.bandwidth_hz >= timing.nyquist_hz:
        raise LinkplanError(
            f"a bandwidth of {wanted.bandwidth_hz:g} Hz is not below the Nyquist frequency, {timing.nyquist_hz:g} Hz at a"
            f" control period of {timing.period_s:g} s"
        )
    points = list(points)
    for last in [*[False] * (MAX_ROUNDS - 1), True]:
        best = evaluated(points, wanted, found_gains(points, wanted, law, say))
        law = best.law
        if line is None or best.shortfall or last:
            break
        say("the worst of these gains over the whole line")
        worst = _worst(mechanism, line, law, wanted)
        violated = [point for point in worst if evaluated([point], wanted, law).shortfall]
        if not violated:
            break
        points = _along(points, violated)
    # Evaluate the line's worst pose too: it may still violate the requirements after the last round.
    if line is not None and not best.shortfall:
        worst = _worst(mechanism, line, law, wanted)
        at, distance = np.array([point.state for point in points]), SAME_POSE_SHARE * np.ptp(line.states, axis=0).max()
        worst = [point for point in worst if np.abs(at - point.state).max(axis=1).min() > distance][:1]
        points = _along(points, worst)
        best = evaluated(points, wanted, law)
    found, between = best.shortfall == 0.0, []
    if line is not None and mechanism.dof == 1:
        judge = judge_of(mechanism, line, law, mechanism.channels)
        even = np.linspace(line.low, line.high, SCAN_POSITIONS)
        between = [(float(line.at(x)[0]), one[0]) for x in even.tolist() if (one := judge(x))]
    gains = tracking_values(best, mechanism) | {"delay_s": timing.delay_s}
    gains.pop("delay_periods", None)
    return Tuning(
        mechanism_name=mechanism.name,
        tracker=law.name,
        found=found,
        message=_message(points, wanted, best, found, line),
        wanted=wanted,
        gains=gains if law.by_errors else gains | {"motor_side": gains_by_motor(best, mechanism)},
        note="; ".join([*filter(None, [note]), *_allowed_by_springs(points)]) or None,
        points=best.loops,
        mechanism=mechanism,
        best=best,
        between=between,
    )


def _allowed_by_springs(points: Sequence[OperatingPoint]) -> list[str]:
    """Return a sentence for each driven joint that does not move at some frequency, because joints behind it swing."""
    mechanism, found = points[0].mechanism, []
    for channel in mechanism.channels:
        name = mechanism.independent_joints[channel].name
        modes = [mode for point in points for mode in plant_modes(point, channel)[name].anti_resonances]
        if modes and len(outputs_of(mechanism, channel)) > 1:
            lowest = min(modes, key=lambda mode: mode.frequency_hz)
            found.append(
                f"with any gains, joints that move along with {name} swing at {lowest.frequency_hz:.4g} Hz with a damping"
                f" ratio of {lowest.damping_ratio:.2g} while {name} does not move, and follow it only below this frequency"
            )
    return found


def _along(points: Sequence[OperatingPoint], added: Sequence[OperatingPoint]) -> list[OperatingPoint]:
    """Return points with others added: sorted by position for one degree of freedom, else at the end."""
    every = [*points, *added]
    return sorted(every, key=lambda point: float(point.state[0])) if points[0].mechanism.dof == 1 else every


def _worst(mechanism: Mechanism, line: PoseLine, law: SampledLaw, wanted: Requirements) -> list[OperatingPoint]:
    """Return up to three points of a line with the largest shortfall, among its local maxima."""
    judge = judge_of(mechanism, line, law, mechanism.channels)

    def reserve(x: float) -> float:
        """Return the reserve, strongly negative if unstable, infinite if the pose cannot be held."""
        found = judge(x)
        if not found:
            return np.inf
        if not found[0].stable:
            return -UNSTABLE_SHORTFALL - (found[0].spectral_radius or 0.0)
        return -float(max(shortfall(one, wanted, law.timing) for one in found))

    even = np.linspace(line.low, line.high, SCAN_POSITIONS)
    places = sorted([*even, *refined_minima(reserve, even)], key=reserve)[:3]
    return [operating_point(mechanism, line.at(float(x)), law.effort_limit) for x in places if np.isfinite(reserve(x))]


def _message(
    points: Sequence[OperatingPoint], wanted: Requirements, best: EvaluatedGains, found: bool, line: PoseLine | None
) -> str:
    timing, words = best.law.timing, BUILT_IN[best.law.name].words
    asked = f"{wanted.bandwidth_hz:g} Hz and {wanted.phase_margin_deg:g} deg"
    if wanted.sensitivity_peak is not None:
        asked += f" with |S| up to {wanted.sensitivity_peak:g}"
    mechanism = points[0].mechanism
    kinds = [mechanism.independent_joints[channel].kind for channel in mechanism.channels]
    place = "angle" if kinds == ["hinge"] else "pose"
    everywhere = f"all {len(points)} {place}s" if len(points) > 1 else f"the {place}"
    if line is not None:
        place = "instant of the path" if line.unit == "s" else place
        everywhere = f"every {place} from {line.text(line.low, 4)} to {line.text(line.high, 4)} {line.unit}"
    if len(mechanism.channels) > 1:
        everywhere += ", in each joint's loop with the others closed"
    sampled = f"sampled every {timing.period_s:g} s"
    if timing.delay_steps:
        sampled += f" with {timing.delay_s:g} s of delay"
    if found:
        return f"{words} gives {asked} at {everywhere}, {sampled}"
    # The hold of one period and the delay cost this much phase at the required bandwidth with any gains.
    cost = 360.0 * wanted.bandwidth_hz * (0.5 * timing.period_s + timing.delay_s)
    lag = "the hold and the delay alone cost" if timing.delay_steps else "the hold alone costs"
    cannot = f"{words} cannot give {asked} at {everywhere}, {sampled}"
    return f"{cannot}: {_reason(wanted, best)}; {lag} {cost:.3g} deg of phase at {wanted.bandwidth_hz:g} Hz"


def _reason(wanted: Requirements, best: EvaluatedGains) -> str:
    """Return the requirements that the best gains violate, as text."""
    unstable = [loop.point.name for loop in best.loops if not loop.stable]
    if unstable:
        return f"no gains near this bandwidth are stable at {unstable[0]}"
    violated = []
    for name, words, unit, limit in (
        ("bandwidth_hz", "a bandwidth of", " Hz", wanted.bandwidth_hz),
        ("phase_margin_deg", "a phase margin of", " deg", wanted.phase_margin_deg),
        ("sensitivity_peak", "a peak of |S| of", "", wanted.largest_peak),
        ("settling_s", "a settling time of", " s", wanted.settling_s),
        ("damping_ratio", "a damping ratio of", "", wanted.damping_ratio),
        ("stiffness_at_rest", "a stiffness at rest of", "", wanted.stiffness or -np.inf),
    ):
        is_bound_above = name in ("sensitivity_peak", "settling_s")
        value, where = best.worst(name, largest=is_bound_above)
        if value is not None and (value > limit if is_bound_above else value < limit):
            violated.append(f"{words} {value:.4g}{unit} at {where.name}")
    farthest = best.farthest_at_rest()
    response = farthest.response_at_rest
    if wanted.stiffness is None and response is not None and wanted.shortfall_at_rest(response, np.inf) > 0:
        violated.append(f"a response at rest of {100 * response:.4g} % of a step at {farthest.name}")
    return f"the nearest has {' and '.join(violated)}"
