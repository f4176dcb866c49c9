"""Robustness of a feedback loop: gain, phase, delay and disk margins, bandwidth, resonance, sensitivity peak.

Crossings and peaks are bracketed on a frequency grid and then refined with the exact loop. The grid includes the Nyquist
frequency, where a sampled PD loop of small inertia loses its gain margin. The disk margin is 1 / max |S - 1/2| and covers
simultaneous changes of gain and phase (Seiler, Packard & Gahinet, An Introduction to Disk Margins, IEEE Control Systems 40,
2020).

About an operating point at rest, with gains K on the positions' errors, A of the accelerations by the positions and B by the
efforts, small steps r of the reference and steady efforts d on the coordinates move the mechanism until

    (B K - A) s = B K r + M^-1 d

so weight and springs (A) reduce or increase the stiffness of the gains.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from linkplan.controllers.sampling import MOST_DELAY_PERIODS
from linkplan.models.poses.sign_change import sign_change
from linkplan.studies.feedback.frequency.feedback_loops import (
    CONTINUOUS,
    FeedbackLoop,
    OperatingPoint,
    channel_effort,
    feedback_loop,
)
from linkplan.studies.feedback.frequency.worst import refined_minima

# Phase crossings below this frequency are ignored: a double integrator tends to -180 deg as the frequency tends to zero.
_LOWEST_PHASE_CROSSING_HZ = 0.02
# Relative accuracy of the delay margin: simulator steps are this share of it.
_DELAY_ACCURACY = 0.01
# Longest delay found from the poles [control periods]. Beyond it the phase margin gives the same result.
_MAX_POLE_DELAY_PERIODS = 40
_MAX_STEPS_PER_PERIOD = 200


class Margins(Struct, frozen=True, kw_only=True, eq=False):
    """Margins of one feedback loop. A figure is None if it is infinite or if the loop is unstable.

    If the open loop has several gain crossovers, `crossover_hz` is the one with the smallest phase margin;
    `other_crossovers_hz` are the others in ascending order. The delay margin of a sampled loop comes from its poles in fine
    simulator steps, see `delay_margin`. A loop simulated in one step per period has up to half a period less delay than the
    same loop in finer steps.
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
    bandwidth_hz: float | None = None  # 0 if the response at rest is already below -3 dB
    response_at_rest: float | None = None  # the joint's share of a small step of its reference: complementary sensitivity
    stiffness_at_rest: float | None = None  # steady effort on the joint divided by the error that it causes [N.m/rad or N/m]
    resonance_db: float | None = None  # the complementary sensitivity's peak over its value at rest
    resonance_hz: float | None = None
    sensitivity_peak: float | None = None
    sensitivity_peak_hz: float | None = None
    spectral_radius: float | None = None  # of the sampled closed loop; stable if below one
    settling_s: float | None = None  # to 2 % of an error, by the sampled closed loop's slowest pole
    damping_ratio: float | None = None  # the least damping ratio of its poles below half the Nyquist frequency


def frequency_grid(period_s: float) -> np.ndarray:
    """Return frequencies [Hz] from 0.01 Hz to the Nyquist frequency, both included, with 200 points per decade.

    Two crossings or peaks within one grid interval count as one.
    """
    nyquist = 0.5 / period_s
    lowest = min(0.01, 1e-3 * nyquist)
    return np.geomspace(lowest, nyquist, max(200, int(200 * np.log10(nyquist / lowest))))


def margins(loop: FeedbackLoop, channel: int = 0, *, refine: bool = True) -> Margins:
    """Return the margins of one joint's loop, with the other loops closed; `refine` computes the delay margin from poles."""
    radius = loop.radius
    if not loop.stable:
        return Margins(stable=False, spectral_radius=radius)
    found = _bounds(loop, channel, radius)
    if loop.kind != CONTINUOUS:
        poles, period = np.linalg.eigvals(loop.matrix), loop.timing.period_s
        found = replace(found, settling_s=float(settling_time_s(poles, period)), damping_ratio=float(damping_ratio(poles)))
    classical = found.delay_margin_s
    if not refine or loop.kind == CONTINUOUS or classical is None:
        return found
    return replace(found, delay_margin_s=delay_margin(loop, classical)[0])


