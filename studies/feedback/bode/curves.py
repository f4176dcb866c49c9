"""Curves over frequency as plots, and phases shifted by full turns to lie near others."""

from collections.abc import Sequence

import numpy as np

from linkplan.studies.feedback.frequency.response import Response
from linkplan.studies.output.document import Axis, DrawnLimit, Plot, Series
from linkplan.studies.output.numbers import rounded

FREQUENCY = Axis(label="frequency", unit="Hz", log=True)


def frequency_plot(
    title: str, what: str, unit: str, curves, group: str, limits: Sequence[DrawnLimit] = (), ends=None
) -> Plot:
    """Return a plot of curves over frequency. Each curve is a tuple of name, frequencies [Hz], values and line style."""
    series = [
        Series(name=name, x=rounded(frequency, log=True), y=rounded(values), **look)
        for name, frequency, values, look in curves
    ]
    lowest, highest = min(float(c[1][0]) for c in curves), max(float(c[1][-1]) for c in curves)
    return Plot(
        title=title,
        group=group,
        x_axis=FREQUENCY,
        y_axis=Axis(label=what, unit=unit, ends=ends),
        x=rounded(np.array([lowest, highest]), log=True),
        series=series,
        limits=limits,
    )


def phase_near(frequency_hz: np.ndarray, phase: np.ndarray, others: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return a phase (n,) [deg], shifted by full turns to the most similar other phase; `others` are (frequencies, phases).

    A phase near 0 or -360 deg at the crossover has a shift of its own that differs from that of a nearly equal pose.
    """
    shifted = []
    for frequency, other in others:
        off = np.interp(np.log(frequency_hz), np.log(frequency), other) - phase
        shift = 360.0 * np.round(np.median(off) / 360.0)
        shifted.append((float(np.median(np.abs(off - shift))), shift))
    return phase + min(shifted)[1] if shifted else phase


def phase_along(frequency_hz: np.ndarray, phase: np.ndarray, other_hz: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return a phase (n,) [deg] whose difference from another has no jumps by full turns.

    An undamped resonance turns a phase by half a turn in one step, either way.
    """
    near = np.interp(np.log(frequency_hz), np.log(other_hz), other)
    off = np.unwrap(phase - near, period=360.0)
    return near + off - 360.0 * np.round(off[0] / 360.0)


def measured_phase(response: Response, frequency_hz: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Return a measured phase [deg], shifted by full turns to the predicted phase (m,) at frequencies (m,) [Hz]."""
    near = np.interp(np.log(response.frequency_hz), np.log(frequency_hz), phase)
    measured = np.degrees(np.angle(response.gain))
    return measured + 360.0 * np.round((near - measured) / 360.0)
