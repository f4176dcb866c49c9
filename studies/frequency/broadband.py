"""Multisine and chirp: every frequency at once, in a signal that repeats; estimated line by line over whole repetitions.

The multisine has odd lines only, with Schroeder's phases (IEEE Trans. Information Theory 16, 1970): what appears on its even
lines is distortion (Pintelon & Schoukens, System Identification, 2012, ch. 4). The chirp sweeps the band, then its negative.
"""

from collections.abc import Callable, Sequence

import numpy as np

from linkplan.models.errors import LinkplanError
from linkplan.studies.frequency.excitation import Measurement, Setup, quantities, refuse_long, signal_amplitude
from linkplan.studies.frequency.feedback_loops import FeedbackLoop, channel_effort
from linkplan.studies.frequency.simulated_loops import SimulatedLoops

# A repetition holds this many cycles of the lowest frequency asked for; lines are odd multiples of its own rate.
_CYCLES = 3
_FEWEST_LINES = 4
_MOST_REPETITIONS = 400


def run(
    loops: Sequence[FeedbackLoop],
    frequency_hz: np.ndarray,
    effort_limit: np.ndarray,
    setup: Setup,
    excitations: tuple[str, ...],
    channel: int,
    say: Callable[[str], None],
) -> Measurement:
    """Return a multisine's or chirp's measurement; see `measure.measure`. Frequencies move to the signal's lines."""
    timing, mechanism = loops[0].timing, loops[0].point.mechanism
    N, lines = signal_lines(frequency_hz, timing.period_s)
    frequency = lines / (N * timing.period_s)
    rows = [(loop, excitation) for loop in loops for excitation in excitations]
    # reference and push of every row, their spectra, and the windows kept
    refuse_long(float(N), float(frequency[0]), float(len(rows)), bytes_a_sample=8 * (8 * mechanism.dof + 16))
    signal, rate = (np.zeros((len(rows), N)) for _ in range(2))
    ahead = np.zeros((len(rows), N, mechanism.n_u))
    for row, (loop, excitation) in enumerate(rows):
        most = signal_amplitude(loop, frequency, excitation, effort_limit, setup, channel)
        spectrum = most.min() * _chirp(N, lines)
        if setup.method == "multisine":
            # Schroeder's phases for a flat spectrum; each line as large as its share of the motion allows.
            k = np.arange(len(lines))
            spectrum = np.zeros(N // 2 + 1, dtype=complex)
            spectrum[lines] = most / np.sqrt(len(lines)) * np.exp(-1j * np.pi * k * (k + 1) / len(lines))
        signal[row] = _wave(spectrum, N)
        omega = 2 * np.pi * np.arange(N // 2 + 1) / (N * timing.period_s)
        if excitation != "effort":
            rate[row] = _wave(1j * omega * spectrum, N)
        if excitation == "reference+ff":
            excited = np.flatnonzero(spectrum)
            need = np.zeros((N // 2 + 1, mechanism.n_u), dtype=complex)
            need[excited] = spectrum[excited, None] * loop.feedforward(omega[excited] / (2 * np.pi), channel)
            ahead[row] = np.stack([_wave(need[:, j], N) for j in range(mechanism.n_u)], axis=1)

    n, n_s = len(rows), mechanism.dof
    everyone = np.arange(n)
    state = np.array([loop.point.state for loop, _ in rows])
    hold = np.array([loop.point.hold for loop, _ in rows])
    read, pushes = (np.array(of) for of in zip(*[channel_effort(loop.point, channel) for loop, _ in rows], strict=True))
    effort = np.array([excitation == "effort" for _, excitation in rows])
    batch = SimulatedLoops(
        mechanism,
        pose=np.array([loop.point.pose for loop, _ in rows]),
        velocity=state[:, n_s:],
        gain=np.array([loop.gain for loop, _ in rows]),
        under_way=hold,
        timing=timing,
        effort_limit=effort_limit,
    )
    low, high = effort_limit.T
    tail = np.array([loop.radius**N / (1 - loop.radius**N) for loop, _ in rows])
    longest = max(setup.windows + 1, int(np.ceil(setup.longest_s / (N * timing.period_s))))
    kept: list[np.ndarray] = []
    settled, repetition, cut = 0, 0, np.zeros(n)
    while settled < setup.windows and repetition < min(longest, _MOST_REPETITIONS):
        rise = np.clip((np.arange(N) / N + repetition) / max(setup.ramp_cycles / _CYCLES, 1e-9), 0.0, 1.0)
        size = (0.5 - 0.5 * np.cos(np.pi * rise))[:, None]
        put_in = size * signal.T
        reference, push = np.repeat(state[None], N, axis=0), hold + size[:, :, None] * ahead.transpose(1, 0, 2)
        reference[:, ~effort, channel] += put_in[:, ~effort]
        reference[:, :, n_s + channel] += size * rate.T
        push += np.where(effort, put_in, 0.0)[:, :, None] * pushes
        x, commands = batch.run(everyone, reference, push)
        cut = np.any((commands < low) | (commands > high), axis=2).sum(axis=0)
        command = np.sum((commands - hold) * read, axis=2)
        log = np.stack([put_in, command, x[:, :, channel] - state[:, channel]], axis=2)
        say(f"{batch.periods} control periods, {repetition + 1} repetitions")
        kept = [*kept, np.fft.rfft(log, axis=0) * 2 / N][-setup.windows :]
        repetition += 1
        if len(kept) > 1:
            now, before = kept[-1][lines], kept[-2][lines]
            change = np.abs(now - before).max(axis=(0, 2)) / np.abs(now).max(axis=(0, 2)) * np.maximum(tail, 1.0)
            settled = settled + 1 if np.all(change <= setup.tolerance) else 0
    spectra = np.array(kept)  # (windows, bins, rows, 3)
    responses = [{} for _ in loops]
    for row, (_, excitation) in enumerate(rows):
        place = row // len(excitations)
        found = {name: spectra[:, lines, row, i] for i, name in enumerate(("in", "command", "position"))}
        quality = _quality(spectra[-1, :, row, 1:], lines) | {"saturated": np.full(len(lines), cut[row] / N)}
        origin = f"measured in MuJoCo, {setup.method}, {excitation}"
        responses[place] |= quantities(loops[place], channel, excitation, frequency, found, quality, origin)
    return Measurement(
        responses=tuple(responses), simulated_steps=batch.periods * n * timing.substeps, conditions=batch.conditions()
    )


def signal_lines(frequency_hz: np.ndarray, period_s: float) -> tuple[int, np.ndarray]:
    """Return samples N of a repetition and its odd lines (n,) next to frequencies [Hz].

    Raises:
        LinkplanError: for frequencies above the Nyquist frequency, not positive, or too few.
    """
    frequency = np.unique(np.asarray(frequency_hz, dtype=float))
    if not (frequency.size and np.all(np.isfinite(frequency)) and frequency[0] > 0):
        raise LinkplanError("frequencies are positive numbers of hertz")
    if frequency[-1] > 0.5 / period_s * (1 + 1e-9):
        raise LinkplanError(
            f"{frequency[-1]:.6g} Hz is above the Nyquist frequency, {0.5 / period_s:.6g} Hz at a control period of"
            f" {period_s:g} s"
        )
    refuse_long(_CYCLES / (frequency[0] * period_s), float(frequency[0]), 1.0)
    N = 4 * int(np.ceil(_CYCLES / (4 * frequency[0] * period_s)))
    lines = np.unique(2 * np.round((frequency * N * period_s - 1) / 2).astype(int) + 1)
    lines = lines[(lines >= 1) & (lines < N // 2)]
    if len(lines) < _FEWEST_LINES:
        raise LinkplanError(
            f"a signal of many frequencies needs {_FEWEST_LINES} of them below the Nyquist frequency, got {len(lines)}"
        )
    return N, lines


def _chirp(N: int, lines: np.ndarray) -> np.ndarray:
    """Return the spectrum (N/2 + 1,) of a chirp of unit size over the lines' band, then its negative: odd lines only."""
    t = np.arange(N // 2) / N
    half = np.cos(2 * np.pi * (lines[0] * t + (lines[-1] - lines[0]) * t**2))
    spectrum = np.fft.rfft(np.concatenate([half, -half])) * 2 / N
    spectrum[: lines[0]] = 0.0
    spectrum[lines[-1] + 1 :] = 0.0
    return spectrum


def _wave(spectrum: np.ndarray, N: int) -> np.ndarray:
    """Return the signal (N,) of a spectrum of phasors (N/2 + 1,)."""
    return np.fft.irfft(spectrum * N / 2, N)


def _quality(spectrum: np.ndarray, lines: np.ndarray) -> dict[str, np.ndarray]:
    """Return coherence, distortion and residual (n,) of signals' spectrum (bins, signals).

    Both signals leave the even bins empty: what is beside a line is distortion and noise.
    """
    power = np.abs(spectrum) ** 2
    beside = np.maximum(power[lines - 1] * (lines[:, None] > 1), power[np.minimum(lines + 1, len(power) - 1)])
    share = (beside / np.maximum(power[lines], 1e-300)).max(axis=1)
    return {"coherence": 1.0 / (1.0 + share), "distortion": np.sqrt(share), "residual": np.sqrt(share / (1 + share))}
