"""A report in a browser: one cursor for all that moves, from disk, with the network off, whatever names it holds."""

import pytest

from linkplan.studies.compare.compare import compare
from linkplan.studies.compare.tracking_result import tracking_result
from linkplan.studies.output.document import Axis, Bar, Bars, Checklist, Plot, Section, Series, Span
from linkplan.studies.output.lines import TIME
from linkplan.studies.output.plan_sections import plan_report
from linkplan.studies.output.report_file import report_of, write_report
from tests.support.bodies import QUARTER_TURN, body_plan
from tests.support.browser import Opened, chromium, violations
from tests.support.mechanisms import replaced
from tests.support.plans import optimal
from tests.support.reports import blocks

pytestmark = pytest.mark.slow
HOSTILE = "</script><img src=x onerror='window.hurt=1'>"
ESCAPED = HOSTILE.replace("<", "&lt;").replace(">", "&gt;")
MODEL = """<mujoco><option gravity="0 0 0"/><worldbody><body name="arm"><joint name="J" type="hinge" axis="0 1 0"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-5 5"/></actuator></mujoco>"""
# An instant is shown to so many seconds: rounding, and a sample's width of the plots.
INSTANT = 2e-3
# What a sheet of A4 has room for between its margins [px].
PAPER = 703


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Return the page of a comparison on the knee's reach."""
    place = tmp_path_factory.mktemp("page") / "report.html"
    write_report(tracking_result(compare(optimal("knee-reach"), None)).document(), place)
    return place


def times(opened) -> list[float]:
    """Return the instants that the legends of all plots over time show."""
    heads = [
        head for head in opened.page.locator(".u-legend .u-series:first-child").all() if "time [s]" in head.inner_text()
    ]
    return [float(head.locator(".u-value").inner_text()) for head in heads]


def cursor(opened) -> float:
    return opened.ask("Cursor.active.time")


def picture(opened) -> str:
    return opened.ask("document.querySelector('canvas.stage').toDataURL()")


def test_it_opens_from_disk_without_the_network_and_without_a_word(browser, path):
    opened = Opened(browser, path).build()
    assert opened.page.locator(".uplot").count() > 10
    assert opened.asked == [path.as_uri()]
    assert opened.errors == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_readers_with_a_screen_reader_or_weak_eyes_can_use_it(browser, path, scheme):
    opened = Opened(browser, path, scheme=scheme).build()
    assert violations(opened.page) == []


def test_a_rule_that_is_broken_is_found(browser, path):
    """The check itself: a picture without a text is found."""
    opened = Opened(browser, path)
    opened.ask("() => document.querySelector('main').append(new Image(9, 9))")
    assert [one.split(":")[0] for one in violations(opened.page)] == ["image-alt"]


def test_pointing_at_one_plot_moves_all_and_the_mechanism(browser, path):
    opened = Opened(browser, path).build()
    before, drawn = times(opened), picture(opened)
    assert len(before) > 8
    assert set(before) == {0.0}
    plot = opened.page.locator(".uplot .u-over").first
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    opened.page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 0.5 * box["height"])
    opened.settle()
    assert cursor(opened) == pytest.approx(0.04, abs=INSTANT)
    assert times(opened) == pytest.approx([0.04] * len(before), abs=INSTANT)
    assert picture(opened) != drawn
    opened.page.mouse.move(2, 2)
    opened.settle()
    assert times(opened) == pytest.approx([0.04] * len(before), abs=INSTANT)  # it stays there


def test_it_plays_and_pauses_by_button_and_by_key(browser, path):
    opened = Opened(browser, path).build()
    drawn = picture(opened)
    opened.page.locator("button.play").first.click()
    looked = "(look) => Cursor.active.time > 0.005 ? done() : requestAnimationFrame(() => look(look))"
    opened.ask(f"new Promise((done) => {{ const look = {looked}; look(look); }})")
    assert picture(opened) != drawn
    opened.page.locator("h1").click()
    opened.page.keyboard.press(" ")
    opened.settle()
    at = cursor(opened)
    opened.settle()
    assert cursor(opened) == at
    opened.page.keyboard.press("ArrowRight")
    opened.settle()
    assert at < cursor(opened) < at + 0.01


def test_a_line_of_the_checklist_moves_the_cursor_to_its_instant(browser, path):
    (checklist,) = blocks(plan_report(optimal("knee-reach")), Checklist)
    item = next(item for item in checklist.items if item.instant_s and 0.03 < item.instant_s < 0.15)
    opened = Opened(browser, path).build()
    opened.page.get_by_role("row").filter(has_text=item.label).first.click()
    opened.settle()
    assert cursor(opened) == pytest.approx(item.instant_s)
    assert times(opened) == pytest.approx([item.instant_s] * len(times(opened)), abs=INSTANT)


