"""Gains from requirements: PD gains or LQR weights for a bandwidth and margins at the worst pose.

Every candidate is evaluated at every pose with the sampled loop in the simulator's steps: stability, bandwidth of the
complementary sensitivity (-3 dB), phase margin, sensitivity peak, settling time and damping ratio. Candidates lie on a grid
of natural frequency and damping ratio around the required bandwidth, then on finer grids around the best. Among those that
meet the requirements, the best has the smallest damping gain, because this gain amplifies the noise of measured velocities.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkplan.controllers.sampling import Sampling
from linkplan.controllers.trackers.names import LINEAR
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.keys.kinds import LQR_ERRORS
from linkplan.planner.planning import silent
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.bode.bode import SAME_POSE_SHARE, SCAN_POSITIONS
from linkplan.studies.bode.scan import Line, judge_of
from linkplan.studies.frequency.feedback_loops import LAW_NAMES, OperatingPoint, feedback_loop, law_gain, operating_point
from linkplan.studies.frequency.margins import Margins, margins
from linkplan.studies.frequency.quick import quick_margins
from linkplan.studies.frequency.stability_map import effort_map
from linkplan.studies.frequency.worst import local_minima

# By default an error settles within this many cycles of the bandwidth, and poles have at least this damping ratio.
SETTLING_CYCLES, LEAST_DAMPING_RATIO = 5.0, 0.4
# Search range of the natural frequency, in units of the required bandwidth, and of the damping ratio.
_NATURAL_FREQUENCY_RANGE = (0.08, 4.0)
_DAMPING_RATIO_RANGE = (0.15, 8.0)
# Grid points along each axis. LQR solves a Riccati equation for every candidate and pose.
_GRID_POINTS = {"pd": 17, "pd+ff": 17, "lqr": 9}
_GRID_LEVELS = 4
# The search uses approximate margins, so it requires this factor more than the user.
_SEARCH_RESERVE = 1.005
# The shortfall of unstable gains, larger than any shortfall of stable ones.
_UNSTABLE_SHORTFALL = 10.0
# Rounds of searching gains and adding the worst poses of a line (at most two were needed in practice).
_MAX_ROUNDS = 5


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Wanted:
    """The requirements at the worst pose.

    The least bandwidth [Hz] of the complementary sensitivity (-3 dB), the least phase margin [deg], the largest peak of |S|,
    the longest settling time [s] to 2 % of an error (None: `SETTLING_CYCLES` over the bandwidth), the least damping ratio.
    """

    bandwidth_hz: float
    phase_margin_deg: float
    sensitivity_peak: float = np.inf
    settling_s: float | None = None
    damping_ratio: float = LEAST_DAMPING_RATIO

    @property
    def longest_settling_s(self) -> float:
        """The longest settling time [s]."""
        return SETTLING_CYCLES / self.bandwidth_hz if self.settling_s is None else self.settling_s

    def __post_init__(self) -> None:
        if not (np.isfinite(self.bandwidth_hz) and self.bandwidth_hz > 0):
            raise LinkplanError(f"the wanted bandwidth is a positive number of hertz, got {self.bandwidth_hz:g}")
        if not 0 <= self.phase_margin_deg < 180:
            raise LinkplanError(f"the wanted phase margin is from 0 to 180 degrees, got {self.phase_margin_deg:g}")
        if not self.sensitivity_peak > 1:
            raise LinkplanError(f"the sensitivity's peak is wanted above 1, got {self.sensitivity_peak:g}")
        if self.settling_s is not None and not self.settling_s > 0:
            raise LinkplanError(f"the settling time is a positive number of seconds, got {self.settling_s:g}")
        if not 0 <= self.damping_ratio <= 1:
            raise LinkplanError(f"the damping ratio is from 0 to 1, got {self.damping_ratio:g}")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class EvaluatedGains:
    """One set of gains with its margins and stiffness at rest at every pose, and the largest relative shortfall or zero."""

    settings: Tracking
    bounds: tuple[Margins, ...]
    stiffness: tuple[float, ...]  # [N.m/rad or N/m], NaN where there is no gain
    shortfall: float

    def worst(self, name: str, largest: bool = False) -> tuple[float | None, int]:
        """Return the smallest (or largest) value of a figure over the poses and its index; None without a value."""
        values = [getattr(m, name) for m in self.bounds]
        known = [(v, i) for i, v in enumerate(values) if v is not None]
        return (max(known) if largest else min(known)) if known else (None, 0)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Tuning:
    """The best gains at all points, whether they meet the requirements (`found`), and the verdict as a sentence."""

    mechanism: Mechanism
    law: str
    wanted: Wanted
    timing: Sampling
    points: tuple[OperatingPoint, ...]
    best: EvaluatedGains
    found: bool
    message: str


def tune(
    points: Sequence[OperatingPoint],
    wanted: Wanted,
    settings: Tracking,
    timing: Sampling,
    effort_limit: np.ndarray,
    *,
    law: str = "pd",
    say: Callable[[str], None] = silent,
    line: Line | None = None,
) -> Tuning:
    """Return gains that meet the requirements at every point, or the closest gains and the reason.

    With a line, the requirements hold everywhere on it: the line's worst poses for the gains found are added to the points,
    and the search is repeated until no pose violates the requirements.

    Args:
        points: of one mechanism with one degree of freedom.
        line: the line that the points sample; None if the user gave the poses.
        wanted: the requirements at the worst point.
        settings: period and delay; gains and weights are replaced.
        timing: with the same period and delay.
        effort_limit: (n_u, 2) [N.m or N].
        law: pd, pd+ff or lqr.
        say: receives progress messages.

    Raises:
        LinkplanError: for a bandwidth above the Nyquist frequency, an unknown law, or several degrees of freedom.
    """
    mechanism = points[0].mechanism
    if law not in LINEAR:
        raise LinkplanError(f"unknown tracker '{law}'; trackers are {', '.join(LINEAR)}")
    if mechanism.dof != 1:
        raise LinkplanError(f"tune needs a mechanism of one degree of freedom; '{mechanism.name}' has {mechanism.dof}")
    if wanted.bandwidth_hz >= timing.nyquist_hz:
        raise LinkplanError(
            f"a bandwidth of {wanted.bandwidth_hz:g} Hz is above the Nyquist frequency, {timing.nyquist_hz:g} Hz at a"
            f" control period of {timing.period_s:g} s"
        )
    points = list(points)
    for last in [*[False] * (_MAX_ROUNDS - 1), True]:
        settings_found = _search(points, wanted, settings, timing, effort_limit, law, say)
        best = _evaluated(points, settings_found, wanted, timing, effort_limit, law)
        if line is None or best.shortfall or last:
            break
        say("the worst of these gains over the whole line")
        worst = _worst(mechanism, line, settings_found, wanted, timing, effort_limit, law)
        violated = [
            point for point in worst if _evaluated([point], settings_found, wanted, timing, effort_limit, law).shortfall
        ]
        if not violated:
            break
        points = sorted([*points, *violated], key=lambda point: float(point.state[0]))
    # Evaluate the line's worst pose too: it may still violate the requirements after the last round.
    if line is not None and not best.shortfall:
        worst = _worst(mechanism, line, settings_found, wanted, timing, effort_limit, law)
        at = np.array([point.state[0] for point in points])
        distance = SAME_POSE_SHARE * (line.high - line.low)
        worst = [point for point in worst if np.abs(at - point.state[0]).min() > distance][:1]
        points = sorted([*points, *worst], key=lambda point: float(point.state[0]))
        best = _evaluated(points, settings_found, wanted, timing, effort_limit, law)
    found = best.shortfall == 0.0
    return Tuning(
        mechanism=mechanism,
        law=law,
        wanted=wanted,
        timing=timing,
        points=tuple(points),
        best=best,
        found=found,
        message=_message(points, wanted, timing, best, law, found, line),
    )


def _search(points, wanted: Wanted, settings: Tracking, timing: Sampling, effort_limit, law: str, say) -> Tracking:
    """Return the best gains of a grid that is refined around its best point."""
    ends = np.log([_NATURAL_FREQUENCY_RANGE, _DAMPING_RATIO_RANGE])
    centre, half = ends.mean(axis=1), 0.5 * np.diff(ends, axis=1).ravel()
    best: tuple[float, float, Tracking] | None = None
    for level in range(_GRID_LEVELS):
        say(f"gains, grid {level + 1} of {_GRID_LEVELS}" + ("" if best is None else f", shortfall {best[0]:.3g}"))
        axis = np.linspace(-1.0, 1.0, _GRID_POINTS[law])
        at = [(a, b) for a in centre[0] + half[0] * axis for b in centre[1] + half[1] * axis]
        candidates = [_settings(points, wanted, settings, law, float(np.exp(a)), float(np.exp(b))) for a, b in at]
        shortfalls = _shortfalls(points, candidates, wanted, timing, effort_limit, law)
        # The damping gain increases with the product of natural frequency and damping ratio, the sum of their logarithms.
        ranked = min(range(len(at)), key=lambda i: (shortfalls[i], sum(at[i])))
        row = float(shortfalls[ranked]), sum(at[ranked]), candidates[ranked]
        if best is None or row[:2] <= best[:2]:
            best, centre = row, np.array(at[ranked])
        half = half * 2.5 / _GRID_POINTS[law]
    return best[2]


def _shortfall(found: Margins | None, wanted: Wanted, timing: Sampling) -> float:
    """Return the largest relative shortfall of margins: negative with a reserve, infinite if unstable."""
    if found is None or not found.stable:
        return np.inf
    band = found.bandwidth_hz or timing.nyquist_hz
    short = [float(np.log(wanted.bandwidth_hz / band)), found.sensitivity_peak / wanted.sensitivity_peak - 1.0]
    if wanted.phase_margin_deg and found.phase_margin_deg is not None:
        short.append(1.0 - found.phase_margin_deg / wanted.phase_margin_deg)
    short.append(float(np.log(found.settling_s / wanted.longest_settling_s)))
    short.append(wanted.damping_ratio - found.damping_ratio)
    return max(short)


def _worst(mechanism, line: Line, settings: Tracking, wanted: Wanted, timing: Sampling, effort_limit, law: str):
    """Return up to three points of a line with the largest shortfall, among its local maxima."""
    judge, known = judge_of(mechanism, settings, effort_limit, timing, law, [0]), {}

    def reserve(x: float) -> float:
        """Return the reserve, strongly negative if unstable, infinite if the pose cannot be held."""
        if x not in known:
            found = judge(line.at(x))
            short = np.inf if found is None else _shortfall(found[0], wanted, timing)
            known[x] = np.inf if found is None else -min(short, _UNSTABLE_SHORTFALL + (found[0].spectral_radius or 0.0))
        return known[x]

    even = np.linspace(line.low, line.high, SCAN_POSITIONS)
    places = sorted([*even, *local_minima(reserve, even)], key=reserve)[:3]
    return [operating_point(mechanism, line.at(float(x)), effort_limit) for x in places if np.isfinite(reserve(x))]


def _settings(points, wanted: Wanted, settings: Tracking, law: str, natural: float, damping: float) -> Tracking:
    """Return PD gains or LQR weights for a natural frequency (in required bandwidths), a damping ratio and mean inertia."""
    omega = 2 * np.pi * wanted.bandwidth_hz * natural
    inertia = float(np.exp(np.mean([np.log(point.inertia[0, 0]) for point in points])))
    kp, kd = inertia * omega**2, 2 * damping * inertia * omega
    if law != "lqr":
        return replace(settings, kp=kp, kd=kd)
    # LQR of a double integrator has kp = u / s_w and kd^2 = 2 J kp + (u / v_w)^2. Solve for the weights s_w and v_w.
    limit = _effort_weight(points)
    extra = max(kd**2 - 2 * inertia * kp, (1e-4 * kd) ** 2)
    joint = points[0].mechanism.independent_joints[0]
    position, velocity = (float(np.clip(joint.shown(x), *LQR_ERRORS)) for x in (limit / kp, limit / np.sqrt(extra)))
    return replace(settings, **{f"lqr_position_{joint.unit}": position, f"lqr_velocity_{joint.unit}_s": velocity})


def _effort_weight(points: Sequence[OperatingPoint]) -> float:
    """Return the joint effort with unit cost in LQR: the actuator's limit through the transmission."""
    actuator = points[0].mechanism.actuators[0]
    limit = max(abs(actuator.lower), abs(actuator.upper))
    limit = limit if np.isfinite(limit) else max(1.0, max(float(np.abs(point.hold[0])) for point in points))
    return limit / abs(float(effort_map(points[0])[0, 0]))


