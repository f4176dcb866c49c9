"""Every figure that linkplan writes: no text lies on another one, none is cut off, and no axis lacks its numbers.

Figures of feedback loops are in `bode/test_figures.py`.
"""

import warnings
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from msgspec import structs

import linkplan
from linkplan.api.plans import Plan
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.check.inspection import inspect
from linkplan.studies.check.path_plots import inspection_figure
from linkplan.studies.output.document import Axis, Bar, Bars, DrawnLimit, Plane, Plot, Series, Span
from linkplan.studies.output.draw_bodies import draw_poses
from linkplan.studies.output.figure import figure_of
from linkplan.studies.output.figure_spec import FigureSpec, one_screen
from linkplan.studies.output.lines import TIME, Line, overlaid_width, plots
from tests.support.figure_texts import text_faults
from tests.support.figures import curves, saved_figures
from tests.support.mechanism_checks import mechanism_of
from tests.support.plans import optimal

pytestmark = pytest.mark.usefixtures("drawn_figures")

SHORT = "tracking.duration_s=0.01"
RANGES = (
    "imperfections.payload_mass_factor=[0.9, 1.1]",
    "imperfections.torque_constant_factor={ act_O = [0.9412, 1.059] }",
    "imperfections.coulomb_friction={ O = [0.5, 2.0] }",
)


def plan(*overrides: str) -> Plan:
    """Return the plan of the knee's reach, planned once for each set of overrides."""
    return Plan.of(optimal("knee-reach", *overrides))


def experiment(folder: Path, samples: int, *overrides: str) -> None:
    linkplan.experiment(plan(SHORT, *overrides), samples=samples, folder=folder)