def painted(opened, colour: str) -> int:
    """Return how many pixels of the first animation are filled as shapes of a colour of the style sheet are."""
    opened.page.locator(".controls input[type=checkbox]").first.uncheck()
    return opened.ask(
        """(name) => { const stage = document.querySelector('canvas.stage');
        const want = blended(theme.colour(name), theme.colour('paper'), 0.45).match(/[0-9]+/g).map(Number);
        const all = stage.getContext('2d').getImageData(0, 0, stage.width, stage.height).data;
        let n = 0;
        for (let k = 0; k < all.length; k += 4) n += want.every((x, i) => Math.abs(all[k + i] - x) < 3) && all[k + 3] > 250;
        return n; }""",
        colour,
    )


def test_the_shank_and_the_links_are_solid(browser, tmp_path):
    write_report(plan_report(optimal("knee-reach")), tmp_path / "knee.html")
    opened = Opened(browser, tmp_path / "knee.html").build()
    shown = opened.ask("SHOW && document.querySelectorAll('.lead .facts dt').length")
    assert shown == 4  # peak effort, least margin, duration, objective
    assert opened.page.locator(".lead .stage").bounding_box()["y"] < 400
    assert painted(opened, "payload") > 2000  # a rod of more than 200 px by more than 10
    assert painted(opened, "c0") > 200


def test_a_folded_section_holds_the_deeper_sections_after_it(browser, tmp_path):
    line = Plot(title="p", group="", x_axis=TIME, y_axis=TIME, x=[0, 1], series=[Series(name="s", y=[0, 1])])
    sections = [
        Section(title="outer", blocks=[line], folded=True),
        Section(title="inner", blocks=[line], depth=2),
        Section(title="next", blocks=[line]),
    ]
    write_report(report_of("folded", "", None, sections), tmp_path / "folded.html")
    opened = Opened(browser, tmp_path / "folded.html")
    assert not opened.page.get_by_role("heading", name="inner").is_visible()
    assert opened.page.get_by_role("heading", name="next").is_visible()
    assert opened.page.locator("nav a").all_inner_texts() == ["outer", "next"]
    opened.page.get_by_role("link", name="outer").click()
    opened.page.get_by_role("heading", name="inner").wait_for()  # visible, once the address has changed


@pytest.mark.parametrize("width", [400, 700, 1400])
def test_nothing_is_wider_than_the_window(browser, path, width):
    opened = Opened(browser, path, width=width).build()
    assert opened.ask("document.documentElement.scrollWidth - innerWidth") <= 0
    wide = opened.ask("[...document.querySelectorAll('.uplot, canvas.stage')].map((x) => x.getBoundingClientRect().right)")
    assert max(wide) <= width


def test_the_switch_and_the_system_choose_light_or_dark(browser, path):
    opened = Opened(browser, path, scheme="dark")
    colour = "getComputedStyle(document.body).backgroundColor"
    dark = opened.ask(colour)
    opened.page.locator("button.theme").click()
    assert opened.ask(colour) == "rgb(255, 255, 255)" != dark


def test_what_is_printed_is_whole_and_without_controls(browser, path):
    opened = Opened(browser, path)
    opened.ask("dispatchEvent(new Event('beforeprint'))")
    opened.page.emulate_media(media="print")
    opened.settle()
    assert opened.page.locator(".uplot").count() > 10
    assert not opened.page.locator("nav").is_visible()
    assert not opened.page.locator(".controls").first.is_visible()
    assert opened.errors == []


def test_plots_far_below_the_window_are_drawn_without_scrolling(browser, path):
    opened = Opened(browser, path)
    opened.page.locator(".uplot").nth(10).wait_for(state="attached")
    lowest = opened.ask("Math.max(...[...document.querySelectorAll('.uplot')].map((x) => x.getBoundingClientRect().top))")
    assert lowest > 3 * 900
    assert opened.ask("scrollY") == 0
    assert opened.errors == []


def test_a_folded_section_opens_from_the_contents_and_is_open_on_paper(browser, tmp_path):
    line = Plot(title="p", group="", x_axis=TIME, y_axis=TIME, x=[0, 1], series=[Series(name="s", y=[0, 1])])
    sections = [Section(title="first", blocks=[line]), Section(title="folded away", blocks=[line], folded=True)]
    write_report(report_of("folded", "", None, sections), tmp_path / "folded.html")
    opened = Opened(browser, tmp_path / "folded.html")
    assert not opened.page.locator("details figure").is_visible()
    opened.page.get_by_role("link", name="folded away").click()
    opened.page.locator("details .uplot").wait_for()
    again = Opened(browser, tmp_path / "folded.html")
    again.page.locator(".uplot").wait_for()
    assert again.page.locator("details .uplot").count() == 0  # it is not built before it is opened or printed
    again.ask("dispatchEvent(new Event('beforeprint'))")
    assert again.page.locator("details figure").is_visible()
    assert again.page.locator("details .uplot").count() == 1
    again.ask("dispatchEvent(new Event('afterprint'))")
    assert not again.page.locator("details figure").is_visible()
    assert opened.errors == again.errors == []


