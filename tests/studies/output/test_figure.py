"""Figures of many panels with long legends, which a robot with a motor on every joint has."""

import warnings

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from linkplan.studies.output.document import Axis, DrawnLimit, Plot, Series
from linkplan.studies.output.figure import figure_of, one_screen
from linkplan.studies.output.lines import TIME, Line, plots

pytestmark = pytest.mark.usefixtures("drawn_figures")


def panel(number: int, n_lines: int) -> Plot:
    """Return a plot whose legend has long names, which differ from those of every other plot."""
    lines = [
        Series(name=f"a long name of joint {number} to another joint {k}", y=[0.0, float(k)], colour=k)
        for k in range(n_lines)
    ]
    axes = {"x_axis": Axis(label="x", unit="deg"), "y_axis": Axis(label="y", unit="1")}
    return Plot(title="Transmission ratio", group="reach", x=[0.0, 1.0], series=lines, **axes)


def test_curves_have_room_below_long_legends(tmp_path):
    panels = [panel(number, 10) for number in range(16)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # matplotlib warns of axes without a height
        figure = figure_of(panels, tmp_path / "many.png", columns=4, panel_in=one_screen(len(panels), 4, (5.3, 3.3)))
    heights = [axes.get_position().height * figure.get_size_inches()[1] for axes in figure.axes]
    assert min(heights) > 0.5


def test_a_figure_of_few_curves_keeps_the_height_of_its_panels():
    figure = figure_of([panel(0, 2)] * 2, columns=2, panel_in=(5.3, 3.3))
    assert figure.get_size_inches().tolist() == [2 * 5.3, 3.3 + 0.4]


def test_a_name_longer_than_its_panel_takes_several_lines_of_the_legend():
    poses = [Series(name=", ".join(f"joint_{k} = {n} deg" for k in range(12)), y=[0.0, 1.0], colour=n) for n in range(3)]
    axes = {"x_axis": Axis(label="x", unit="Hz"), "y_axis": Axis(label="y", unit="1")}
    figure = figure_of([Plot(title="Gain", group="", x=[0.0, 1.0], series=poses, **axes)] * 2, columns=2)
    figure.canvas.draw()
    legend = figure.axes[0].get_legend().get_window_extent()
    assert legend.x0 >= 0
    assert legend.width < 0.5 * figure.bbox.width


def test_a_limit_of_all_lines_is_named_so_where_some_stay_far_below_it():
    rows = {"far": np.array([0.0, 100.0]), "near": np.array([0.0, 200.0])}
    lines = [Line(name=name, values=row, unit="N.m", limits=(-300.0, 300.0)) for name, row in rows.items()]
    (plot,) = plots("Effort", "effort", TIME, np.array([0.0, 1.0]), lines)
    assert [(limit.name, limit.value) for limit in plot.limits] == [("limit", -300.0), ("limit", 300.0)]
    (plot,) = plots("Effort", "effort", TIME, np.array([0.0, 1.0]), lines[:1])
    assert not plot.limits


@pytest.mark.parametrize(("values", "below"), [([31.0, 30.5], True), ([10.0, 29.0], False)])
def test_the_name_of_a_limit_is_beside_the_curves(values, below):
    axis = Axis(label="bandwidth", unit="Hz", ends=(0.0, 34.0))
    limit = DrawnLimit(name="wanted at least", value=30.0)
    plot = Plot(
        title="", group="g", x_axis=Axis(label="O", unit="deg"), y_axis=axis, x=[0.0, 1.0],
        series=[Series(name="bandwidth", y=values)], limits=[limit],
    )  # fmt: skip
    figure = figure_of([plot])
    FigureCanvasAgg(figure).draw()
    (text,) = [text for text in figure.axes[0].texts if "wanted" in text.get_text()]
    line = figure.axes[0].transData.transform((0.0, 30.0))[1]
    box = text.get_window_extent()
    assert (box.y1 < line) if below else (box.y0 >= line - 1.0)