MOTORS = [{"name": f"motor {k}", "peak_effort": 90.0, "rotor_inertia": 1e-3 * k, "gears": [1, 2]} for k in (1, 2, 3, 4)]
# What is saved, and the names of its figures.
STUDIES = {
    "plan": (lambda folder: plan().save(folder), ["plan"]),
    "check": (lambda folder: linkplan.check("optimus-knee-linear").save(folder), ["mechanism", "loop-1"]),
    "check of a motion": (lambda folder: linkplan.check("knee-reach").save(folder), ["mechanism", "loop-1"]),
    "compare": (lambda folder: linkplan.compare(plan()).save(folder), ["compare"]),
    "tune": (lambda folder: linkplan.tune("five-bar", bandwidth_hz=3).save(folder), ["tune"]),
    "experiment": (lambda folder: experiment(folder, 24, *RANGES), ["sensitivity", "experiment"]),
    "decompose": (lambda folder: linkplan.decompose(plan(SHORT), samples=1).save(folder), ["decompose"]),
    "size": (lambda folder: linkplan.size("knee-reach", MOTORS).save(folder), ["size"]),
    "transfer": (lambda folder: linkplan.transfer("optimus-knee", joints=["C"]).save(folder), ["transfer"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("study", STUDIES)
def test_a_study_s_figures_have_all_texts_and_each_can_be_read(study, tmp_path, monkeypatch):
    figures, (save, names) = saved_figures(monkeypatch), STUDIES[study]
    save(tmp_path / "saved")
    assert {f"{name}.png" for name in names} <= set(figures)
    for file, figure in figures.items():
        assert not text_faults(figure), file


@pytest.mark.hardest
def test_the_demo_s_figures_have_all_texts_and_each_can_be_read(tmp_path, monkeypatch):
    saved, save = [], Figure.savefig

    def noted(figure: Figure, path: Path, *options: object, **more: object) -> None:
        saved.append((Path(path).relative_to(tmp_path), text_faults(figure)))
        save(figure, path, *options, **more)

    monkeypatch.setattr(Figure, "savefig", noted)
    linkplan.demo(tmp_path / "demo")
    assert len(saved) > 20
    assert [(str(path), faults) for path, faults in saved if faults] == []


@pytest.mark.parametrize("name", ["optimus-knee", "five-bar", "andrews-squeezer", "parallel-gripper", "cart-pole"])
def test_names_at_pins_lie_on_no_other_text(name):
    mechanism = mechanism_of(name)
    figure = figure_of(FigureSpec(panels=[lambda axes: draw_poses(axes, mechanism, mechanism.home[None])], title=name))
    assert not text_faults(figure)


def bare_plot(**more) -> Plot:
    """Return a plot of one line over 0 to 1."""
    axes = {"x_axis": Axis(label="time", unit="s"), "y_axis": Axis(label="position", unit="deg")}
    return Plot(
        **{"title": "Position", "group": "", "x": [0.0, 1.0], "series": [Series(name="", y=[1.0, 2.0])]} | axes | more
    )


def spoilt(how: str) -> Figure:
    """Return a figure with one fault."""
    figure = figure_of(FigureSpec(panels=[bare_plot()], title="Title"))
    axes = figure.axes[0]
    if how == "lies on":
        axes.text(0.5, 0.5, "one", transform=axes.transAxes)
        axes.text(0.51, 0.5, "other", transform=axes.transAxes)
    elif how == "cut off":
        axes.set_title("a long title " * 12)
    elif how == "a log axis":
        axes.set(yscale="log", ylim=(50.0, 5_000.0))
    elif how == "without a label":
        axes.set_xlabel("")
    elif how == "a title of 5 lines":
        figure.suptitle("\n".join("abcde"))
    return figure


@pytest.mark.parametrize("how", ["lies on", "cut off", "a log axis", "without a label", "a title of 5 lines"])
def test_a_spoilt_figure_has_its_fault_told(how):
    assert not text_faults(spoilt("not at all"))
    assert any(how in fault for fault in text_faults(spoilt(how)))


def test_a_plane_of_equal_units_has_room_for_its_titles_and_its_labels():
    curves_of = [Series(name=f"O = {k}.12 deg", x=[0.0, 1.0], y=[0.0, 1.0], colour=k) for k in range(9)]
    ends = (-2.5, 2.5)
    plane = Plane(
        title="Nyquist curves of the open loop; least disk margin 0.585 at O = 62.45 deg (gain +-5.23 dB or phase 32.6 deg)",
        x_axis=Axis(label="real part of L", unit="1", ends=ends),
        y_axis=Axis(label="imaginary part of L", unit="1", ends=ends),
        curves=curves_of,
        equal=True,
    )
    title = "optimus-knee, pd: kp = 200 N.m/rad, kd = 1 N.m.s/rad sampled every 0.0001 s"
    assert not text_faults(figure_of(FigureSpec(panels=[plane], title=title, panel_in=(6.4, 7.0))))


def test_a_legend_above_bars_with_long_labels_stays_on_the_page():
    names = ("all in the middle, 0.153", "at the low end", "at the high end")
    spans = [Span(name=name, start=0.0, end=0.387 + k, colour=k) for k, name in enumerate(names)]
    rows = [Bar(label="torque_constant_factor.act_O, 0.9412 to 1.059", spans=spans, note="0.00697")] * 2
    bars = Bars(title="pd+ff: influence of each imperfection on the error", axis=Axis(label="error", unit="deg"), rows=rows,
                line=0.0, line_name="", note_name="")  # fmt: skip
    assert not text_faults(figure_of(FigureSpec(panels=[bars] * 3, columns=2, panel_in=(6.5, 2.4))))


@pytest.mark.parametrize("ends", [(3.78, 5.99), (11.0, 950.0), (150.0, 3_000.0), (1e-4, 1e3), (0.2, 0.201)])
def test_a_logarithmic_axis_has_three_numbers_at_least(ends):
    plot = bare_plot(series=[Series(name="", y=list(ends))], y_axis=Axis(label="frequency", unit="Hz", log=True, ends=ends))
    assert not text_faults(figure_of(FigureSpec(panels=[plot])))


@pytest.mark.slow
def test_the_curves_over_a_slide_s_reach_are_those_of_the_table():
    mechanism = load_mechanism("optimus-knee-linear", payload="shank")
    found = inspect(mechanism, [])
    x, drawn = curves(figure_of(inspection_figure(found)).axes[2])["DB"]
    positions = np.linspace(x[0], x[-1], 60)[1:-1]
    inertia = [np.array(mechanism.dynamics.reduced_inertia(q))[0, 0] for q in poses_at(mechanism, positions)]
    assert np.interp(positions, x, drawn) == pytest.approx(inertia, rel=0.02)


def poses_at(mechanism, positions: np.ndarray) -> np.ndarray:
    """Return the closed poses at positions (n,) of a mechanism's only coordinate."""
    from linkplan.models.poses.assembly import follow

    return follow(mechanism, positions[:, None], follow(mechanism, positions[:1, None])[0])


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
        figure = figure_of(
            FigureSpec(panels=panels, columns=4, panel_in=one_screen(len(panels), 4, (5.3, 3.3))), tmp_path / "many.png"
        )
    heights = [axes.get_position().height * figure.get_size_inches()[1] for axes in figure.axes]
    assert min(heights) > 0.5


def test_a_figure_of_few_curves_keeps_the_height_of_its_panels():
    figure = figure_of(FigureSpec(panels=[panel(0, 2)] * 2, columns=2, panel_in=(5.3, 3.3)))
    assert figure.get_size_inches().tolist() == [2 * 5.3, 3.3 + 0.4]


def test_a_name_longer_than_its_panel_takes_several_lines_of_the_legend():
    poses = [Series(name=", ".join(f"joint_{k} = {n} deg" for k in range(12)), y=[0.0, 1.0], colour=n) for n in range(3)]
    axes = {"x_axis": Axis(label="x", unit="Hz"), "y_axis": Axis(label="y", unit="1")}
    figure = figure_of(FigureSpec(panels=[Plot(title="Gain", group="", x=[0.0, 1.0], series=poses, **axes)] * 2, columns=2))
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
    figure = figure_of(FigureSpec(panels=[plot]))
    FigureCanvasAgg(figure).draw()
    (text,) = [text for text in figure.axes[0].texts if "wanted" in text.get_text()]
    line = figure.axes[0].transData.transform((0.0, 30.0))[1]
    box = text.get_window_extent()
    assert (box.y1 < line) if below else (box.y0 >= line - 1.0)


def test_columns_of_cases_have_heads_above_every_title_and_rows_have_one_vertical_range():
    cases = [panel(0, 10), panel(1, 10), panel(2, 2), panel(3, 2)]
    cases[1] = structs.replace(cases[1], series=[Series(name="k", y=[0.0, 50.0])])
    figure = figure_of(FigureSpec(panels=cases, columns=2, heads=["nominal", "20 % heavier"]))
    FigureCanvasAgg(figure).draw()
    for axes, head in zip(figure.axes[:2], ("nominal", "20 % heavier"), strict=True):
        (text,) = [text for text in axes.texts if text.get_text() == head]
        box, title = text.get_window_extent(), axes.title.get_window_extent()
        assert title.y1 <= box.y0
        assert box.y1 <= figure.bbox.height
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim() != figure.axes[2].get_ylim()
    assert [bool(axes.get_xlabel()) for axes in figure.axes] == [False, False, True, True]


def test_a_line_without_values_has_no_entry_in_the_legend_and_single_values_are_dots():
    rows = {"none": [np.nan, np.nan, np.nan], "one": [np.nan, 1.0, np.nan], "two": [np.nan, 1.0, 2.0]}
    lines = [Line(name=name, values=np.array(row), unit="Hz") for name, row in rows.items()]
    (plot,) = plots("Crossings", "frequency", TIME, np.arange(3.0), lines)
    looks = [(one.name, one.look, one.colour) for one in plot.series]
    assert looks == [("", "line", 0), ("one", "points", 1), ("two", "line", 2)]


def test_only_a_drawing_in_one_scale_takes_the_empty_room_below_it():
    def free(axes) -> None:
        axes.plot([0.0, 1.0], [0.0, 1.0])

    def drawn(axes) -> None:
        free(axes)
        axes.set_aspect("equal", adjustable="datalim")

    for panels, spans in (([panel(0, 2), free, panel(1, 2)], 1), ([panel(0, 2), drawn, panel(1, 2)], 2)):
        figure = figure_of(FigureSpec(panels=panels, columns=2))
        assert len(figure.axes[1].get_subplotspec().rowspan) == spans


def test_a_line_alone_is_of_the_usual_width_and_of_several_the_first_is_the_widest():
    assert overlaid_width(0, 1) == Series(name="", y=[]).width
    widths = [overlaid_width(k, 3) for k in range(3)]
    assert widths == sorted(widths, reverse=True)
    assert len({*widths}) == 3


def test_lines_that_hide_each_other_are_of_different_widths():
    time = np.linspace(0.0, 1.0, 50)
    rows = {"one": np.sin(9 * time), "same": np.sin(9 * time) + 1e-4, "other": np.cos(9 * time)}

    def widths(*names: str, log: bool = False) -> list[float]:
        lines = [Line(name=name, values=np.exp(rows[name]) if log else rows[name], unit="m") for name in names]
        (plot,) = plots("Motion", "position", TIME, time, lines, log=log)
        return [one.width for one in plot.series]

    for log in (False, True):
        hidden, apart = widths("one", "other", "same", log=log), widths("one", "other", log=log)
        assert hidden == [overlaid_width(k, 3) for k in range(3)]
        assert apart == [overlaid_width(0, 1)] * 2
