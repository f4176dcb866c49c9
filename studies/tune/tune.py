"""Gains from requirements: PD gains or LQR weights for a bandwidth and margins at the worst angle, or why there are none.

Every candidate is judged by the sampled loop in the simulator's steps, at every angle: stable, bandwidth of the
complementary sensitivity, phase margin, sensitivity peak. Candidates lie on a grid of natural frequency and damping ratio
about the wanted bandwidth, then on finer grids about the best, which has the least damping gain that meets what is wanted:
that gain is what makes noise of measured speeds.
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
from linkplan.studies.bode.bode import SCANNED
from linkplan.studies.bode.scan import Line, judge_of
from linkplan.studies.frequency.feedback_loops import LAW_NAMES, OperatingPoint, feedback_loop, law_gain, operating_point
from linkplan.studies.frequency.margins import Margins, margins
from linkplan.studies.frequency.quick import quick_margins
from linkplan.studies.frequency.stability_map import effort_map
from linkplan.studies.frequency.worst import local_minima

# Natural frequencies are sought within these factors of the wanted bandwidth, damping ratios between these.
_NATURAL = (0.08, 4.0)
_DAMPING = (0.15, 8.0)
# Points of the grid each way, and finer grids after the first; LQR solves a Riccati equation for every point and angle.
_GRID, _REFINED = {"pd": 17, "pd+ff": 17, "lqr": 9}, 3
# The search is on quick figures: it asks for this much more than is wanted.
_HAIR = 1.005
# A shortfall of unstable gains: more than any of stable ones.
_UNSTABLE = 10.0
# Rounds of gains and of the worst poses for them (two were the most that was needed), and the poses that join in each.
_ROUNDS, _WORST = 5, 3
# A worst pose within this share of the line of one that is shown is not shown beside it.
_APART = 1e-3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Wanted:
    """What a loop is to do at its worst angle: bandwidth [Hz] at least, phase margin [deg] at least, peak of |S| at most."""

    bandwidth_hz: float
    phase_margin_deg: float
    sensitivity_peak: float = np.inf

    def __post_init__(self) -> None:
        if not (np.isfinite(self.bandwidth_hz) and self.bandwidth_hz > 0):
            raise LinkplanError(f"the wanted bandwidth is a positive number of hertz, got {self.bandwidth_hz:g}")
        if not 0 <= self.phase_margin_deg < 180:
            raise LinkplanError(f"the wanted phase margin is from 0 to 180 degrees, got {self.phase_margin_deg:g}")
        if not self.sensitivity_peak > 1:
            raise LinkplanError(f"the sensitivity's peak is wanted above 1, got {self.sensitivity_peak:g}")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Judged:
    """One set of gains over all angles: margins at each, and the worst relative shortfall, zero where there is none."""

    settings: Tracking
    bounds: tuple[Margins, ...]
    misses: float

    def worst(self, name: str, largest: bool = False) -> tuple[float | None, int]:
        """Return the least (or largest) of a figure over the angles, and at which; None where none is known."""
        values = [getattr(m, name) for m in self.bounds]
        known = [(v, i) for i, v in enumerate(values) if v is not None]
        return (max(known) if largest else min(known)) if known else (None, 0)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Tuning:
    """The answer: `found` or the nearest miss, over points (n), and the sentence."""

    mechanism: Mechanism
    law: str
    wanted: Wanted
    timing: Sampling
    points: tuple[OperatingPoint, ...]
    best: Judged
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
    """Return gains that do what is wanted at every point, or the nearest miss and why.

    Along a line what is wanted is kept everywhere: the line's worst poses for the gains found join the points, and gains are
    sought again, until there is none that misses.

    Args:
        points: of one mechanism of a single freedom.
        line: what the points stand for; None where the poses themselves were asked for.
        wanted: at the worst of them.
        settings: period and delay; gains and weights are replaced.
        timing: of the same period and delay.
        effort_limit: (n_u, 2) [N.m or N].
        law: pd, pd+ff or lqr.
        say: hears about progress.

    Raises:
        LinkplanError: for a bandwidth beyond Nyquist, an unknown law, or a mechanism of more freedoms.
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
    for last in [*[False] * (_ROUNDS - 1), True]:
        settings_found = _search(points, wanted, settings, timing, effort_limit, law, say)
        judged = _judged(points, settings_found, wanted, timing, effort_limit, law)
        if line is None or judged.misses or last:
            break
        say("the worst of these gains over the whole line")
        missing = _missing(mechanism, line, settings_found, wanted, timing, effort_limit, law)
        if not missing:
            break
        points = sorted([*points, *missing], key=lambda point: float(point.state[0]))
    # What misses still after the last round counts, too.
    if line is not None and not judged.misses:
        worst = _worst(mechanism, line, settings_found, wanted, timing, effort_limit, law)
        at = np.array([point.state[0] for point in points])
        apart = _APART * (line.high - line.low)
        worst = [point for point in worst if np.abs(at - point.state[0]).min() > apart][:1]
        points = sorted([*points, *worst], key=lambda point: float(point.state[0]))
        judged = _judged(points, settings_found, wanted, timing, effort_limit, law)
    found = judged.misses == 0.0
    return Tuning(
        mechanism=mechanism,
        law=law,
        wanted=wanted,
        timing=timing,
        points=tuple(points),
        best=judged,
        found=found,
        message=_message(points, wanted, timing, judged, law, found, line),
    )


