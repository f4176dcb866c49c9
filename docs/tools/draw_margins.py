"""The picture of stability margins in docs/margins.md: `python -m docs.tools.draw_margins` writes it."""

import sys
from pathlib import Path

import control
import numpy as np

from docs.tools.draw_gallery import FOLDER
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.bode.bode_result import BodePoint
from linkplan.studies.output.document import Axis, Plot, Series
from linkplan.studies.output.figure import BLUE, GREEN, GREY, ORANGE, PURPLE, draw_plot, figure_of
from linkplan.studies.output.figure_spec import FigureSpec, Panel

PICTURE = FOLDER / "margins.png"
# The gains that `linkplan tune` finds in docs/tutorial.md, and the angle of O on the page.
TUNED = Tracking(kp=1039.4, kd=24.312, period_s=1e-3, delay_periods=1)
ANGLE_DEG = 56.27
# The changed loops use this share of the gain margin [dB] and of the delay margin.
_MARGIN_SHARE = 0.97
_STEP_S = 0.25
_BANDWIDTH_DB = -3.0103


def margins_figure(path: Path) -> BodePoint:
    """Draw a loop of the knee with its margins, its bandwidth and its response to a step; return the loop."""
    mechanism = load_mechanism("optimus-knee", payload="shank")
    entry = _loop(mechanism, TUNED)
    gain, delay_s = 10 ** (_MARGIN_SHARE * entry.gain_margin_db / 20), _MARGIN_SHARE * entry.delay_margin_s
    louder = TUNED.replace(kp=gain * TUNED.kp, kd=gain * TUNED.kd)
    later = TUNED.replace(delay_periods=TUNED.delay_periods + round(delay_s / TUNED.period_s, 1))
    steps = {
        "the loop": (TUNED, 0, "line"),
        f"with {gain:.2g} times the gain": (louder, 1, "dash"),
        f"with {delay_s * 1e3:.2g} ms more delay": (later, 2, "dashdot"),
    }
    frequency_hz = np.geomspace(1.0, 0.5 / TUNED.period_s, 600)[:-1]
    panels: list[Panel] = [
        lambda axis: _draw_gain(axis, entry, frequency_hz),
        lambda axis: _draw_steps(axis, [_step(name, mechanism, *settings) for name, settings in steps.items()]),
        lambda axis: _draw_phase(axis, entry, frequency_hz),
    ]
    figure_of(FigureSpec(panels=panels, columns=2, panel_in=(5.6, 3.2)), path)
    return entry


def _loop(mechanism: Mechanism, settings: Tracking) -> BodePoint:
    angle = np.array([[np.radians(ANGLE_DEG)]])
    return bode_study(mechanism, angle, settings, mechanism.effort_limit, scanned=0).points[0]


def _step(name: str, mechanism: Mechanism, settings: Tracking, colour: int, look: str) -> Series:
    """Return the response of the joint's angle to a step of its reference [deg], which is a step of kp in the command."""
    system = _loop(mechanism, settings).sampled.system(closed=True)
    time = np.arange(0.0, _STEP_S, settings.period_s)
    angle = settings.kp * control.step_response(system, time).outputs[0].reshape(-1)
    return Series(name=name, x=time.tolist(), y=angle.tolist(), colour=colour, look=look)


def _draw_steps(axis, series: list[Series]) -> None:
    x_axis, y_axis = Axis(label="time", unit="s"), Axis(label="angle O", unit="deg")
    draw_plot(axis, Plot(title="", group="step", x_axis=x_axis, y_axis=y_axis, x=[], series=series))
    axis.set_title("Step of the reference by 1 deg")


