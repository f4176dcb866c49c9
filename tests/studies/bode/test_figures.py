"""Figures of feedback loops: every pose is seen and told from the others, and no legend lies on a curve."""

import tempfile
from functools import cache
from pathlib import Path

import control
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import linkplan
from docs.tools.draw_margins import PICTURE, margins_figure
from linkplan.cli.main import main
from linkplan.studies.feedback.bode.curves import phase_along
from tests.support.figure_texts import text_faults
from tests.support.figures import curves, saved_figures

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("placed_figures")]


@cache
def drawn(what: str, *options: str) -> dict[str, Figure]:
    """Return the figures of `bode` without measurements by name."""
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as place:
        figures = saved_figures(patch)
        assert main(["bode", what, "--no-measure", "-o", str(Path(place) / "drawn"), *options]) in (0, 1)
    return figures


# Poses asked for are not scanned between: no margins.png, and quick.
POSES = [f"--at-deg=O={angle}" for angle in (-80, -60, -40, -20, 0, 20, 40, 76)]
MAPPED = ("optimus-knee", "--kp", "1", "--kd", "1e-5", "--map", "--at-deg=O=0")


def test_the_open_loop_of_an_unstable_gain_is_in_its_frame_and_named():
    figures = drawn("optimus-knee", "--kp", "200", "--kd", "10", *POSES)
    (axes,) = figures["nyquist.png"].axes
    lines = {name: data for name, data in curves(axes).items() if name.startswith("O =")}
    assert len(lines) > 6
    looks = {(line.get_color(), line.get_linestyle()) for line in axes.lines if line.get_label() in lines}
    assert len(looks) == len(lines)  # more poses than colours
    assert sum(name.endswith("(unstable)") for name in lines) > 5
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    for name, (x, y) in lines.items():
        assert np.any((x > left) & (x < right) & (y > low) & (y < high)), name
    assert max(abs(x[np.nanargmin(np.hypot(x, y))]) for x, y in lines.values()) > 2.5  # beyond the frame as it was


def test_margins_of_a_loop_that_is_unstable_at_most_angles_are_over_one_range():
    figure = drawn("optimus-knee", "--kp", "200", "--kd", "10")["margins.png"]
    panels = [axes for axes in figure.axes if axes.get_xlabel() == "O [deg]"]
    assert len(panels) == 3
    assert len({axes.get_xlim() for axes in panels}) == 1
    for axes in panels[1:]:
        lines = [line for line in axes.lines if not line.get_label().startswith("_")]
        assert len(lines) >= 2
        assert all(np.isfinite(line.get_ydata()).any() for line in lines)  # what the legend names is drawn


@pytest.mark.filterwarnings("error:All-NaN")
def test_figures_of_a_loop_that_is_unstable_at_every_pose_bring_no_warning():
    assert "margins.png" in drawn("knee-sine", "--set", "tracking.kd=10")


@pytest.mark.parametrize("name", ["optimus-knee", "five-bar-reach"])
def test_no_legend_lies_on_an_axes_and_no_page_grows_wider_for_one(name):
    figures = drawn(name)
    assert len(figures) >= 4
    for file, figure in figures.items():
        FigureCanvasAgg(figure).draw()
        legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes if axes.get_legend())]
        assert legends, file
        for legend in legends:
            box = legend.get_window_extent()
            assert box.x0 > -1 and box.x1 < figure.bbox.width + 1, file  # noqa: PT018
            for axes in figure.axes:
                assert not axes.bbox.shrunk(0.99, 0.99).overlaps(box), (file, axes.get_ylabel())


@pytest.mark.parametrize("options", [("optimus-knee", *POSES), ("optimus-knee",), ("five-bar-reach",), MAPPED], ids=str)
def test_all_texts_of_a_feedback_loop_s_figures_can_be_read(options):
    for file, figure in drawn(*options).items():
        assert not text_faults(figure), file


def test_dots_are_named_only_where_there_are_some():
    figures = drawn("optimus-knee", *POSES)
    said = [text.get_text() for figure in figures.values() for text in figure.findobj(lambda one: hasattr(one, "get_text"))]
    assert any("disk margin" in text for text in said)
    assert not any("MuJoCo" in text for text in said)


def test_the_highest_margin_is_below_the_top_of_its_axes():
    figures = drawn("five-bar-reach")
    axes = figures["margins-O2.png"].axes[1]
    highest = max(float(np.nanmax(y)) for name, (_, y) in curves(axes).items() if "margin" in name)
    assert axes.get_ylim()[1] > 1.05 * highest


def test_gains_far_from_the_border_are_on_the_map_too():
    axes = drawn(*MAPPED)["map.png"].axes[0]
    ((x,), (y,)) = curves(axes)["these gains"]
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    assert (x, y) == pytest.approx((1e-5, 1.0))
    assert left < x < right
    assert low < y < high


def test_the_picture_of_margins_shows_those_of_python_control_and_loops_that_nearly_use_them_up(tmp_path, monkeypatch):
    saved = saved_figures(monkeypatch)
    shown = margins_figure(tmp_path / "margins.png")
    loop = linkplan.bode(
        "knee-reach", kp=1039.4, kd=24.312, period_s=1e-3, delay_periods=1, at_deg=[{"O": 56.27}], measure=False
    )
    gain, phase, *_ = control.stability_margins(loop.frd("loop"))
    assert shown.gain_margin_db == pytest.approx(20 * np.log10(gain), abs=0.05)
    assert shown.phase_margin_deg == pytest.approx(phase, abs=0.1)
    figure = saved["margins.png"]
    assert text_faults(figure) == []
    (steps,) = [axes for axes in figure.axes if axes.get_xlabel() == "time [s]"]
    for name, (_, angle) in curves(steps).items():
        # the loop itself has settled; with nearly a whole margin used up it swings on at the end
        swing = np.ptp(angle[-60:])
        assert angle[-60:].mean() == pytest.approx(1.0, abs=0.05), name
        assert (swing > 0.1) == ("delay" in name), name
    assert PICTURE.is_file()


def test_a_phase_that_passes_a_resonance_the_other_way_round_stays_beside_the_first():
    frequency = np.array([0.1, 0.5, 0.9, 1.1, 2.0, 10.0])
    predicted = np.array([-180.0, -180.0, 0.0, -180.0, -180.0, -180.0])
    delay = np.array([-0.1, -0.5, -0.9, -100.0, -170.0, -300.0])
    passed = predicted + delay + np.array([360.0, 360.0, 360.0, 720.0, 720.0, 720.0])
    np.testing.assert_allclose(phase_along(frequency, passed, frequency, predicted), predicted + delay)