def _search(points, wanted: Wanted, settings: Tracking, timing: Sampling, effort_limit, law: str, say) -> Tracking:
    """Return the best gains of a grid, refined about its best."""
    centre = np.log([np.sqrt(_NATURAL[0] * _NATURAL[1]), np.sqrt(_DAMPING[0] * _DAMPING[1])])
    half = np.log([np.sqrt(_NATURAL[1] / _NATURAL[0]), np.sqrt(_DAMPING[1] / _DAMPING[0])])
    best: tuple[float, float, Tracking] | None = None
    for level in range(_REFINED + 1):
        say(f"gains, grid {level + 1} of {_REFINED + 1}" + ("" if best is None else f", misses by {best[0]:.3g}"))
        axis = np.linspace(-1.0, 1.0, _GRID[law])
        at = [(a, b) for a in centre[0] + half[0] * axis for b in centre[1] + half[1] * axis]
        candidates = [_settings(points, wanted, settings, law, float(np.exp(a)), float(np.exp(b))) for a, b in at]
        misses = _misses(points, candidates, wanted, timing, effort_limit, law)
        # A hair more than asked, so that the finer figures that are reported meet it too.
        ranked = min(range(len(at)), key=lambda i: (misses[i], sum(at[i])))
        row = float(misses[ranked]), sum(at[ranked]), candidates[ranked]
        if best is None or row[:2] <= best[:2]:
            best, centre = row, np.array(at[ranked])
        half = half * 2.5 / _GRID[law]
    return best[2]


def _shortfall(found: Margins | None, wanted: Wanted, timing: Sampling) -> float:
    """Return how far margins are from what is wanted, relative, below zero where there is more; infinite if unstable."""
    if found is None or not found.stable:
        return np.inf
    band = found.bandwidth_hz or timing.nyquist_hz
    short = [float(np.log(wanted.bandwidth_hz / band)), found.sensitivity_peak / wanted.sensitivity_peak - 1.0]
    if wanted.phase_margin_deg and found.phase_margin_deg is not None:
        short.append(1.0 - found.phase_margin_deg / wanted.phase_margin_deg)
    return max(short)


def _worst(mechanism, line: Line, settings: Tracking, wanted: Wanted, timing: Sampling, effort_limit, law: str):
    """Return the points of a line where gains fall shortest of what is wanted: every local worst of it, refined."""
    judge, known = judge_of(mechanism, settings, effort_limit, timing, law, [0]), {}

    def enough(x: float) -> float:
        """Return by how much the wanted is exceeded, far below zero where unstable, infinite where nothing is held."""
        if x not in known:
            found = judge(line.at(x))
            short = np.inf if found is None else _shortfall(found[0], wanted, timing)
            known[x] = np.inf if found is None else -min(short, _UNSTABLE + (found[0].spectral_radius or 0.0))
        return known[x]

    even = np.linspace(line.low, line.high, SCANNED)
    places = sorted([*even, *local_minima(enough, even)], key=enough)[:_WORST]
    return [operating_point(mechanism, line.at(float(x)), effort_limit) for x in places if np.isfinite(enough(x))]


def _missing(mechanism, line: Line, settings: Tracking, wanted: Wanted, timing: Sampling, effort_limit, law: str):
    """Return the worst points of a line at which gains miss what is wanted."""
    worst = _worst(mechanism, line, settings, wanted, timing, effort_limit, law)
    return [point for point in worst if _judged([point], settings, wanted, timing, effort_limit, law).misses]


def _settings(points, wanted: Wanted, settings: Tracking, law: str, natural: float, damping: float) -> Tracking:
    """Return gains for a natural frequency (in wanted bandwidths) and damping ratio on the mean inertia, or LQR weights."""
    omega = 2 * np.pi * wanted.bandwidth_hz * natural
    inertia = float(np.exp(np.mean([np.log(point.inertia[0, 0]) for point in points])))
    kp, kd = inertia * omega**2, 2 * damping * inertia * omega
    if law != "lqr":
        return replace(settings, kp=kp, kd=kd)
    # The stationary LQR of a double integrator has kp = u / s_w and kd^2 = 2 J kp + (u / v_w)^2: weights for these gains.
    limit = _effort_weight(points)
    extra = max(kd**2 - 2 * inertia * kp, (1e-4 * kd) ** 2)
    hinge = points[0].mechanism.independent_joints[0].kind == "hinge"
    ends = np.radians(LQR_ERRORS) if hinge else LQR_ERRORS  # those are of degrees
    position, velocity = (float(np.clip(value, *ends)) for value in (limit / kp, limit / np.sqrt(extra)))
    if hinge:
        return replace(settings, lqr_position=position, lqr_velocity=velocity)
    return replace(settings, lqr_position_m=position, lqr_velocity_m_s=velocity)