def _draw_gain(axis, entry: BodePoint, frequency_hz: np.ndarray) -> None:
    """Draw the gains of open and closed loop, with crossover, gain margin and bandwidth."""
    opened, closed = (entry.sampled.response(name, frequency_hz, entry.channel) for name in ("loop", "complementary"))
    series = [
        Series(name="open loop L", y=opened.gain_db.tolist(), colour=0),
        Series(name="closed loop T = L / (1 + L)", y=closed.gain_db.tolist(), colour=3, look="dash"),
    ]
    _draw(axis, "gain", "dB", series, frequency_hz, (-60.0, 40.0))
    axis.axhline(0.0, color=GREY, linewidth=0.9)
    turned_hz = _phase_crossing_hz(frequency_hz, _phase_deg(opened.phase_deg))
    _arrow(axis, turned_hz, (0.0, -entry.gain_margin_db), ORANGE, f"gain margin\n{entry.gain_margin_db:.3g} dB")
    axis.plot(entry.crossover_hz, 0.0, "o", color=BLUE, zorder=5)
    axis.annotate(
        f"crossover\n{entry.crossover_hz:.3g} Hz", (entry.crossover_hz, 0.0), xytext=(-58, -34), color=BLUE, **_NOTE
    )
    axis.plot(entry.bandwidth_hz, _BANDWIDTH_DB, "s", color=PURPLE, zorder=5)
    place = (entry.bandwidth_hz, _BANDWIDTH_DB)
    axis.annotate(f"bandwidth {entry.bandwidth_hz:.3g} Hz,\nT at -3 dB", place, xytext=(6, 22), color=PURPLE, **_NOTE)


def _draw_phase(axis, entry: BodePoint, frequency_hz: np.ndarray) -> None:
    """Draw the phase of the open loop with its phase margin, and the phase with the delay margin as additional delay."""
    phase = _phase_deg(entry.sampled.response("loop", frequency_hz, entry.channel).phase_deg)
    late = phase - 360.0 * frequency_hz * entry.delay_margin_s
    series = [
        Series(name="open loop L", y=phase.tolist(), colour=0),
        Series(name=f"L with {entry.delay_margin_s * 1e3:.3g} ms more delay", y=late.tolist(), colour=2, look="dashdot"),
    ]
    _draw(axis, "phase", "deg", series, frequency_hz, (-360.0, -60.0))
    axis.axhline(-180.0, color=GREY, linewidth=0.9)
    assert entry.crossover_hz is not None  # the loop is stable
    ends = (-180.0, -180.0 + entry.phase_margin_deg)
    _arrow(axis, entry.crossover_hz, ends, GREEN, f"phase margin\n{entry.phase_margin_deg:.3g} deg")
    place = (entry.crossover_hz, -180.0)
    said = f"delay margin {entry.delay_margin_s * 1e3:.3g} ms:\nthis delay uses it up"
    axis.annotate(said, place, xytext=(-110, -42), color=GREEN, **_NOTE)


_NOTE = {"textcoords": "offset points", "fontsize": 9, "zorder": 6}


def _draw(axis, label: str, unit: str, series: list[Series], frequency_hz: np.ndarray, ends: tuple[float, float]) -> None:
    x_axis = Axis(label="frequency", unit="Hz", log=True)
    y_axis = Axis(label=label, unit=unit, ends=ends)
    draw_plot(axis, Plot(title="", group="bode", x_axis=x_axis, y_axis=y_axis, x=frequency_hz.tolist(), series=series))


def _arrow(axis, x: float, ends: tuple[float, float], colour: str, text: str) -> None:
    """Draw a vertical double arrow between two values, with its name at the right."""
    look = {"arrowstyle": "<->", "color": colour, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", (x, ends[0]), (x, ends[1]), zorder=6, arrowprops=look)
    axis.annotate(text, (x, np.mean(ends)), xytext=(7, -4), va="center", color=colour, **_NOTE)


def _phase_deg(phase_deg: np.ndarray) -> np.ndarray:
    """Return a continuous phase (n,) [deg] that begins between -360 and 0."""
    return phase_deg - 360.0 * np.ceil(phase_deg[0] / 360.0)


def _phase_crossing_hz(frequency_hz: np.ndarray, phase_deg: np.ndarray) -> float:
    """Return the highest frequency at which the phase falls through -180 deg."""
    below = np.flatnonzero((phase_deg[:-1] > -180.0) & (phase_deg[1:] <= -180.0))[-1]
    return float(np.interp(180.0, -phase_deg[below : below + 2], frequency_hz[below : below + 2]))


if __name__ == "__main__":
    drawn = margins_figure(PICTURE)
    print(f"{PICTURE}: {drawn.gain_margin_db:.4g} dB, {drawn.phase_margin_deg:.4g} deg", file=sys.stderr)
