"""Every kind of block as it is seen: on a wide and a narrow window, in the dark, and on paper."""

import pytest

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
    Section,
    Series,
    Table,
    Text,
)
from linkplan.studies.output.lines import TIME
from linkplan.studies.output.report_file import report_of, write_report
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
    """'kp [N.m/rad]' lay on '100000', and the last number of an axis was cut off."""
    page = opened(browser, tmp_path, *every_kind(), width=width, script=NOTING)
    page.build()
    assert text_faults(page) == []
    if width == 1400:
        printed(page)
        assert text_faults(page) == []


def test_a_text_that_lies_on_another_is_found(browser, tmp_path):
    page = opened(browser, tmp_path, plot(), script=NOTING)
    page.build()
    page.ask("document.querySelector('.uplot canvas').getContext('2d').fillText('upon', 30, 200)")
    page.ask("document.querySelector('.uplot canvas').getContext('2d').fillText('it', 32, 200)")
    page.ask("document.querySelector('.uplot canvas').getContext('2d').fillText('away', -9, 90)")
    assert text_faults(page) == ["Position: 'away' is cut off", "Position: 'upon' lies on 'it'"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_kind_of_block_can_be_read_in_the_light_and_in_the_dark(browser, tmp_path, scheme):
    page = opened(browser, tmp_path, *every_kind(), scheme=scheme)
    page.build()
    assert violations(page.page) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_samples_of_a_legend_have_the_colour_and_the_dashes_of_their_lines(browser, tmp_path, scheme):
    """Samples kept the theme in which they were drawn: in the light, that of a dark page's desired motion was white."""
    page = opened(browser, tmp_path, plot(), scheme=scheme)
    page.build()
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
    """On paper, and in a window made narrower, the unit circle was an ellipse."""
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
    """It was cut off at the paper's edge, or all pages were printed smaller."""
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
    page = opened(browser, tmp_path, plot())
    page.build()
    assert page.page.locator(".u-value:visible").count() == 3
    printed(page)
    assert page.page.locator(".u-value:visible").count() == 0
    assert page.page.locator(".u-label:visible").all_inner_texts() == ["tracked", "desired"]


def test_the_cells_of_a_column_stand_below_one_another(browser, tmp_path):
    """A number stood at the right below '1, 2' at the left, and a missing number at the left below numbers at the right."""
    rows = [["1, 2", 1.5, "3.8 ± 0.1"], ["-", None, "0.21 ± 0.04"], ["2", 2.5, "none"], ["1, 3", 3.5, "1 ± 1"]]
    block = Table(title="Table", columns=[("places", ""), ("value", "Hz"), ("mean", "deg")], rows=rows)
    page = opened(browser, tmp_path, block)
    sides = (
        "[...document.querySelectorAll('tr')].map((row) => [...row.children].map((one) => getComputedStyle(one).textAlign))"
    )
    assert page.ask(sides) == [["left", "right", "right"]] * 5


def test_the_arc_of_an_effort_far_beyond_its_limit_does_not_run_into_its_own_tail(browser, tmp_path):
    """Ten times the limit was a ragged ring of four turns."""
    body = Body(name="crank", fixed=False, colour="c0", n_pins=2, points=[[0.0, 0.0, 0.1, 0.0]] * 2)
    mark = Mark(shape="arc", at=[[0.0, 0.0]] * 2, axis=[[1.0]] * 2)
    drive = Drive(name="motor", unit="N.m", marks=[mark], effort=[-10.0, 10.0], limits=(-1.0, 1.0))
    moved = Animation(
        title="Crank", group="a", dimension=2, axes=("x", "z"), times=[0.0, 1.0], bodies=[body], drives=[drive]
    )
    page = opened(browser, tmp_path, moved)
    page.build()
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
    """It stood on a line of its own, above the title."""
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
