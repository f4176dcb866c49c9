"""Gains from requirements: PD gains or LQR weights for a bandwidth and margins at the worst pose.

Every candidate is evaluated at every pose with the sampled loop in the simulator's steps: stability, bandwidth of the
complementary sensitivity (-3 dB), phase margin, sensitivity peak, settling time and damping ratio. Candidates lie on a grid
of natural frequency and damping ratio around the required bandwidth, then on finer grids around the best. Among those that
meet the requirements, the best has the smallest damping gain, because this gain amplifies the noise of measured velocities.
With several degrees of freedom every joint has PD gains of its own, found one loop at a time with the others closed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.keys.kinds import LQR_ERRORS
from linkplan.planner.problem.settings import Tracking
from linkplan.planner.search.planning import silent
from linkplan.studies.feedback.bode.bode import SAME_POSE_SHARE, SCAN_POSITIONS
from linkplan.studies.feedback.bode.scan import PoseLine, judge_of
from linkplan.studies.feedback.frequency.feedback_loops import (
    OperatingPoint,
    SampledLaw,
    law_gain,
    operating_point,
    outputs_of,
)
from linkplan.studies.feedback.frequency.margins import passive_stiffness
from linkplan.studies.feedback.frequency.quick import quick_loops
from linkplan.studies.feedback.frequency.stability_map import effort_map
from linkplan.studies.feedback.frequency.transfer_function import plant_modes
from linkplan.studies.feedback.frequency.worst import refined_minima
from linkplan.studies.feedback.tune.requirements import (
    UNSTABLE_SHORTFALL,
    EvaluatedGains,
    Requirements,
    evaluated,
    shortfall,
)
from linkplan.studies.feedback.tune.tune_report import Tuning
from linkplan.studies.feedback.tune.tuning import gains_by_motor, tracking_values

# Search range of the natural frequency, in units of the required bandwidth, and of the damping ratio.
_NATURAL_FREQUENCY_RANGE = (0.08, 4.0)
_DAMPING_RATIO_RANGE = (0.15, 8.0)
_GRID_LEVELS = 4
# The least share of kd^2 due to the velocity weight of an LQR; with less, the weight would have no effect.
_LEAST_EXTRA_DAMPING = 0.01
# The search uses approximate margins, so it requires this factor more than the user.
_SEARCH_RESERVE = 1.005
# Number of rounds: with the worst poses of a line added (at most two were needed in practice), and over the joints of
# several degrees of freedom, where each joint's gains are searched again with the latest gains of the others.
MAX_ROUNDS = 5


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


def found_gains(
    points: Sequence[OperatingPoint], wanted: Requirements, law: SampledLaw, say: Callable[[str], None]
) -> SampledLaw:
    """Return the law with the least shortfall at the points or, among those without, the least damping gain.

    Several joints first get gains of the same natural frequency and damping ratio, each for its own inertia. If these fall
    short, one joint's gains are searched at a time, with the loops of the others closed, in a few rounds over the joints
    (sequential loop closing, Skogestad & Postlethwaite, Multivariable Feedback Control, 2005, 10.6).
    """
    mechanism = points[0].mechanism
    channels, joints = mechanism.channels, mechanism.independent_joints
    if len(channels) == 1:
        return _refined(points, wanted, law, channels, say)
    zeros = {joint.name: 0.0 for joint in joints}  # passive spins have no gains
    first = replace(law, settings=law.settings.replace(kp=zeros, kd=zeros))
    best = evaluated(points, wanted, _refined(points, wanted, first, channels, say))
    law = best.law
    for number in range(MAX_ROUNDS):
        if best.shortfall == 0.0:
            break
        for channel in channels:
            name = joints[channel].name

            def told(words: str, number: int = number, name: str = name) -> None:
                say(f"{name}, round {number + 1}: {words}")

            law = _refined(points, wanted, law, [channel], told)
        found = evaluated(points, wanted, law)
        best = found if found.shortfall < best.shortfall else best
    return best.law


def _refined(
    points: Sequence[OperatingPoint],
    wanted: Requirements,
    law: SampledLaw,
    channels: Sequence[int],
    say: Callable[[str], None],
) -> SampledLaw:
    """Return the best gains of some joints on a grid that is refined around its best point; other joints keep theirs."""
    highest = max(_NATURAL_FREQUENCY_RANGE[1], 2 * _natural_at_rest(points, wanted, channels))
    ends = np.log([(_NATURAL_FREQUENCY_RANGE[0], highest), _DAMPING_RATIO_RANGE])
    centre, half = ends.mean(axis=1), 0.5 * np.diff(ends, axis=1).ravel()
    best: tuple[float, float, SampledLaw] | None = None
    several = law.by_errors or len(points[0].mechanism.channels) > 1
    # Grid points along each axis: fewer for LQR, which solves a Riccati equation for every candidate and pose, and for
    # several joints, whose loops are all evaluated for every candidate.
    count = 9 if several else 17
    for level in range(_GRID_LEVELS):
        say(f"gains, grid {level + 1} of {_GRID_LEVELS}" + ("" if best is None else f", shortfall {best[0]:.3g}"))
        axis = np.linspace(-1.0, 1.0, count)
        at = [(a, b) for a in centre[0] + half[0] * axis for b in centre[1] + half[1] * axis]
        candidates = [
            replace(law, settings=_settings(points, wanted, law, channels, *np.exp(place).tolist())) for place in at
        ]
        shortfalls = _shortfalls(points, candidates, wanted)
        # The damping gain increases with the product of natural frequency and damping ratio, the sum of their logarithms.
        ranked = min(range(len(at)), key=lambda i: (shortfalls[i], sum(at[i])))
        row = float(shortfalls[ranked]), sum(at[ranked]), candidates[ranked]
        if best is None or row[:2] <= best[:2]:
            best, centre = row, np.array(at[ranked])
        half = half * 2.5 / count
    return best[2]


def _natural_at_rest(points: Sequence[OperatingPoint], wanted: Requirements, channels: Sequence[int]) -> float:
    """Return the natural frequency [required bandwidths] of gains that meet the requirement at rest."""
    found = 0.0
    for point in points:
        stiffness = passive_stiffness(point).diagonal()
        for k in channels:
            pulled = abs(stiffness[k]) / (1.0 - (wanted.response_at_rest or 0.0))
            needed = pulled if wanted.stiffness is None else wanted.stiffness + abs(stiffness[k])
            found = max(found, float(np.sqrt(needed / point.inertia[k, k])))
    return found / (2 * np.pi * wanted.bandwidth_hz)


def _settings(
    points: Sequence[OperatingPoint],
    wanted: Requirements,
    law: SampledLaw,
    channels: Sequence[int],
    natural: float,
    damping: float,
) -> Tracking:
    """Return settings with gains or weights of some joints, each for its mean inertia.

    They give a natural frequency (in required bandwidths) and a damping ratio.
    """
    omega, joints = 2 * np.pi * wanted.bandwidth_hz * natural, points[0].mechanism.independent_joints
    inertia = [float(np.exp(np.mean([np.log(point.inertia[k, k]) for point in points]))) for k in channels]
    settings = law.settings
    if law.by_errors:
        return _with_weights(points, settings, channels[0], inertia[0], omega, damping)
    names = [joints[k].name for k in channels]
    kp = {name: own * omega**2 for name, own in zip(names, inertia, strict=True)}
    kd = {name: 2 * damping * own * omega for name, own in zip(names, inertia, strict=True)}
    if isinstance(settings.kp, Mapping) and isinstance(settings.kd, Mapping):
        return settings.replace(kp={**settings.kp, **kp}, kd={**settings.kd, **kd})
    return settings.replace(kp=kp[names[0]], kd=kd[names[0]])


def _with_weights(points, settings: Tracking, channel: int, inertia: float, omega: float, damping: float) -> Tracking:
    """Return settings with the LQR weights of a single joint that give a natural frequency [rad/s] and a damping ratio.

    LQR of a double integrator has kp = u / s_w and kd^2 = 2 J kp + (u / v_w)^2, with the weights s_w and v_w. The effort
    u of unit cost is the actuator's limit through the transmission.
    """
    kp, kd, joint = inertia * omega**2, 2 * damping * inertia * omega, points[0].mechanism.independent_joints[channel]
    actuator = points[0].mechanism.actuators[0]
    limit = max(abs(actuator.lower), abs(actuator.upper))
    limit = limit if np.isfinite(limit) else max(1.0, max(float(np.abs(point.hold[0])) for point in points))
    limit /= abs(float(effort_map(points[0])[0, channel]))
    # A velocity weight increases LQR's kd above sqrt(2 J kp). If a smaller kd is required, the result is half a percent
    # above it.
    extra = max(kd**2 - 2 * inertia * kp, _LEAST_EXTRA_DAMPING * 2 * inertia * kp)
    position, velocity = (float(np.clip(joint.shown(x), *LQR_ERRORS)) for x in (limit / kp, limit / np.sqrt(extra)))
    return settings.replace(**{f"lqr_position_{joint.unit}": position, f"lqr_velocity_{joint.unit}_s": velocity})


def _shortfalls(points: Sequence[OperatingPoint], candidates: Sequence[SampledLaw], wanted: Requirements) -> np.ndarray:
    """Return the relative shortfall of each candidate (n,), the largest over the points, from approximate margins.

    At a point it is the sum over the joints' loops of each one's largest shortfall.
    """
    total, timing = np.zeros(len(candidates)), candidates[0].timing
    for point in points:
        gains, known = [], np.ones(len(candidates), dtype=bool)
        for i, one in enumerate(candidates):
            try:
                gains.append(law_gain(point, one.name, one.settings, one.effort_limit))
            except LinkplanError:  # LQR without a solution
                gains.append(np.zeros((point.mechanism.n_u, 2 * point.mechanism.dof)))
                known[i] = False
        every = quick_loops(point, np.array(gains), timing, point.mechanism.channels)
        stable = known & (every[0].radius < 1.0)
        short = np.sum([np.maximum(0.0, shortfall(one, wanted, timing, _SEARCH_RESERVE)) for one in every], axis=0)
        total = np.maximum(total, np.where(stable, short, UNSTABLE_SHORTFALL * len(every) + every[0].radius))
    return total