def _effort_weight(points: Sequence[OperatingPoint]) -> float:
    """Return the joint's effort that weighs one in LQR: the actuator's limit through the transmission."""
    actuator = points[0].mechanism.actuators[0]
    limit = max(abs(actuator.lower), abs(actuator.upper))
    limit = limit if np.isfinite(limit) else max(1.0, max(float(np.abs(point.hold[0])) for point in points))
    return limit / abs(float(effort_map(points[0])[0, 0]))


def _loop(point: OperatingPoint, settings: Tracking, timing: Sampling, effort_limit: np.ndarray, law: str):
    return feedback_loop(point, law_gain(point, law, settings, effort_limit), timing)


def _misses(points, candidates: list[Tracking], wanted: Wanted, timing: Sampling, effort_limit, law: str) -> np.ndarray:
    """Return how far gains (n,) are from what is wanted: the worst relative shortfall, more than any where unstable."""
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
        short = np.maximum(0.0, np.log(wanted.bandwidth_hz * _HAIR / band))
        if wanted.phase_margin_deg:
            short = np.maximum(short, 1.0 - quick.phase_margin_deg / (wanted.phase_margin_deg * _HAIR))
        short = np.maximum(short, quick.sensitivity_peak * _HAIR / wanted.sensitivity_peak - 1.0)
        total = np.maximum(total, np.where(stable, short, 10.0 + quick.radius))
    return total


def _judged(points, settings: Tracking, wanted: Wanted, timing: Sampling, effort_limit, law: str) -> Judged:
    """Return gains with their margins, and the worst relative shortfall."""
    bounds, misses = [], 0.0
    for point in points:
        try:
            found = margins(_loop(point, settings, timing, effort_limit, law))
        except LinkplanError:
            found = Margins(stable=False)
        bounds.append(found)
        misses = max(misses, min(_shortfall(found, wanted, timing), _UNSTABLE))
    return Judged(settings=settings, bounds=tuple(bounds), misses=float(misses))


def _message(points, wanted: Wanted, timing: Sampling, best: Judged, law: str, found: bool, line: Line | None) -> str:
    asked = f"{wanted.bandwidth_hz:g} Hz and {wanted.phase_margin_deg:g} deg"
    if np.isfinite(wanted.sensitivity_peak):
        asked += f" with |S| up to {wanted.sensitivity_peak:g}"
    title, everywhere = (
        LAW_NAMES[law],
        f"all {len(points)} angles" if len(points) > 1 else "the angle",
    )
    if line is not None:
        everywhere = f"every angle from {line.said(line.low, 4)} to {line.said(line.high, 4)} {line.unit}"
    sampled = f"sampled every {timing.period_s:g} s"
    if timing.delay_steps:
        sampled += f" with {timing.delay_s:g} s of delay"
    band, at_band = best.worst("bandwidth_hz")
    phase, at_phase = best.worst("phase_margin_deg")
    if found:
        reached = [] if band is None else [f"bandwidth {band:.4g} Hz at the least ({points[at_band].name})"]
        reached += [] if phase is None else [f"phase margin {phase:.4g} deg at the least ({points[at_phase].name})"]
        return f"{title} gives {asked} at {everywhere}, {sampled}: {', '.join(reached)}"
    unstable = [point.name for point, m in zip(points, best.bounds, strict=True) if not m.stable]
    if unstable:
        why = f"no gains near that bandwidth are even stable at {unstable[0]}"
    else:
        lacking = []
        if band is not None and band < wanted.bandwidth_hz:
            lacking.append(f"a bandwidth of {band:.4g} Hz at {points[at_band].name}")
        if phase is not None and phase < wanted.phase_margin_deg:
            lacking.append(f"a phase margin of {phase:.4g} deg at {points[at_phase].name}")
        peak, at_peak = best.worst("sensitivity_peak", largest=True)
        if peak is not None and peak > wanted.sensitivity_peak:
            lacking.append(f"a peak of |S| of {peak:.4g} at {points[at_peak].name}")
        why = f"the nearest has {' and '.join(lacking)}"
    # A hold of T and a delay cost so much phase at the wanted bandwidth, whatever the gains.
    cost = 360.0 * wanted.bandwidth_hz * (0.5 * timing.period_s + timing.delay_s)
    cannot = f"{title} cannot give {asked} at {everywhere}, {sampled}"
    return f"{cannot}: {why}; hold and delay alone cost {cost:.3g} deg at {wanted.bandwidth_hz:g} Hz"
