"""The sinestream: one simulation for each frequency. The sine is ramped up, and its phasors are estimated once settled.

Over a window of N samples with p whole cycles, the phasor of y is (2 / N) sum y_k exp(-2 pi i p k / N). It is exact for a
settled sine with any mean and harmonics.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.planner.search.planning import silent
from linkplan.studies.feedback.frequency.excitation import (
    EXCITATIONS,
    Measurement,
    Setup,
    quantities,
    refuse_long,
    signal_amplitude,
    whole_samples,
)
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop, channel_effort, outputs_of
from linkplan.studies.feedback.frequency.simulated_loops import Excitation, ExcitedLoops

# The harmonics up to this order count as distortion.
_DISTORTION_ORDER = 5
# Control periods of one estimation window: at least this many, so that harmonics and noise can be separated.
_MIN_WINDOW_PERIODS = 160
# Control periods between two checks of which simulations have settled.
_CHECK_PERIODS = 64
# Cycles of the smooth start.
_RAMP_CYCLES = 2
# An estimate has settled when its remaining change is below this share; it follows from two windows, of one or more whole
# cycles each, and the slowest predicted pole. Then this number of windows is averaged.
_SETTLED_CHANGE, _AVERAGED_WINDOWS = 1e-4, 3


def measure(
    loops: Sequence[FeedbackLoop],
    frequency_hz: np.ndarray,
    effort_limit: np.ndarray,
    setup: Setup | None = None,
    *,
    excitations: Sequence[str] = tuple(EXCITATIONS),
    channel: int = 0,
    say: Callable[[str], None] = silent,
    amplitudes: np.ndarray | None = None,
) -> Measurement:
    """Return the responses of stable sampled loops of one mechanism and one timing, measured about their operating points.

    Args:
        loops: their gains and points are simulated; their predictions scale the signals.
        frequency_hz: (n,), moved so that a period has whole samples.
        effort_limit: of the actuators (n_u, 2) [N.m or N].
        setup: the settings of the measurement.
        excitations: keys of EXCITATIONS.
        channel: index of the excited joint among the independent joints.
        say: receives progress messages.
        amplitudes: of the test signals (loops, excitations, n); default: by the setup.

    Raises:
        LinkplanError: for frequencies above the Nyquist frequency.
    """
    setup, timing, mechanism = setup or Setup(), loops[0].timing, loops[0].point.mechanism
    cycles, samples = whole_samples(frequency_hz, timing.period_s)
    frequency = cycles / (samples * timing.period_s)
    refuse_many(samples, frequency, len(loops) * len(excitations))
    rows, sizes, forward = [], [], np.zeros((len(loops) * len(excitations), len(frequency), mechanism.n_u), dtype=complex)
    for loop, excitation in itertools.product(loops, excitations):
        if excitation == "reference+ff":
            forward[len(rows)] = loop.feedforward(frequency, channel)
        sizes.append(signal_amplitude(loop, frequency, excitation, effort_limit, setup, channel))
        read, push = channel_effort(loop.point, channel)
        coordinate = None if excitation == "effort" else channel
        rows.append(Excitation(loop=loop, push=push if coordinate is None else 0.0 * push, read=read, coordinate=coordinate))
    seen = mechanism.independent[list(outputs_of(mechanism, channel))]
    excited = ExcitedLoops(rows, lambda poses, _: poses[:, seen], effort_limit, len(frequency))
    sizes = np.array(sizes) if amplitudes is None else amplitudes
    taken = settled_phasors(excited, cycles, samples, sizes, effort_limit, setup, say, forward=forward)
    responses, actuated = [{} for _ in loops], [{} for _ in loops]
    for row, (place, excitation) in enumerate(itertools.product(range(len(loops)), excitations)):
        signals = taken.phasors[row]
        responses[place] |= quantities(loops[place], channel, excitation, frequency, signals, taken.quality(row))
        actuated[place][excitation] = signals[-1, :, 1], signals[-1, :, 2]
    return Measurement(
        responses=tuple(responses),
        simulated_steps=taken.simulated_periods * timing.substeps,
        conditions=excited.simulations.conditions(),
        actuated=tuple(actuated),
    )


def refuse_many(samples: np.ndarray, frequency_hz: np.ndarray, n_rows: int) -> None:
    """Refuse windows (n,) of too many control periods, or too many windows, for rows of simulations of n frequencies."""
    total = float(np.maximum(samples, _MIN_WINDOW_PERIODS).sum()) * n_rows
    refuse_long(float(samples.max()), float(frequency_hz[0]), total / float(samples.max()))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SettledPhasors:
    """The phasors of all signals (rows, windows, frequencies, signals), and the control periods simulated.

    The signals are the test signal, the command, the applied effort and the outputs. `_columns` (rows, frequencies, 4) have
    their quality.
    """

    phasors: np.ndarray
    simulated_periods: int
    _columns: np.ndarray

    def quality(self, row: int) -> dict[str, np.ndarray]:
        """Return the coherence, distortion, residual and saturation (n,) of a row's signals."""
        return dict(zip(("coherence", "distortion", "residual", "saturated"), self._columns[row].T, strict=True))