def delay_margin(loop: FeedbackLoop, guess_s: float) -> tuple[float, int]:
    """Return the additional delay [s] at which a stable sampled loop becomes unstable, and the simulator steps per period.

    The period is divided into simulator steps of about a hundredth of the margin. The border is then bisected over whole
    steps of delay with the closed loop's poles: MuJoCo in those steps is stable just below the border and unstable just
    above. `guess_s` is the phase margin divided by the crossover frequency. It is returned if it is many periods long,
    because the two agree there.
    """
    timing = loop.timing
    fine = int(np.clip(np.ceil(timing.period_s / (_DELAY_ACCURACY * guess_s)), 1, _MAX_STEPS_PER_PERIOD))
    substeps = timing.substeps * int(np.ceil(fine / timing.substeps))
    begin = timing.delay_steps * substeps // timing.substeps
    if guess_s + timing.delay_s > min(_MAX_POLE_DELAY_PERIODS, 0.5 * MOST_DELAY_PERIODS) * timing.period_s:
        return guess_s, timing.substeps
    finer = dataclasses.replace(timing, substeps=substeps)

    def radius(steps: int) -> float:
        return float(feedback_loop(loop.point, loop.gain, dataclasses.replace(finer, delay_steps=steps)).radius or 0.0)

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
    """Return the margins of a stable loop from its frequency response."""
    frequency = frequency_grid(loop.timing.period_s)
    gain = loop.gains("loop", frequency, channel)
    sensitivity = 1.0 / (1.0 + gain)

    def at(f: float) -> complex:
        return complex(loop.gains("loop", np.array([f]), channel)[0])

    crossover = _roots(np.log(np.abs(gain)), frequency, lambda f: np.log(abs(at(f))))
    there = np.array([at(f) for f in crossover])
    pm = np.angle(-there)
    nearest = int(np.argmin(np.abs(pm))) if pm.size else 0
    # The gain of a loop without damping or delay is real up to rounding and has no phase crossing.
    rounding = 1e-10 * np.abs(gain)
    turned = _roots(np.where(gain.real < 0, gain.imag, np.nan), frequency, lambda f: at(f).imag, rounding)
    gm = np.array([-1.0 / at(f).real for f in turned if f > max(_LOWEST_PHASE_CROSSING_HZ, 2 * frequency[0])])
    # A sampled gain is real at the Nyquist frequency: this phase crossing lies on the grid's last point.
    if radius is not None and gain[-1].real < 0:
        gm = np.append(gm, 1.0 / abs(gain[-1].real))
    # If the gain at rest is finite and negative, a lower gain does not hold the weight. A double integrator's gain is
    # infinite.
    still = at(0.1 * frequency[0])
    if still.real < 0 and abs(still) < 2 * abs(gain[0]):
        gm = np.append(gm, 1.0 / abs(still))
    raised, lowered = gm[gm > 1], gm[(gm < 1) & (gm > 0)]
    delays = np.mod(pm, 2 * np.pi) / (2 * np.pi * crossover)
    complementary = 1.0 - sensitivity
    first = abs(complementary[0])
    response, stiffness = rest_response(loop.point, loop.gain[None], channel)
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
        response_at_rest=_finite(response[0]),
        stiffness_at_rest=_finite(stiffness[0]),
        resonance_db=float(20 * np.log10(max(1.0, resonance / first))) if first > 1e-9 and resonance else None,
        resonance_hz=resonance_hz,
        sensitivity_peak=peak,
        sensitivity_peak_hz=peak_hz,
        spectral_radius=radius,
    )