def _loop(point: OperatingPoint, settings: Tracking, timing: Sampling, effort_limit: np.ndarray, law: str):
    return feedback_loop(point, law_gain(point, law, settings, effort_limit), timing)


def _shortfalls(points, candidates: list[Tracking], wanted: Wanted, timing: Sampling, effort_limit, law: str) -> np.ndarray:
    """Return the largest relative shortfall of each candidate (n,) over the points, from approximate margins."""
    total = np.zeros(len(candidates))
    for point in points:
        gains, known = [], np.ones(len(candidates), dtype=bool)
        for i, candidate in enumerate(candidates):
            try:
                gains.append(law_gain(point, law, candidate, effort_limit))
            except LinkplanError:  # LQR without a solution
                gains.append(np.zeros((1, 2)))
                known[i] = False
        quick = quick_margins(point, np.array(gains), timing)
        stable = known & (quick.radius < 1.0)
        band = np.where(np.isfinite(quick.bandwidth_hz), quick.bandwidth_hz, timing.nyquist_hz)
        short = np.maximum(0.0, np.log(wanted.bandwidth_hz * _SEARCH_RESERVE / band))
        if wanted.phase_margin_deg:
            short = np.maximum(short, 1.0 - quick.phase_margin_deg / (wanted.phase_margin_deg * _SEARCH_RESERVE))
        short = np.maximum(short, quick.sensitivity_peak * _SEARCH_RESERVE / wanted.sensitivity_peak - 1.0)
        with np.errstate(invalid="ignore"):
            short = np.maximum(short, np.log(quick.settling_s * _SEARCH_RESERVE / wanted.longest_settling_s))
        short = np.maximum(short, wanted.damping_ratio * _SEARCH_RESERVE - quick.damping_ratio)
        total = np.maximum(total, np.where(stable, short, _UNSTABLE_SHORTFALL + quick.radius))
    return total