def settled_phasors(
    excited: ExcitedLoops,
    cycles: np.ndarray,
    samples: np.ndarray,
    amplitudes: np.ndarray,
    effort_limit: np.ndarray,
    setup: Setup,
    say: Callable[[str], None],
    *,
    forward: np.ndarray | None = None,
    floors: np.ndarray | None = None,
) -> SettledPhasors:
    """Return the settled phasors of sinusoids, one simulation for each row and frequency.

    Args:
        excited: the simulations.
        cycles: of each sinusoid (n,), from `whole_samples`.
        samples: in these cycles (n,).
        amplitudes: (rows, n) of the test signals [rad, m, N.m or N].
        effort_limit: (n_u, 2) [N.m or N].
        setup: the settings of the measurement.
        say: receives progress messages.
        forward: phasors (rows, n, n_u) of feedforward efforts per unit of the test signal; default: none.
        floors: sizes (rows, n, signals) below which a signal need not settle and has no quality; default: none.
    """
    n_rows, n_f, n_u = len(excited.rows), len(samples), len(effort_limit)
    p, N = np.tile(cycles, n_rows), np.tile(samples, n_rows)
    sinusoids = _Sinusoids(
        p=p,
        N=N,
        amplitude=np.asarray(amplitudes, dtype=float).ravel(),
        ramp=np.maximum(1, _RAMP_CYCLES * -(-N // p)),
        forward=np.zeros((len(p), n_u)) if forward is None else forward.reshape(-1, n_u),
        period_s=excited.simulations.timing.period_s,
    )
    n_signals = 3 + excited.rest.shape[1]
    small = np.zeros((n_rows, n_f, n_signals)) if floors is None else floors
    estimates, periods = _simulate(excited, sinusoids, small.reshape(-1, n_signals), effort_limit, setup, say)
    phasors = np.array([estimate.phasors[-_AVERAGED_WINDOWS:] for estimate in estimates])  # (n, windows, signals)
    return SettledPhasors(
        phasors=phasors.reshape(n_rows, n_f, *phasors.shape[1:]).swapaxes(1, 2),
        simulated_periods=periods,
        _columns=np.array([estimate.quality for estimate in estimates]).reshape(n_rows, n_f, -1),
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
    excited: ExcitedLoops,
    sinusoids: _Sinusoids,
    floors: np.ndarray,
    effort_limit: np.ndarray,
    setup: Setup,
    say: Callable[[str], None],
) -> tuple[list["_Estimate"], int]:
    """Run every simulation until its estimate settles. Return the estimates (n,) and the control periods simulated."""
    n = len(sinusoids.p)
    pole = np.repeat(np.array([row.loop.radius for row in excited.rows], dtype=float), n // len(excited.rows))
    low, high = effort_limit.T
    estimates = [
        _Estimate(
            floor=floors[i],
            p=int(sinusoids.p[i]),
            N=int(sinusoids.N[i]),
            begin=int(sinusoids.ramp[i]),
            pole=float(pole[i]),
        )
        for i in range(n)
    ]
    longest = int(np.ceil(setup.longest_s / sinusoids.period_s))
    said_after = 1_000_000 // excited.simulations.timing.substeps  # steps take equal time, periods do not
    active, k, simulated_periods = np.arange(n), 0, 0
    while active.size:
        signal, rate, forward = sinusoids.sampled(np.arange(k, k + _CHECK_PERIODS)[:, None], active)
        command, positions, commands = excited.run(active, signal, rate, forward)
        cut = np.any((commands < low) | (commands > high), axis=2)
        applied = np.sum((np.clip(commands, low, high) - excited.hold[active]) * excited.read[active], axis=2)
        for r, i in enumerate(active):
            estimates[i].add(k, np.stack([signal[:, r], command[:, r], applied[:, r], *positions[:, r].T]), cut[:, r])
        k, before = k + _CHECK_PERIODS, simulated_periods
        simulated_periods += _CHECK_PERIODS * len(active)
        active = np.array([i for i in active if not estimates[i].finished(k - sinusoids.ramp[i] >= longest)], dtype=int)
        if simulated_periods // said_after > before // said_after or not active.size:
            say(f"{k} control periods, {n - active.size} of {n} sinusoids settled")
    return estimates, simulated_periods


class _Estimate:
    """One simulation's phasors of (in, command, applied, positions), window by window. Mutable."""

    def __init__(self, *, floor: np.ndarray, p: int, N: int, begin: int, pole: float) -> None:
        self._floor = np.maximum(floor, 1e-300)
        self.window = N * -(-_MIN_WINDOW_PERIODS // N)
        # Harmonics above half the sampling rate would alias, also onto the fundamental, so they are omitted.
        orders = np.array([h for h in range(1, _DISTORTION_ORDER + 1) if h == 1 or 2 * h * p < N])
        self._waves = np.exp(-2j * np.pi / N * ((np.arange(self.window)[:, None] * p * orders) % N))
        self._begin = begin
        # A mode that shrinks by r = pole^window and changed by d between two windows will still change by d r / (1 - r).
        r = pole**self.window
        self._tail = max(1.0, r / (1.0 - r))
        self.phasors: list[np.ndarray] = []
        self.quality = np.array([1.0, 0.0, 0.0, 0.0])
        self._settled_windows = 0
        self._clear()

    def _clear(self) -> None:
        n = len(self._floor)
        self._sums = np.zeros((n, self._waves.shape[1]), dtype=complex)
        self._power, self._mean, self._cut, self._filled = np.zeros(n), np.zeros(n), 0.0, 0

    def add(self, k: int, signals: np.ndarray, cut: np.ndarray) -> None:
        """Add samples of the signals (n_signals, t) that start at instant k. Samples of the ramp are skipped."""
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
            size = np.maximum(np.abs(fundamental), self._floor)
            remaining = float((np.abs(fundamental - self.phasors[-1]) / size).max()) * self._tail
            self._settled_windows = self._settled_windows + 1 if remaining <= _SETTLED_CHANGE else 0
        self.phasors.append(fundamental)
        power = np.maximum(self._power / N - (self._mean / N) ** 2, 1e-300)[1:]
        first = np.maximum(0.5 * np.abs(fundamental[1:]) ** 2, 1e-300)
        overtones = 0.5 * np.sum(np.abs(harmonics[1:, 1:]) ** 2, axis=1)
        rest = np.clip(power - first - overtones, 0.0, None)
        seen = ~(np.abs(fundamental[1:]) < self._floor[1:])  # a diverged simulation has no coherence
        self.quality = np.array(
            [
                np.clip(first / power, 0.0, 1.0).min(where=seen, initial=1.0),
                np.sqrt(overtones / first).max(where=seen, initial=0.0),
                np.sqrt(rest / power).max(where=seen, initial=0.0),
                self._cut / N,
            ]
        )
        self._clear()

    def finished(self, overdue: bool) -> bool:
        """Return True if the last windows agree, or if the time is over and there are enough windows."""
        return self._settled_windows >= _AVERAGED_WINDOWS - 1 or (overdue and len(self.phasors) >= _AVERAGED_WINDOWS)