def _roots(
    values: np.ndarray, frequency: np.ndarray, function: Callable[[float], float], rounding: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return the frequencies (n,) [Hz] at which a function crosses zero, bracketed by its values on a grid.

    A sign change between two values within `rounding` of zero is ignored.
    """
    with np.errstate(invalid="ignore"):
        clear = np.abs(values) > rounding
        k = np.flatnonzero((values[:-1] * values[1:] < 0) & (clear[:-1] | clear[1:]))
    ends = [(frequency[i], frequency[i + 1]) for i in k]
    return np.array([sign_change(function, low, high, xtol=1e-10 * high) for low, high in ends])


def _peak(frequency: np.ndarray, values: np.ndarray, function: Callable[[float], float]) -> tuple[float, float]:
    """Return the frequency [Hz] of a function's largest value, and the value, refined from values (n,) on a grid."""
    high = values > 0.5 * values.max()  # the grid has a point at half the height or more of even a narrow peak
    places = refined_minima(lambda x: -function(float(np.exp(x))), np.log(frequency), np.where(high, -values, np.inf))
    k = int(np.argmax(values))
    peaks = [(float(values[k]), float(frequency[k])), *((function(float(f)), float(f)) for f in np.exp(places))]
    value, at = max(peaks)
    return at, value


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def bandwidth(closed: np.ndarray, frequency_hz: np.ndarray) -> float | None:
    """Return the first frequency [Hz] at which a closed loop's response is below -3 dB, 0 if it begins there, or None.

    It is relative to the reference, not to the response at rest, which weight can change.
    """
    drop = 20 * np.log10(np.abs(closed)) + 3.0
    below = np.flatnonzero(drop < 0)
    if below.size == 0:
        return None
    k = below[0]
    if k == 0:
        return 0.0
    share = drop[k - 1] / (drop[k - 1] - drop[k])
    return float(np.exp((1 - share) * np.log(frequency_hz[k - 1]) + share * np.log(frequency_hz[k])))


# A state has settled at this share of its first error.
SETTLED_SHARE = 0.02


def settling_time_s(poles: np.ndarray, period_s: float) -> np.ndarray:
    """Return the settling times (...,) [s] of loops with poles (..., M) per control period; infinite if unstable."""
    radius = np.abs(poles).max(axis=-1)
    with np.errstate(divide="ignore"):
        time = np.log(SETTLED_SHARE) * period_s / np.log(np.minimum(radius, 1.0))
    return np.where(radius < 1.0, time, np.inf)


def damping_ratio(poles: np.ndarray) -> np.ndarray:
    """Return the least damping ratios (...,) of loops with poles (..., M); 1 without oscillation, at most 0 if unstable."""
    with np.errstate(divide="ignore"):
        logarithm = np.log(np.asarray(poles, dtype=complex))
    with np.errstate(invalid="ignore"):
        ratio = -logarithm.real / np.abs(logarithm)
    slow = np.abs(logarithm.imag) <= 0.5 * np.pi
    return np.where(slow & np.isfinite(ratio), ratio, 1.0).min(axis=-1)


# A joint must settle this near to a small step of its reference, in spite of weight and springs.
LEAST_RESPONSE_AT_REST = 0.95


def rest_response(point: OperatingPoint, gains: np.ndarray, channel: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the response and the stiffness at rest (n,) of a coordinate's loop for gains (n, n_u, 2 n_s).

    The loops of the other coordinates are closed. The response is the complementary sensitivity at frequency zero: 0.95
    means that the joint settles at 95 % of a small step. The stiffness [N.m/rad or N/m] is a steady effort on the coordinate
    over the steady error that it causes, while the other coordinates are free to move. Both are meaningless for an
    unstable loop.
    """
    n_s, actuated = point.mechanism.dof, np.flatnonzero(point.mechanism.actuated).tolist()
    A, B = (matrix[n_s:][actuated] for matrix in point.linearised())
    A, K = A[:, actuated], gains[:, :, actuated]
    read, push = channel_effort(point, channel)
    i, inertia = actuated.index(channel), point.inertia[np.ix_(actuated, actuated)]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inverse = _inverses(B @ K - A)
        response = np.einsum("u,nus,ns->n", read, K, inverse @ (B @ push))
        stiffness = 1.0 / (inverse @ np.linalg.inv(inertia))[:, i, i]
    return response, stiffness


def passive_stiffness(point: OperatingPoint) -> np.ndarray:
    """Return the stiffness (n_s, n_s) [N.m/rad or N/m] that weight and springs give the coordinates about a point."""
    n_s = point.mechanism.dof
    return -point.inertia @ point.linearised()[0][n_s:, :n_s]


def _inverses(matrices: np.ndarray) -> np.ndarray:
    """Return the inverses of matrices (n, m, m), infinite for a singular one, with which nothing holds the mechanism."""
    regular = np.abs(np.linalg.det(matrices)) > 0.0
    found = np.full(matrices.shape, np.inf)
    found[regular] = np.linalg.inv(matrices[regular])
    return found