def _evaluated(points, settings: Tracking, wanted: Wanted, timing: Sampling, effort_limit, law: str) -> EvaluatedGains:
    """Return gains with their margins and the largest relative shortfall."""
    bounds, stiffness, shortfall = [], [], 0.0
    for point in points:
        try:
            loop = feedback_loop(point, law_gain(point, law, settings, effort_limit), timing)
            found, stiff = margins(loop), loop.stiffness_at_rest
        except LinkplanError:
            found, stiff = Margins(stable=False), np.nan
        bounds.append(found)
        stiffness.append(stiff)
        shortfall = max(shortfall, min(_shortfall(found, wanted, timing), _UNSTABLE_SHORTFALL))
    return EvaluatedGains(settings=settings, bounds=tuple(bounds), stiffness=tuple(stiffness), shortfall=float(shortfall))


def _message(
    points, wanted: Wanted, timing: Sampling, best: EvaluatedGains, law: str, found: bool, line: Line | None
) -> str:
    """Return the verdict as a sentence."""
    asked = f"{wanted.bandwidth_hz:g} Hz and {wanted.phase_margin_deg:g} deg"
    if np.isfinite(wanted.sensitivity_peak):
        asked += f" with |S| up to {wanted.sensitivity_peak:g}"
    everywhere = f"all {len(points)} angles" if len(points) > 1 else "the angle"
    if line is not None:
        everywhere = f"every angle from {line.said(line.low, 4)} to {line.said(line.high, 4)} {line.unit}"
    sampled = f"sampled every {timing.period_s:g} s"
    if timing.delay_steps:
        sampled += f" with {timing.delay_s:g} s of delay"
    if found:
        band, at_band = best.worst("bandwidth_hz")
        phase, at_phase = best.worst("phase_margin_deg")
        settling, at_settling = best.worst("settling_s", largest=True)
        softest = int(np.argmin(best.stiffness))
        joint = points[0].mechanism.independent_joints[0]
        unit = "N.m/rad" if joint.kind == "hinge" else "N/m"
        reached = [] if band is None else [f"bandwidth (-3 dB) {band:.4g} Hz at the least ({points[at_band].name})"]
        reached += [] if phase is None else [f"phase margin {phase:.4g} deg at the least ({points[at_phase].name})"]
        reached.append(f"an error settles to 2 % within {settling:.3g} s ({points[at_settling].name})")
        reached.append(f"stiffness at rest {best.stiffness[softest]:.4g} {unit} at the least ({points[softest].name})")
        return f"{LAW_NAMES[law]} gives {asked} at {everywhere}, {sampled}: {', '.join(reached)}"
    # The hold of one period and the delay cost this much phase at the required bandwidth with any gains.
    cost = 360.0 * wanted.bandwidth_hz * (0.5 * timing.period_s + timing.delay_s)
    cannot = f"{LAW_NAMES[law]} cannot give {asked} at {everywhere}, {sampled}"
    return (
        f"{cannot}: {_reason(points, wanted, best)}; hold and delay alone cost {cost:.3g} deg at {wanted.bandwidth_hz:g} Hz"
    )


def _reason(points, wanted: Wanted, best: EvaluatedGains) -> str:
    """Return the requirements that the best gains violate, as text."""
    unstable = [point.name for point, m in zip(points, best.bounds, strict=True) if not m.stable]
    if unstable:
        return f"no gains near that bandwidth are even stable at {unstable[0]}"
    violated = []
    for name, words, unit, limit in (
        ("bandwidth_hz", "a bandwidth of", " Hz", wanted.bandwidth_hz),
        ("phase_margin_deg", "a phase margin of", " deg", wanted.phase_margin_deg),
        ("sensitivity_peak", "a peak of |S| of", "", wanted.sensitivity_peak),
        ("settling_s", "a settling time of", " s", wanted.longest_settling_s),
        ("damping_ratio", "a damping ratio of", "", wanted.damping_ratio),
    ):
        is_bound_above = name in ("sensitivity_peak", "settling_s")
        value, index = best.worst(name, largest=is_bound_above)
        if value is not None and (value > limit if is_bound_above else value < limit):
            violated.append(f"{words} {value:.4g}{unit} at {points[index].name}")
    return f"the nearest has {' and '.join(violated)}"
