"""Robustness of a feedback loop: gain, phase, delay and disk margins, bandwidth, resonance, sensitivity peak.

Crossings and peaks are bracketed on a grid up to and including the Nyquist frequency, where a sampled PD loop of small
inertia loses its gain margin, and refined on the loop itself. The disk margin is 1 / max |S - 1/2|: gain and phase may
change at once within its disk (Seiler, Packard & Gahinet, An Introduction to Disk Margins, IEEE Control Systems 40, 2020).
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import scipy.optimize

from linkplan.controllers.sampling import MOST_DELAY_PERIODS
from linkplan.studies.frequency.feedback_loops import CONTINUOUS, SIMULATED, FeedbackLoop, feedback_loop
from linkplan.studies.frequency.worst import local_minima

# Points of the grid per decade: crossings closer together than this are one, and so are peaks, which are refined between.
_PER_DECADE = 200
_LOWEST_HZ = 0.01
# Crossings are refined to this share of their frequency.
_CROSSING = 1e-10
# An imaginary part below this share of a gain is rounding.
_ROUNDING = 1e-10
# Crossings in the lowest part of the grid are the double integrator's own -180 deg, reached as the frequency vanishes.
_DC_HZ = 0.02
# A delay border is found to this share of itself, by simulator steps that fine; up to this many periods of delay, beyond
# which hold and steps do not matter and the phase margin says the same.
_DELAY_SHARE = 0.01
_MOST_EXACT_PERIODS = 40
_FINEST_STEPS = 200
# Peaks on the grid above this share of the largest are refined: a narrow one is met at half its height or more.
_REFINED = 0.5
# A static gain below this is none.
_NOTHING = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Margins:
    """Margins of one feedback loop; None where a figure has no meaning (infinite, or the loop is unstable).

    Where the open loop's gain is one at several frequencies, `crossover_hz` is that of them at which the phase margin is
    least, the one that is stated, and `other_crossovers_hz` are the others, rising.
    A sampled loop's delay margin is that of its poles in simulator steps as fine as a hundredth of it, see `delay_margin`: a
    loop simulated in one step a period is a little quicker than the same loop in finer ones, by up to half a period.
    """

    stable: bool
    gain_margin_db: float | None = None
    gain_reduction_margin_db: float | None = None
    phase_margin_deg: float | None = None
    delay_margin_s: float | None = None
    disk_margin: float | None = None
    disk_gain_margin_db: float | None = None
    disk_phase_margin_deg: float | None = None
    crossover_hz: float | None = None
    other_crossovers_hz: tuple[float, ...] = ()
    bandwidth_hz: float | None = None
    resonance_db: float | None = None  # the complementary sensitivity's peak over its value at rest
    resonance_hz: float | None = None
    sensitivity_peak: float | None = None
    sensitivity_peak_hz: float | None = None
    spectral_radius: float | None = None  # of the sampled closed loop; below one is stable

    def record(self) -> dict:
        """Return the figures by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def frequency_grid(period_s: float) -> np.ndarray:
    """Return frequencies [Hz] from a hundredth of a hertz to the Nyquist frequency, both included."""
    nyquist = 0.5 / period_s
    lowest = min(_LOWEST_HZ, 1e-3 * nyquist)
    return np.geomspace(lowest, nyquist, max(200, int(_PER_DECADE * np.log10(nyquist / lowest))))


def margins(loop: FeedbackLoop, channel: int = 0, *, refine: bool = True) -> Margins:
    """Return the margins of the loop at one joint's actuator, the others closed; `refine` the delay margin by poles."""
    radius = loop.radius
    if not loop.stable:
        return Margins(stable=False, spectral_radius=radius)
    found = _bounds(loop, channel, radius)
    classical = found.delay_margin_s
    if not refine or loop.kind == CONTINUOUS or classical is None:
        return found
    return replace(found, delay_margin_s=delay_margin(loop, classical)[0])


def delay_margin(loop: FeedbackLoop, guess_s: float) -> tuple[float, int]:
    """Return the further delay [s] at which a stable sampled loop loses its stability, and the steps a period it is cut in.

    The period is cut into simulator steps of about a hundredth of the margin, and the border sought among whole steps of
    delay by the closed loop's poles: MuJoCo run in those steps is stable just below and not just above. `guess_s`, the phase
    margin over the crossing's frequency, is returned where it is many periods long, for there the two agree.
    """
    timing = loop.timing
    fine = int(np.clip(np.ceil(timing.period_s / (_DELAY_SHARE * guess_s)), 1, _FINEST_STEPS))
    substeps = timing.substeps * int(np.ceil(fine / timing.substeps))
    begin = timing.delay_steps * substeps // timing.substeps
    if guess_s + timing.delay_s > min(_MOST_EXACT_PERIODS, 0.5 * MOST_DELAY_PERIODS) * timing.period_s:
        return guess_s, timing.substeps
    finer = replace(timing, substeps=substeps, delay_steps=begin)

    def radius(steps: int) -> float:
        return float(feedback_loop(loop.point, loop.gain, finer.delayed(steps), SIMULATED).radius or 0.0)

    if radius(begin) >= 1.0:  # stable in coarse steps only
        return 0.0, substeps
    low, high = begin, begin + max(1, int(np.ceil(1.5 * guess_s / finer.timestep_s)))
    while radius(high) < 1.0:
        low, high = high, begin + 2 * (high - begin)
        if high > MOST_DELAY_PERIODS * substeps // 2:
            return guess_s, timing.substeps
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if radius(middle) < 1.0 else (low, middle)
    ends = radius(low), radius(high)
    share = (1.0 - ends[0]) / (ends[1] - ends[0]) if ends[0] < 1.0 <= ends[1] and ends[1] > ends[0] else 0.0
    return (low - begin + share) * finer.timestep_s, substeps


