"""Data for figures of a loop's responses: the lowest frequency drawn, unwrapped phases, and |S| along a line."""

import numpy as np

from linkplan.studies.bode.bode import BodePoint, BodeStudy
from linkplan.studies.bode.scan import Scan
from linkplan.studies.frequency.feedback_loops import SIMULATED, feedback_loop, law_gain, operating_point
from linkplan.studies.frequency.margins import frequency_grid
from linkplan.studies.frequency.response import Response


def lowest_hz(entry: BodePoint) -> float:
    """Return the lowest frequency [Hz] drawn: a fifth of the lowest measured one, or a hundredth of the crossover."""
    if entry.measured:
        return float(next(iter(entry.measured.values())).frequency_hz[0]) / 5.0
    crossing = entry.margins.crossover_hz or entry.continuous_margins.crossover_hz
    return (crossing or 0.05 / entry.sampled.timing.period_s) / 100.0


def shifted_phase(phase: np.ndarray, gain: np.ndarray, quantity: str) -> np.ndarray:
    """Return a phase [deg] shifted by full turns: within half a turn of -180 deg at an open loop's crossover, else of 0."""
    if quantity != "loop":
        return phase - 360.0 * np.round(phase[0] / 360.0)
    crossing = int(np.argmin(np.abs(np.log(np.abs(gain)))))
    return phase - 360.0 * np.round((phase[crossing] + 180.0) / 360.0)


def measured_phase(response: Response, frequency_hz: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Return a measured phase [deg], shifted by full turns to the predicted phase (m,) at frequencies (m,) [Hz]."""
    near = np.interp(np.log(response.frequency_hz), np.log(frequency_hz), phase)
    measured = np.degrees(np.angle(response.gain))
    return measured + 360.0 * np.round((near - measured) / 360.0)


def sensitivity_along(study: BodeStudy, scan: Scan) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (m,) [Hz] and |S| (m, n) [dB] at a scan's n positions; NaN where the loop is unstable."""
    grid = frequency_grid(study.timing.period_s)[::16]
    grid = grid[grid >= min((lowest_hz(entry) for entry in study.points), default=grid[0])]
    limit = study.effort_limit
    heat = np.full((len(grid), len(scan.positions)), np.nan)
    for column, (position, bounds) in enumerate(zip(scan.positions, scan.margins, strict=True)):
        if not bounds.stable:  # an unstable loop has no sensitivity
            continue
        point = operating_point(study.mechanism, scan.line.at(position), np.array([[-np.inf, np.inf]] * len(limit)))
        loop = feedback_loop(point, law_gain(point, study.law, study.settings, limit), study.timing, SIMULATED)
        heat[:, column] = 20 * np.log10(np.abs(loop.gains("sensitivity", grid, scan.channel)))
    return grid, heat
