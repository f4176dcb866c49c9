"""Every kind of block as it is seen: on a wide and a narrow window, in the dark, and on paper."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.frequency.excitation import Setup
from linkplan.studies.output.document import (
    Animation,
    Axis,
    Body,
    Checklist,
    Code,
    Drive,
    Facts,
    Heat,
    Item,
    Mark,
    Plane,
    Plot,
    Report,
    Section,
    Series,
    Table,
    Text,
)
from linkplan.studies.output.lines import TIME
from linkplan.studies.output.report_file import report_html, report_of, write_report
from tests.support.browser import Opened, chromium, violations
from tests.support.page_texts import NOTING, text_faults

pytestmark = pytest.mark.slow
# What a sheet of A4 has room for between its margins [px].
PAPER = 703
# A colour of the style sheet, as browsers return colours.
COLOUR = """(name) => {
  const probe = document.createElement('i');
  probe.style.color = `var(--${name})`;
  document.body.append(probe);
  const found = getComputedStyle(probe).color;
  probe.remove();
  return found;
}"""
# The plots that are made from here on, in `made`.
TAKE_UP = """() => {
  window.made = [];
  const Own = uPlot;
  uPlot = Object.assign(function (...given) { const one = new Own(...given); made.push(one); return one; }, Own);
}"""
# Pixels to the unit of each axis.
SCALES = """made.map((plot) => ["x", "y"].map((side) => Math.abs(plot.valToPos(1, side) - plot.valToPos(0, side))))"""


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


def plot(**more) -> Plot:
    axes = {"x_axis": TIME, "y_axis": Axis(label="position", unit="deg")}
    lines = [Series(name="tracked", y=[0.0, 1.0]), Series(name="desired", y=[0.0, 1.2], look="dash", colour=None)]
    return Plot(**{"title": "Position", "group": "", "x": [0.0, 1.0], "series": lines} | axes | more)


def plane(**more) -> Plane:
    """Return a plane whose numbers are long, on a map."""
    grid = {"x": [10.0, 100.0, 1000.0], "y": [1e3, 1e5, 1e7]}
    heat = Heat(name="margin", unit="deg", values=[[0, 45, 90]] * 3, ends=(0.0, 90.0), **grid)
    curve = Series(name="boundary", x=[10.0, 100.0, 1000.0], y=[1e7, 1e6, 1e3])
    axes = {
        "x_axis": Axis(label="kd", unit="N.m.s/rad", log=True, ends=(10, 1000)),
        "y_axis": Axis(label="kp", unit="N.m/rad", log=True, ends=(1e3, 1e7)),
    }
    return Plane(**{"title": "Stable gains", "curves": [curve], "heat": heat} | axes | more)


def table(n_columns: int = 3) -> Table:
    heads = [(f"quantity {k}", "N.m") for k in range(n_columns)]
    return Table(
        title="Table", columns=[("name", ""), *heads], rows=[[f"joint {k}", *[-123.456] * n_columns] for k in (1, 2)]
    )


def opened(browser, folder, *blocks, folded: bool = False, title: str = "First", **more) -> Opened:
    """Return the page of blocks."""
    section = Section(title=title, blocks=list(blocks), folded=folded)
    write_report(report_of("Tried", "Passed", True, [section]), folder / "report.html")
    return Opened(browser, folder / "report.html", **more)


def printed(page: Opened) -> None:
    """Lay a page out for paper."""
    page.ask("dispatchEvent(new Event('beforeprint'))")
    page.page.emulate_media(media="print")
    page.settle()


def every_kind() -> list:
    many = plot(x_axis=Axis(label="speed", unit="deg/s", ends=(-66_000, 66_000)), x=[-65_000.0, 65_000.0])
    small = plot(x_axis=Axis(label="share", unit="1", ends=(0.0, 0.014)), x=[0.0, 0.014])
    facts = Facts(rows=[("mechanism", "five-bar")])
    check = Checklist(
        title="Checks", group="", items=[Item(label="effort", passed=False, worst=2.0, limit=1.0, instant_s=0.5)]
    )
    texts = [Text(text="a note", tone="note"), Text(text="good", tone="good"), Text(text="bad", tone="bad")]
    return [facts, *texts, table(), check, plot(), many, small, plane(), Code(title="Code", text="a = 1")]


@pytest.mark.parametrize("width", [1400, 400, PAPER])
def test_no_text_of_a_plot_lies_on_another_or_is_cut_off(browser, tmp_path, width):
    page = opened(browser, tmp_path, *every_kind(), width=width, script=NOTING).build()
    assert text_faults(page) == []
    if width == 1400:
        printed(page)
        assert text_faults(page) == []


def test_a_text_that_lies_on_another_is_found(browser, tmp_path):
    page = opened(browser, tmp_path, plot(), script=NOTING).build()
    page.ask("document.querySelector('.uplot canvas').getContext('2d').fillText('upon', 30, 200)")
    page.ask("document.querySelector('.uplot canvas').getContext('2d').fillText('it', 32, 200)")
    page.ask("document.querySelector('.uplot canvas').getContext('2d').fillText('away', -9, 90)")
    assert text_faults(page) == ["Position: 'away' is cut off", "Position: 'upon' lies on 'it'"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_kind_of_block_can_be_read_in_the_light_and_in_the_dark(browser, tmp_path, scheme):
    page = opened(browser, tmp_path, *every_kind(), scheme=scheme).build()
    assert violations(page.page) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_samples_of_a_legend_have_the_colour_and_the_dashes_of_their_lines(browser, tmp_path, scheme):
    page = opened(browser, tmp_path, plot(), scheme=scheme).build()
    sample = """[...document.querySelectorAll('.u-legend .u-marker')].slice(1).map((one) => {
      const style = getComputedStyle(one);
      return [style.borderTopColor, style.borderTopStyle];
    })"""
    seen = []
    for _ in range(2):
        colours = [page.ask(COLOUR, name) for name in ("c0", "ink")]
        assert page.ask(sample) == [[colours[0], "solid"], [colours[1], "dashed"]]
        seen.append(colours)
        page.page.locator("button.theme").click()
    assert seen[0] != seen[1]


@pytest.mark.parametrize("paper", [False, True])
def test_a_plane_with_one_scale_for_both_axes_keeps_it_in_any_width(browser, tmp_path, paper):
    ends = {"x_axis": Axis(label="real part", unit="1"), "y_axis": Axis(label="imaginary part", unit="1")}
    round_one = plane(equal=True, heat=None, curves=[Series(name="L", x=[-2.0, 2.0], y=[-2.0, 2.0])], **ends)
    page = opened(browser, tmp_path, round_one, folded=True)
    page.ask(TAKE_UP)
    page.ask("() => { document.querySelector('details').open = true; }")
    page.page.locator(".plane .uplot").wait_for()
    page.build()
    (first,) = page.ask(SCALES)
    assert first[0] == pytest.approx(first[1], rel=0.02)
    if paper:
        printed(page)
    else:
        page.page.set_viewport_size({"width": 320, "height": 900})
        page.settle()
    (now,) = page.ask(SCALES)
    assert now[0] < 0.9 * first[0]
    assert now[0] == pytest.approx(now[1], rel=0.02)


def test_a_wide_table_is_printed_whole(browser, tmp_path):
    right = "document.querySelector('table').getBoundingClientRect().right"
    page = opened(browser, tmp_path, table(14))
    before = page.ask(right)
    printed(page)
    page.page.set_viewport_size({"width": PAPER, "height": 990})
    assert page.ask(right) <= PAPER
    assert page.ask("document.documentElement.scrollWidth") <= PAPER
    page.page.emulate_media(media="screen")
    page.page.set_viewport_size({"width": 1400, "height": 900})
    page.ask("dispatchEvent(new Event('afterprint'))")
    assert page.ask(right) == pytest.approx(before, abs=1.0)


def test_on_paper_an_instant_is_a_number_and_not_a_button(browser, tmp_path):
    page = opened(browser, tmp_path, *every_kind())
    border = "getComputedStyle(document.querySelector('button.instant')).borderTopWidth"
    assert page.ask(border) == "1px"
    printed(page)
    assert page.ask(border) == "0px"


def test_on_paper_a_legend_without_a_cursor_has_no_empty_values(browser, tmp_path):
    page = opened(browser, tmp_path, plot()).build()
    assert page.page.locator(".u-value:visible").count() == 3
    printed(page)
    assert page.page.locator(".u-value:visible").count() == 0
    assert page.page.locator(".u-label:visible").all_inner_texts() == ["tracked", "desired"]


def test_the_cells_of_a_column_stand_below_one_another(browser, tmp_path):
    rows = [["1, 2", 1.5, "3.8 ± 0.1"], ["-", None, "0.21 ± 0.04"], ["2", 2.5, "none"], ["1, 3", 3.5, "1 ± 1"]]
    block = Table(title="Table", columns=[("places", ""), ("value", "Hz"), ("mean", "deg")], rows=rows)
    page = opened(browser, tmp_path, block)
    sides = (
        "[...document.querySelectorAll('tr')].map((row) => [...row.children].map((one) => getComputedStyle(one).textAlign))"
    )
    assert page.ask(sides) == [["left", "right", "right"]] * 5


def test_the_arc_of_an_effort_far_beyond_its_limit_does_not_run_into_its_own_tail(browser, tmp_path):
    body = Body(name="crank", fixed=False, colour="c0", n_pins=2, points=[[0.0, 0.0, 0.1, 0.0]] * 2)
    mark = Mark(shape="arc", at=[[0.0, 0.0]] * 2, axis=[[1.0]] * 2)
    drive = Drive(name="motor", unit="N.m", marks=[mark], effort=[-10.0, 10.0], limits=(-1.0, 1.0))
    moved = Animation(
        title="Crank", group="a", dimension=2, axes=("x", "z"), times=[0.0, 1.0], bodies=[body], drives=[drive]
    )
    page = opened(browser, tmp_path, moved).build()
    page.ask("""() => {
      window.swept = [];
      const own = drawArc;
      drawArc = (ctx, view, at, axis, from, to) => { swept.push(to - from); own(ctx, view, at, axis, from, to); };
      theme.changed();
    }""")
    page.settle()
    behind, drawn = page.ask("swept.slice(0, 2)")
    assert drawn < 0 < behind  # the range between the limits, and the effort
    assert behind / 2 < abs(drawn) < 2 * 3.14


def test_the_mark_of_a_folded_section_stands_beside_a_title_of_two_lines(browser, tmp_path):
    page = opened(browser, tmp_path, table(), folded=True, title="Over time: payload +20 %, one period of delay", width=400)
    page.settle()
    lines, below = page.ask("""(() => {
      const summary = document.querySelector("summary"), title = summary.firstElementChild;
      const style = getComputedStyle(title), margins = parseFloat(style.marginTop) + parseFloat(style.marginBottom);
      const height = title.getBoundingClientRect().height, line = parseFloat(style.fontSize);
      return [height / line, summary.getBoundingClientRect().height - height - margins];
    })()""")
    assert lines > 2
    assert below < 10


# Runs a page's script about plots in a window that has only a navigator, and prints its language and what it defines.
_WINDOW = """
const vm = require("vm");
const window = { navigator: { language: %s }, console };
window.window = window.globalThis = window;
window.document = {};
window.addEventListener = () => {};
window.devicePixelRatio = 1;
window.CustomEvent = Event;
window.dispatchEvent = () => {};
window.matchMedia = () => ({ addEventListener: () => {} });
vm.runInNewContext(%s + "; result = typeof uPlot + ' ' + navigator.language", window);
console.log(window.result);
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node")
@pytest.mark.parametrize(
    ("language", "becomes"), [("en-US@posix", "en-US"), ("C", "en-US"), ("de-DE", "de-DE"), ("en", "en")]
)
def test_plots_are_drawn_whatever_a_browser_calls_its_language(language, becomes):
    page = report_html(Report(title="t", verdict="", passed=None, versions={}, sections=()))
    plots = re.findall(r"<script>\n(.*?)\n</script>", page, flags=re.DOTALL)[0]
    assert "uPlot" in plots
    program = _WINDOW % (json.dumps(language), json.dumps(plots))
    said = subprocess.run(["node", "-"], input=program, capture_output=True, text=True, check=False)
    assert said.stdout.split() == ["function", becomes], re.findall(r"^\w*Error: .*", said.stderr, flags=re.MULTILINE)


