"""The sinestream: one simulation for each frequency. The sine is ramped up, and its phasors are estimated once settled.

Over a window of N samples with p whole cycles, the phasor of y is (2 / N) sum y_k exp(-2 pi i p k / N). It is exact for a
settled sine with any mean and harmonics.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.studies.feedback.frequency.excitation import (
    Measurement,
    Setup,
    quantities,
    refuse_long,
    signal_amplitude,
    whole_samples,
)
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop
from linkplan.studies.feedback.frequency.simulated_loops import ExcitedLoops

# The harmonics up to this order count as distortion.
_DISTORTION_ORDER = 5
# Control periods of one estimation window: at least this many, so that harmonics and noise can be separated.
_MIN_WINDOW_PERIODS = 160
# Control periods between two checks of which simulations have settled.
_CHECK_PERIODS = 64


def run(
    loops: Sequence[FeedbackLoop],
    frequency_hz: np.ndarray,
    effort_limit: np.ndarray,
    setup: Setup,
    excitations: tuple[str, ...],
    channel: int,
    say: Callable[[str], None],
    amplitudes: np.ndarray | None = None,
) -> Measurement:
    """Return a sinestream's measurement; see `measure.measure`. `amplitudes` (loops, excitations, n) replace the setup's."""
    timing = loops[0].timing
    cycles, samples = whole_samples(frequency_hz, timing.period_s)
    frequency = cycles / (samples * timing.period_s)
    total = float(np.maximum(samples, _MIN_WINDOW_PERIODS).sum()) * len(loops) * len(excitations)
    refuse_long(float(samples.max()), float(frequency[0]), total / float(samples.max()))
    n_f = len(frequency)
    excited = ExcitedLoops(loops, excitations, channel, effort_limit, n_f)
    if amplitudes is None:
        amplitudes = np.array(
            [signal_amplitude(loop, frequency, name, effort_limit, setup, channel) for loop, name in excited.rows]
        )
    forward = np.zeros((len(excited.rows), n_f, len(effort_limit)), dtype=complex)
    for row, (loop, excitation) in enumerate(excited.rows):
        if excitation == "reference+ff":
            forward[row] = loop.feedforward(frequency, channel)
    p, N = np.tile(cycles, len(excited.rows)), np.tile(samples, len(excited.rows))
    sinusoids = _Sinusoids(
        p=p,
        N=N,
        amplitude=np.asarray(amplitudes, dtype=float).ravel(),
        ramp=np.maximum(1, setup.ramp_cycles * -(-N // p)),
        forward=forward.reshape(-1, len(effort_limit)),
        period_s=timing.period_s,
    )
    estimates, simulated_periods = _simulate(excited, sinusoids, effort_limit, setup, say)
    phasors = np.array([estimate.phasors[-setup.windows :] for estimate in estimates])  # (n, windows, signals)
    columns = np.array([estimate.quality for estimate in estimates])
    responses, actuated = [{} for _ in loops], [{} for _ in loops]
    for row, (_, excitation) in enumerate(excited.rows):
        at, place = slice(row * n_f, (row + 1) * n_f), row // len(excitations)
        signals = phasors[at].swapaxes(0, 1)
        names = ("coherence", "distortion", "residual", "saturated")
        quality: dict[str, np.ndarray] = dict(zip(names, columns[at].T, strict=True))
        responses[place] |= quantities(loops[place], channel, excitation, frequency, signals, quality)
        actuated[place][excitation] = signals[-1, :, 1], signals[-1, :, 3]
    return Measurement(
        responses=tuple(responses),
        simulated_steps=simulated_periods * timing.substeps,
        conditions=excited.simulations.conditions(),
        actuated=tuple(actuated),
    )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Sinusoids:
    """Test signals (n,): p cycles in N samples, with a smooth start of `ramp` samples.

    `amplitude` [rad, m, N.m or N]; `forward` (n, n_u): phasors of the feedforward efforts per unit of amplitude.
    """

    p: np.ndarray
    N: np.ndarray
    amplitude: np.ndarray
    ramp: np.ndarray
    forward: np.ndarray
    period_s: float

    def sampled(self, instants: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return signals (t, r), their derivatives [per second] and feedforward efforts (t, r, n_u) at instants (t, 1)."""
        p, N, amplitude, ramp = self.p[active], self.N[active], self.amplitude[active], self.ramp[active]
        angle = 2 * np.pi * ((p * instants) % N) / N
        rise = np.clip(instants / ramp, 0.0, 1.0)
        size = amplitude * (0.5 - 0.5 * np.cos(np.pi * rise))
        slope = amplitude * 0.5 * np.pi * np.sin(np.pi * rise) / (ramp * self.period_s)
        omega = 2 * np.pi * (p / (N * self.period_s))
        rate = slope * np.cos(angle) - size * omega * np.sin(angle)
        forward = np.real((size * np.exp(1j * angle))[:, :, None] * self.forward[active])
        return size * np.cos(angle), rate, forward


