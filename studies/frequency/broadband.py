"""Multisine and chirp: periodic signals with all frequencies at once, estimated line by line over whole repetitions.

The multisine has odd lines only, with Schroeder's phases (IEEE Trans. Information Theory 16, 1970). Everything that appears
on its even lines is distortion (Pintelon & Schoukens, System Identification, 2012, ch. 4). The chirp sweeps the band, then
repeats the sweep with the opposite sign.
"""

from collections.abc import Callable, Sequence

import numpy as np

from linkplan.models.errors import LinkplanError
from linkplan.studies.frequency.excitation import (
    Measurement,
    Setup,
    quantities,
    refuse_long,
    signal_amplitude,
)
from linkplan.studies.frequency.feedback_loops import FeedbackLoop, refuse_above_nyquist
from linkplan.studies.frequency.simulated_loops import ExcitedLoops

# A repetition holds this many cycles of the lowest frequency. The lines are odd multiples of the repetition rate.
_CYCLES_PER_REPETITION = 3
_MIN_LINES = 4


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
    # Bytes of a sample: reference and effort of every row, their spectra, and the stored windows.
    n = len(loops) * len(excitations)
    refuse_long(float(N), float(frequency[0]), float(n), bytes_a_sample=8 * (8 * mechanism.dof + 16))
    excited = ExcitedLoops(loops, excitations, channel, effort_limit)
    signal, rate, forward = (
        np.stack(values, axis=1)
        for values in zip(
            *(_signals(loop, name, N, lines, effort_limit, setup, channel) for loop, name in excited.rows), strict=True
        )
    )
    low, high = effort_limit.T
    tail = np.array([loop.radius**N / (1 - loop.radius**N) for loop, _ in excited.rows])
    longest = max(setup.windows + 1, int(np.ceil(setup.longest_s / (N * timing.period_s))))
    kept: list[np.ndarray] = []
    settled, repetition, cut = 0, 0, np.zeros(n)
    while settled < setup.windows and repetition < min(longest, 400):
        rise = np.clip((np.arange(N) / N + repetition) / max(setup.ramp_cycles / _CYCLES_PER_REPETITION, 1e-9), 0.0, 1.0)
        size = (0.5 - 0.5 * np.cos(np.pi * rise))[:, None]
        command, position, commands = excited.run(np.arange(n), size * signal, size * rate, size[:, :, None] * forward)
        cut = np.any((commands < low) | (commands > high), axis=2).sum(axis=0)
        log = np.stack([size * signal, command, position], axis=2)
        say(f"{excited.simulations.periods} control periods, {repetition + 1} repetitions")
        kept = [*kept, np.fft.rfft(log, axis=0) * 2 / N][-setup.windows :]
        repetition += 1
        if len(kept) > 1:
            now, before = kept[-1][lines], kept[-2][lines]
            change = np.abs(now - before).max(axis=(0, 2)) / np.abs(now).max(axis=(0, 2)) * np.maximum(tail, 1.0)
            settled = settled + 1 if np.all(change <= setup.tolerance) else 0
    spectra = np.array(kept)  # (windows, bins, rows, 3)
    responses = [{} for _ in loops]
    for row, (_, excitation) in enumerate(excited.rows):
        place = row // len(excitations)
        found = spectra[:, lines, row]
        quality = _quality(spectra[-1, :, row, 1:], lines) | {"saturated": np.full(len(lines), cut[row] / N)}
        responses[place] |= quantities(loops[place], channel, excitation, frequency, found, quality, setup.method)
    return Measurement(
        responses=tuple(responses),
        simulated_steps=excited.simulations.periods * n * timing.substeps,
        conditions=excited.simulations.conditions(),
    )


def _signals(
    loop: FeedbackLoop,
    excitation: str,
    N: int,
    lines: np.ndarray,
    effort_limit: np.ndarray,
    setup: Setup,
    channel: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a repetition of a test signal (N,), its derivative (N,) [per second] and its feedforward efforts (N, n_u)."""
    omega = 2 * np.pi * np.arange(N // 2 + 1) / (N * loop.timing.period_s)
    most = signal_amplitude(loop, omega[lines] / (2 * np.pi), excitation, effort_limit, setup, channel)
    if setup.method == "multisine":
        # Schroeder's phases for a flat spectrum. Each line has its share of the amplitude.
        k = np.arange(len(lines))
        spectrum = np.zeros(N // 2 + 1, dtype=complex)
        spectrum[lines] = most / np.sqrt(len(lines)) * np.exp(-1j * np.pi * k * (k + 1) / len(lines))
    else:
        spectrum = most.min() * _chirp(N, lines)
    need = np.zeros((N // 2 + 1, len(effort_limit)), dtype=complex)
    if excitation == "reference+ff":
        excited = np.flatnonzero(spectrum)
        need[excited] = spectrum[excited, None] * loop.feedforward(omega[excited] / (2 * np.pi), channel)
    return _wave(spectrum, N), _wave(1j * omega * spectrum, N), np.stack([_wave(column, N) for column in need.T], axis=1)


def signal_lines(frequency_hz: np.ndarray, period_s: float) -> tuple[int, np.ndarray]:
    """Return the samples N of a repetition and its odd lines (n,) closest to the frequencies [Hz].

    Raises:
        LinkplanError: for frequencies above the Nyquist frequency, not positive, or too few.
    """
    frequency = np.unique(np.asarray(frequency_hz, dtype=float))
    refuse_above_nyquist(frequency, period_s)
    refuse_long(_CYCLES_PER_REPETITION / (frequency[0] * period_s), float(frequency[0]), 1.0)
    N = 4 * int(np.ceil(_CYCLES_PER_REPETITION / (4 * frequency[0] * period_s)))
    lines = np.unique(2 * np.round((frequency * N * period_s - 1) / 2).astype(int) + 1)
    lines = lines[(lines >= 1) & (lines < N // 2)]
    if len(lines) < _MIN_LINES:
        raise LinkplanError(
            f"a signal of many frequencies needs {_MIN_LINES} of them below the Nyquist frequency, got {len(lines)}"
        )
    return N, lines


def _chirp(N: int, lines: np.ndarray) -> np.ndarray:
    """Return the spectrum (N/2 + 1,) of a unit chirp over the lines' band and its negative. It has odd lines only."""
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

    Both signals have empty even bins: power next to a line is distortion and noise.
    """
    power = np.abs(spectrum) ** 2
    adjacent = np.maximum(power[lines - 1] * (lines[:, None] > 1), power[np.minimum(lines + 1, len(power) - 1)])
    share = (adjacent / np.maximum(power[lines], 1e-300)).max(axis=1)
    return {"coherence": 1.0 / (1.0 + share), "distortion": np.sqrt(share), "residual": np.sqrt(share / (1 + share))}