def _bounds(loop: FeedbackLoop, channel: int, radius: float | None) -> Margins:
    """Return the margins of a stable loop from its response."""
    frequency = frequency_grid(loop.timing.period_s)
    gain = loop.gains("loop", frequency, channel)
    sensitivity = 1.0 / (1.0 + gain)

    def at(f: float) -> complex:
        return complex(loop.gains("loop", np.array([f]), channel)[0])

    crossover = _roots(np.log(np.abs(gain)), frequency, lambda f: np.log(abs(at(f))))
    there = np.array([at(f) for f in crossover])
    pm = np.angle(-there)
    nearest = int(np.argmin(np.abs(pm))) if pm.size else 0
    # A loop without damping or delay is real but for rounding, and turns nowhere.
    rounding = _ROUNDING * np.abs(gain)
    turned = _roots(np.where(gain.real < 0, gain.imag, np.nan), frequency, lambda f: at(f).imag, rounding)
    gm = np.array([-1.0 / at(f).real for f in turned if f > max(_DC_HZ, 2 * frequency[0])])
    # At the Nyquist frequency a sampled gain is real: a crossing that lies on the grid's last point and not inside it.
    if radius is not None and gain[-1].real < 0:
        gm = np.append(gm, 1.0 / abs(gain[-1].real))
    raised, lowered = gm[gm > 1], gm[(gm < 1) & (gm > 0)]
    delays = np.mod(pm, 2 * np.pi) / (2 * np.pi * crossover)
    complementary = 1.0 - sensitivity
    alpha = 1.0 / _peak(frequency, np.abs(sensitivity - 0.5), lambda f: abs(1.0 / (1.0 + at(f)) - 0.5))[1]
    peak_hz, peak = _peak(frequency, np.abs(sensitivity), lambda f: abs(1.0 / (1.0 + at(f))))
    resonance_hz, resonance = _peak(frequency, np.abs(complementary), lambda f: abs(1.0 - 1.0 / (1.0 + at(f))))
    return Margins(
        stable=True,
        gain_margin_db=_finite(20 * np.log10(raised.min())) if raised.size else None,
        gain_reduction_margin_db=_finite(-20 * np.log10(lowered.max())) if lowered.size else None,
        phase_margin_deg=_finite(np.degrees(pm[nearest])) if pm.size else None,
        delay_margin_s=_finite(delays.min()) if delays.size else None,
        disk_margin=float(alpha),
        disk_gain_margin_db=_finite(20 * np.log10((2 + alpha) / (2 - alpha))) if alpha < 2 else None,
        disk_phase_margin_deg=float(np.degrees(2 * np.arctan(alpha / 2))),
        crossover_hz=_finite(crossover[nearest]) if crossover.size else None,
        other_crossovers_hz=tuple(float(f) for f in np.delete(crossover, nearest)) if crossover.size else (),
        bandwidth_hz=bandwidth(complementary, frequency),
        resonance_db=_over(resonance, complementary[0]),
        resonance_hz=resonance_hz,
        sensitivity_peak=peak,
        sensitivity_peak_hz=peak_hz,
        spectral_radius=radius,
    )


def _roots(
    values: np.ndarray, frequency: np.ndarray, function: Callable[[float], float], rounding: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return the frequencies (n,) [Hz] at which a function crosses zero, bracketed by its values on a grid.

    Values within `rounding` of zero on either side are no crossing.
    """
    with np.errstate(invalid="ignore"):
        clear = np.abs(values) > rounding
        k = np.flatnonzero((values[:-1] * values[1:] < 0) & (clear[:-1] | clear[1:]))
    ends = [(frequency[i], frequency[i + 1]) for i in k]
    return np.array([scipy.optimize.brentq(function, low, high, rtol=_CROSSING) for low, high in ends])


def _peak(frequency: np.ndarray, values: np.ndarray, function: Callable[[float], float]) -> tuple[float, float]:
    """Return the frequency [Hz] of a function's largest value and the value, refined about its peaks (n,) on a grid."""
    high = values > _REFINED * values.max()
    places = local_minima(lambda x: -function(float(np.exp(x))), np.log(frequency), np.where(high, -values, np.inf))
    k = int(np.argmax(values))
    peaks = [(float(values[k]), float(frequency[k])), *((function(float(f)), float(f)) for f in np.exp(places))]
    value, at = max(peaks)
    return at, value


def _over(value: complex, other: complex) -> float | None:
    """Return a gain over another [dB]; None over nothing."""
    return float(20 * np.log10(abs(value) / abs(other))) if abs(other) > _NOTHING and value else None


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def bandwidth(closed: np.ndarray, frequency_hz: np.ndarray) -> float | None:
    """Return the first frequency [Hz] at which a response falls 3 dB below its first value; None if it does not."""
    drop = 20 * np.log10(np.abs(closed) / np.abs(closed[0])) + 3.0
    below = np.flatnonzero(drop < 0)
    if below.size == 0:
        return None
    k = below[0]
    share = drop[k - 1] / (drop[k - 1] - drop[k])
    return float(np.exp((1 - share) * np.log(frequency_hz[k - 1]) + share * np.log(frequency_hz[k])))