def test_what_is_drawn_is_no_wider_than_the_paper(browser, path):
    opened = Opened(browser, path).build()
    wide = "Math.max(...[...document.querySelectorAll('.uplot, canvas.stage')].map((x) => x.getBoundingClientRect().right))"
    assert opened.ask(wide) > PAPER
    opened.ask("dispatchEvent(new Event('beforeprint'))")
    assert opened.ask(wide) <= PAPER
    opened.ask("dispatchEvent(new Event('afterprint'))")
    opened.settle()
    assert opened.ask(wide) > PAPER


def test_the_mechanism_is_drawn_to_the_width_that_it_has_on_paper(browser, tmp_path):
    write_report(plan_report(optimal("knee-reach")), tmp_path / "plan.html")
    opened = Opened(browser, tmp_path / "plan.html")
    assert opened.page.locator(".lead canvas.stage").count() == 1
    opened.build()
    size = "(({ width, height }) => width / height)(document.querySelector('canvas.stage').getBoundingClientRect())"
    opened.ask("dispatchEvent(new Event('beforeprint'))")
    drawn = opened.ask(size)
    opened.page.emulate_media(media="print")
    opened.page.set_viewport_size({"width": PAPER, "height": 990})
    assert opened.ask(size) == pytest.approx(drawn, rel=0.05)
    assert opened.ask("getComputedStyle(document.querySelector('canvas.stage')).objectFit") == "contain"


def test_the_arc_is_the_effort_that_the_shown_ghost_s_tracker_applied(browser, path):
    opened = Opened(browser, path).build()
    opened.ask("Cursor.active.move(0.08)")
    opened.settle()
    said = opened.page.locator(".efforts").first
    as_pd = said.inner_text()
    assert "planned" in as_pd
    opened.page.locator("select[aria-label=ghost]").select_option("lqr")
    as_lqr = said.inner_text()
    assert as_lqr.split(" of ")[0] != as_pd.split(" of ")[0]
    assert as_lqr.split("planned")[1] == as_pd.split("planned")[1]
    opened.page.locator("select[aria-label=ghost]").select_option("")
    assert "planned" not in said.inner_text()


def test_bars_stand_where_their_figures_are(browser, tmp_path):
    axis = Axis(label="part", unit="deg")
    rows = [
        Bar(label="a", spans=[Span(name="n", start=0.0, end=1.0)]),
        Bar(label="b", spans=[Span(name="n", start=1.0, end=4.0)]),
    ]
    chart = Bars(title="bars", axis=axis, rows=rows)
    write_report(report_of("bars", "", None, [Section(title="s", blocks=[chart])]), tmp_path / "bars.html")
    opened = Opened(browser, tmp_path / "bars.html", width=400)
    one, other = (bar.bounding_box() for bar in opened.page.locator(".track .bar").all())
    assert other["width"] == pytest.approx(3 * one["width"], abs=1)
    assert other["x"] == pytest.approx(one["x"] + one["width"], abs=1)
    assert opened.page.get_by_text("part [deg]").is_visible()
    assert opened.errors == []


def test_hostile_names_are_names(browser, tmp_path):
    model = replaced(replaced(MODEL, 'name="J"', f'name="{ESCAPED}"'), 'joint="J"', f'joint="{ESCAPED}"')
    model = replaced(replaced(model, 'name="m"', f'name="m{ESCAPED}"'), 'name="arm"', f'name="{ESCAPED}"')
    key = '"' + HOSTILE + '"'
    plan = body_plan(model, QUARTER_TURN.replace("J =", f"{key} =") + "duration_s = 1.5\n")
    assert plan.status == "optimal", plan.message
    write_report(plan_report(plan), tmp_path / "hostile.html")
    opened = Opened(browser, tmp_path / "hostile.html").build()
    opened.page.locator(".controls input[type=checkbox]").first.check()
    assert opened.ask("window.hurt") is None
    assert opened.page.locator("img").count() == 0
    assert opened.page.get_by_text(HOSTILE).count() > 3
    assert opened.errors == []


def test_a_page_in_space_turns_by_dragging(browser, tmp_path):
    model = """<mujoco><worldbody><body name="upper"><joint name="a" axis="0 0 1"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/><body name="lower" pos="0.3 0 0"><joint name="b" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0.2 0 0.1"
    size="0.02"/></body></body></worldbody><option gravity="0 0 0"/><actuator><motor name="ma" joint="a" ctrlrange="-9 9"/>
    <motor name="mb" joint="b" ctrlrange="-9 9"/></actuator></mujoco>"""
    motion = 'kind = "reach"\nstart_deg = { a = 0.0, b = 0.0 }\ngoal_deg = { a = 90.0, b = 60.0 }\nduration_s = 1.0\n'
    plan = body_plan(model, motion)
    assert plan.status == "optimal", plan.message
    write_report(plan_report(plan), tmp_path / "space.html")
    opened = Opened(browser, tmp_path / "space.html").build()
    drawn = picture(opened)
    box = opened.page.locator("canvas.stage").bounding_box()
    opened.page.mouse.move(box["x"] + 100, box["y"] + 100)
    opened.page.mouse.down()
    opened.page.mouse.move(box["x"] + 180, box["y"] + 120, steps=4)
    opened.page.mouse.up()
    assert picture(opened) != drawn
    assert opened.errors == []