DOT = "\u25cf"
# Cells of a legend of which one begins before the one to its left ends.
ON_ONE_ANOTHER = """[...document.querySelectorAll('.u-legend .u-series')].flatMap((row) => {
  const texts = [...row.querySelectorAll('.u-label, .u-value')];
  const end = Math.max(...texts.map((text) => text.getBoundingClientRect().right));
  const next = row.nextElementSibling && row.nextElementSibling.getBoundingClientRect();
  const beside = next && Math.abs(next.top - row.getBoundingClientRect().top) < 4;
  return beside && next.left < end - 1 ? [row.innerText] : [];
})"""


@pytest.mark.parametrize("width", [1400, 400])
def test_a_long_name_of_an_axis_does_not_lie_under_the_first_line_s(browser, tmp_path, width):
    names = ("pd", "pd+ff", "lqr", "lqi", "gs-pd+ff", "ct", "mpc")
    settled = plot(
        x_axis=Axis(label="settling into the tube after the motion's end", unit="s"),
        series=[Series(name=name, y=[0.0, 100.0], colour=k) for k, name in enumerate(names)],
    )
    page = opened(browser, tmp_path, settled, width=width).build()
    assert page.page.locator(".u-legend .u-series").count() == 8
    assert page.ask(ON_ONE_ANOTHER) == []