def _simulate(
    excited: ExcitedLoops, sinusoids: _Sinusoids, effort_limit: np.ndarray, setup: Setup, say: Callable[[str], None]
) -> tuple[list["_Estimate"], int]:
    """Run every simulation until its estimate settles. Return the estimates (n,) and the control periods simulated."""
    n = len(sinusoids.p)
    pole = np.repeat(np.array([loop.radius for loop, _ in excited.rows], dtype=float), n // len(excited.rows))
    low, high = effort_limit.T
    estimates = [
        _Estimate(
            p=int(sinusoids.p[i]), N=int(sinusoids.N[i]), begin=int(sinusoids.ramp[i]), pole=float(pole[i]), setup=setup
        )
        for i in range(n)
    ]
    longest = int(np.ceil(setup.longest_s / sinusoids.period_s))
    said_after = 1_000_000 // excited.simulations.timing.substeps  # simulator steps take alike, periods do not
    active, k, simulated_periods = np.arange(n), 0, 0
    while active.size:
        signal, rate, forward = sinusoids.sampled(np.arange(k, k + _CHECK_PERIODS)[:, None], active)
        command, position, commands = excited.run(active, signal, rate, forward)
        cut = np.any((commands < low) | (commands > high), axis=2)
        applied = np.sum((np.clip(commands, low, high) - excited.hold[active]) * excited.read[active], axis=2)
        for r, i in enumerate(active):
            estimates[i].add(k, np.stack([signal[:, r], command[:, r], position[:, r], applied[:, r]]), cut[:, r])
        k, before = k + _CHECK_PERIODS, simulated_periods
        simulated_periods += _CHECK_PERIODS * len(active)
        active = np.array([i for i in active if not estimates[i].finished(k - sinusoids.ramp[i] >= longest)], dtype=int)
        if simulated_periods // said_after > before // said_after or not active.size:
            say(f"{k} control periods, {n - active.size} of {n} sinusoids settled")
    return estimates, simulated_periods


class _Estimate:
    """One simulation's phasors of (in, command, position, applied), window by window. Mutable."""

    def __init__(self, *, p: int, N: int, begin: int, pole: float, setup: Setup) -> None:
        self.window = N * -(-_MIN_WINDOW_PERIODS // N)
        # Harmonics above half the sampling rate alias, also onto the fundamental: leave them out.
        orders = np.array([h for h in range(1, _DISTORTION_ORDER + 1) if h == 1 or 2 * h * p < N])
        self._waves = np.exp(-2j * np.pi / N * ((np.arange(self.window)[:, None] * p * orders) % N))
        self._begin, self._setup = begin, setup
        # A mode that shrinks by r = pole^window and changed by d between two windows will still change by d r / (1 - r).
        r = pole**self.window
        self._tail = max(1.0, r / (1.0 - r))
        self.phasors: list[np.ndarray] = []
        self.quality = np.array([1.0, 0.0, 0.0, 0.0])
        self._settled_windows = 0
        self._clear()

    def _clear(self) -> None:
        self._sums = np.zeros((4, self._waves.shape[1]), dtype=complex)
        self._power, self._mean, self._cut, self._filled = np.zeros(4), np.zeros(4), 0.0, 0

    def add(self, k: int, signals: np.ndarray, cut: np.ndarray) -> None:
        """Add samples of the four signals (4, t) that start at instant k. Samples of the ramp are skipped."""
        at = max(0, self._begin - k)
        # The phase counts from instant 0. A window holds whole cycles, so the wave table is periodic in the window.
        while at < signals.shape[1]:
            take = min(self.window - self._filled, signals.shape[1] - at)
            piece = signals[:, at : at + take]
            phase = (k + at) % self.window
            index = (phase + np.arange(take)) % self.window
            self._sums += piece @ self._waves[index]
            self._power += np.sum(piece**2, axis=1)
            self._mean += piece.sum(axis=1)
            self._cut += float(cut[at : at + take].sum())
            self._filled += take
            at += take
            if self._filled == self.window:
                self._close()

    def _close(self) -> None:
        N = self.window
        harmonics = 2.0 / N * self._sums
        fundamental = harmonics[:, 0]
        if self.phasors:
            size = np.maximum(np.abs(fundamental), 1e-300)
            remaining = float((np.abs(fundamental - self.phasors[-1]) / size).max()) * self._tail
            self._settled_windows = self._settled_windows + 1 if remaining <= self._setup.tolerance else 0
        self.phasors.append(fundamental)
        power = np.maximum(self._power / N - (self._mean / N) ** 2, 1e-300)[1:]
        first = np.maximum(0.5 * np.abs(fundamental[1:]) ** 2, 1e-300)
        overtones = 0.5 * np.sum(np.abs(harmonics[1:, 1:]) ** 2, axis=1)
        rest = np.clip(power - first - overtones, 0.0, None)
        self.quality = np.array(
            [
                np.clip(first / power, 0.0, 1.0).min(),
                np.sqrt(overtones / first).max(),
                np.sqrt(rest / power).max(),
                self._cut / N,
            ]
        )
        self._clear()

    def finished(self, overdue: bool) -> bool:
        """Return True if the last windows agree, or if the time is over and there are enough windows."""
        return self._settled_windows >= self._setup.windows - 1 or (overdue and len(self.phasors) >= self._setup.windows)
