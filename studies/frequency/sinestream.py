"""The sinestream: one simulation for every frequency, ramped, settled by a criterion, estimated over whole cycles.

Over a window of N samples holding p whole cycles, the phasor of y is (2 / N) sum y_k exp(-2 pi i p k / N): exact for a
settled sine, whatever its mean and harmonics.
"""

from collections.abc import Callable, Sequence

import numpy as np

from linkplan.studies.frequency.excitation import (
    Measurement,
    Setup,
    quantities,
    refuse_long,
    signal_amplitude,
    whole_samples,
)
from linkplan.studies.frequency.feedback_loops import FeedbackLoop, channel_effort
from linkplan.studies.frequency.simulated_loops import SimulatedLoops

# Harmonics of the fundamental that count as distortion.
_HARMONICS = 5
_SIGNALS = 4
# A window has at least this many samples, of whole cycles: fewer say nothing of harmonics and noise.
_FEWEST_SAMPLES = 160
# Control periods between two looks at which simulations have settled; progress is told every so many looks.
_CHUNK = 256
_TELL = 20


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
    timing, mechanism = loops[0].timing, loops[0].point.mechanism
    cycles, samples = whole_samples(frequency_hz, timing.period_s)
    frequency = cycles / (samples * timing.period_s)
    each = float(np.maximum(samples, _FEWEST_SAMPLES).sum()) * len(loops) * len(excitations)
    refuse_long(float(samples.max()), float(frequency[0]), each / float(samples.max()))
    n_f = len(frequency)
    rows = [(loop, excitation) for loop in loops for excitation in excitations]
    n = len(rows) * n_f
    p, N = np.tile(cycles, len(rows)), np.tile(samples, len(rows))
    if amplitudes is None:
        amplitude = np.concatenate([signal_amplitude(loop, frequency, e, effort_limit, setup, channel) for loop, e in rows])
    else:
        amplitude = np.asarray(amplitudes, dtype=float).ravel()

    n_s, n_u = mechanism.dof, mechanism.n_u
    state = np.repeat([loop.point.state for loop, _ in rows], n_f, axis=0)
    hold = np.repeat([loop.point.hold for loop, _ in rows], n_f, axis=0)
    read, pushes = (
        np.repeat(of, n_f, axis=0) for of in zip(*[channel_effort(loop.point, channel) for loop, _ in rows], strict=True)
    )
    ahead = np.zeros((n, n_u), dtype=complex)
    for row, (loop, excitation) in enumerate(rows):
        if excitation == "reference+ff":
            ahead[row * n_f : (row + 1) * n_f] = loop.feedforward(frequency, channel)
    moves_effort = np.repeat([excitation == "effort" for _, excitation in rows], n_f)
    batch = SimulatedLoops(
        mechanism,
        pose=np.repeat([loop.point.pose for loop, _ in rows], n_f, axis=0),
        velocity=state[:, n_s:],
        gain=np.repeat([loop.gain for loop, _ in rows], n_f, axis=0),
        under_way=hold,
        timing=timing,
        effort_limit=effort_limit,
    )

    omega = 2 * np.pi * np.tile(frequency, len(rows))
    ramp = np.maximum(1, setup.ramp_cycles * -(-N // p))
    pole = np.repeat([loop.radius for loop, _ in rows], n_f)
    low, high = effort_limit.T
    estimates = [_Estimate(p=int(p[i]), N=int(N[i]), begin=int(ramp[i]), pole=float(pole[i]), setup=setup) for i in range(n)]
    overdue = int(np.ceil(setup.longest_s / timing.period_s))
    active, k, steps = np.arange(n), 0, 0
    while active.size:
        instants = np.arange(k, k + _CHUNK)[:, None]
        angle = 2 * np.pi * ((p[active] * instants) % N[active]) / N[active]
        rise = np.clip(instants / ramp[active], 0.0, 1.0)
        size = amplitude[active] * (0.5 - 0.5 * np.cos(np.pi * rise))
        slope = amplitude[active] * 0.5 * np.pi * np.sin(np.pi * rise) / (ramp[active] * timing.period_s)
        cosine, effort = np.cos(angle), moves_effort[active]
        put_in = size * cosine
        reference = np.repeat(state[None, active], _CHUNK, axis=0)
        reference[:, :, channel] += np.where(effort, 0.0, put_in)
        reference[:, :, n_s + channel] += np.where(effort, 0.0, slope * cosine - size * omega[active] * np.sin(angle))
        push = hold[active] + np.real((size * np.exp(1j * angle))[:, :, None] * ahead[active])
        push += np.where(effort, put_in, 0.0)[:, :, None] * pushes[active]
        x, commands = batch.run(active, reference, push)
        cut = np.any((commands < low) | (commands > high), axis=2)
        command = np.sum((commands - hold[active]) * read[active], axis=2)
        applied = np.sum((np.clip(commands, low, high) - hold[active]) * read[active], axis=2)
        position = x[:, :, channel] - state[active, channel]
        for r, i in enumerate(active):
            estimates[i].add(k, np.stack([put_in[:, r], command[:, r], position[:, r], applied[:, r]]), cut[:, r])
        k, steps = k + _CHUNK, steps + _CHUNK * len(active)
        active = np.array([i for i in active if not estimates[i].finished(k - ramp[i] >= overdue)], dtype=int)
        if k % (_TELL * _CHUNK) == 0 or not active.size:
            say(f"{k} control periods, {n - active.size} of {n} sinusoids settled")
    responses, actuated = [{} for _ in loops], [{} for _ in loops]
    phasors = np.array([estimate.phasors[-setup.windows :] for estimate in estimates])  # (n, windows, signals)
    columns = np.array([estimate.quality for estimate in estimates])
    for row, (_, excitation) in enumerate(rows):
        at, place = slice(row * n_f, (row + 1) * n_f), row // len(excitations)
        signals = {name: phasors[at, :, i].T for i, name in enumerate(("in", "command", "position"))}
        quality = dict(zip(("coherence", "distortion", "residual", "saturated"), columns[at].T, strict=True))
        origin = f"measured in MuJoCo, sinestream, {excitation}"
        responses[place] |= quantities(loops[place], channel, excitation, frequency, signals, quality, origin)
        actuated[place][excitation] = signals["command"][-1], phasors[at, -1, 3]
    return Measurement(
        responses=tuple(responses),
        simulated_steps=steps * timing.substeps,
        conditions=batch.conditions(),
        actuated=tuple(actuated),
    )


class _Estimate:
    """One simulation's phasors of (in, command, position, applied), window by window. Mutable."""

    def __init__(self, *, p: int, N: int, begin: int, pole: float, setup: Setup) -> None:
        self.window = N * -(-_FEWEST_SAMPLES // N)
        # Harmonics up to half the sampling rate: beyond it they fold back, onto the fundamental too.
        orders = np.array([h for h in range(1, _HARMONICS + 1) if h == 1 or 2 * h * p < N])
        self._waves = np.exp(-2j * np.pi / N * ((np.arange(self.window)[:, None] * p * orders) % N))
        self._begin, self._setup = begin, setup
        # What a change d between windows leaves to come, of a mode that shrinks by r = pole^window: d r / (1 - r).
        shrunk = pole**self.window
        self._tail = max(1.0, shrunk / (1.0 - shrunk))
        self.phasors: list[np.ndarray] = []
        self.quality = np.array([1.0, 0.0, 0.0, 0.0])
        self._calm = 0
        self._clear()

    def _clear(self) -> None:
        self._sums = np.zeros((_SIGNALS, self._waves.shape[1]), dtype=complex)
        self._power, self._mean, self._cut, self._filled = np.zeros(_SIGNALS), np.zeros(_SIGNALS), 0.0, 0

    def add(self, k: int, signals: np.ndarray, cut: np.ndarray) -> None:
        """Take samples of the signals (4, t) from instant k on; those of the ramp are passed over."""
        at = max(0, self._begin - k)
        # The waves' phase counts from instant 0, and windows hold whole cycles: where one begins, so does the wave's index.
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
            to_come = float((np.abs(fundamental - self.phasors[-1]) / size).max()) * self._tail
            self._calm = self._calm + 1 if to_come <= self._setup.tolerance else 0
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
        """Return whether the last windows agree, or there is no more time and there are as many."""
        return self._calm >= self._setup.windows - 1 or (overdue and len(self.phasors) >= self._setup.windows)