@pytest.mark.parametrize(("rows", "whole"), [(21, True), (200, False)])
def test_a_table_of_some_rows_is_shown_whole_and_a_long_one_in_a_window(browser, tmp_path, rows, whole):
    pairs = Table(title="Pairs", columns=[("first", ""), ("second", "")], rows=[["pd", k] for k in range(rows)])
    height, content = opened(browser, tmp_path, pairs).ask(
        "(({ clientHeight, scrollHeight }) => [clientHeight, scrollHeight])(document.querySelector('.wide'))"
    )
    assert (height >= content) == whole


def test_what_was_measured_of_a_line_stands_in_the_line_s_own_entry(browser, tmp_path):
    gains, knee = Tracking(kp=200.0, kd=1.0, period_s=1e-4), load_mechanism("optimus-knee")
    at, poses = np.array([20.0, 40.0, 300.0]), np.radians([[-40.0], [20.0]])
    study = bode_study(knee, poses, gains, knee.effort_limit, scanned=0, setup=Setup(), frequency_hz=at)
    write_report(study.document(), tmp_path / "report.html")
    opened = Opened(browser, tmp_path / "report.html", width=400).build()
    plot = opened.page.locator("figure.plot", has_text="Open loop L: gain; dots measured").first
    entries = plot.locator(".u-series:visible")
    assert entries.locator(".u-label").all_inner_texts() == ["frequency [Hz]", "O = -40 deg", "O = 20 deg"]
    over = plot.locator(".u-over")
    room, said = over.bounding_box(), []
    for share in np.linspace(0.01, 0.99, 40):
        over.hover(position={"x": share * room["width"], "y": 20})
        opened.settle()
        said.append(entries.nth(1).locator(".u-value").inner_text())
    beside = [text.split(DOT) for text in said if DOT in text]
    assert 0 < len(beside) < len(said) / 2  # where a dot is, alone
    for line, dot in beside:
        assert abs(float(line) - float(dot)) < 1.5  # dB: the line falls by so much over six pixels at the most
