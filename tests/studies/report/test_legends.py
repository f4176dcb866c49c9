"""Legends and tables on a page, in a browser: nothing lies on anything else, nothing stands twice, nothing is cut off."""

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.bode.bode_report import bode_report
from linkplan.studies.feedback.frequency.excitation import Setup
from linkplan.studies.output.document import Axis, Plot, Section, Series, Table
from linkplan.studies.output.report_file import report_of, write_report
from tests.support.browser import Opened, chromium

pytestmark = pytest.mark.slow
DOT = "\u25cf"
# Cells of a legend of which one begins before the one to its left ends.
ON_ONE_ANOTHER = """[...document.querySelectorAll('.u-legend .u-series')].flatMap((row) => {
  const texts = [...row.querySelectorAll('.u-label, .u-value')];
  const end = Math.max(...texts.map((text) => text.getBoundingClientRect().right));
  const next = row.nextElementSibling && row.nextElementSibling.getBoundingClientRect();
  const beside = next && Math.abs(next.top - row.getBoundingClientRect().top) < 4;
  return beside && next.left < end - 1 ? [row.innerText] : [];
})"""


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@pytest.mark.parametrize("width", [1400, 400])
def test_a_long_name_of_an_axis_does_not_lie_under_the_first_line_s(browser, tmp_path, width):
    names = ("pd", "pd+ff", "lqr", "lqi", "gs-pd+ff", "ct", "mpc")
    plot = Plot(
        title="Settling",
        group="",
        x_axis=Axis(label="settling into the tube after the motion's end", unit="s"),
        y_axis=Axis(label="machines", unit="%"),
        x=[0.0, 0.1],
        series=[Series(name=name, y=[0.0, 100.0], colour=k) for k, name in enumerate(names)],
    )
    write_report(report_of("Tried", "", None, [Section(title="Figures", blocks=[plot])]), tmp_path / "report.html")
    opened = Opened(browser, tmp_path / "report.html", width=width)
    opened.build()
    assert opened.page.locator(".u-legend .u-series").count() == 8
    assert opened.ask(ON_ONE_ANOTHER) == []


@pytest.mark.parametrize(("rows", "whole"), [(21, True), (200, False)])
def test_a_table_of_some_rows_is_shown_whole_and_a_long_one_in_a_window(browser, tmp_path, rows, whole):
    table = Table(title="Pairs", columns=[("first", ""), ("second", "")], rows=[["pd", k] for k in range(rows)])
    write_report(report_of("Tried", "", None, [Section(title="Pairs", blocks=[table])]), tmp_path / "report.html")
    height, content = Opened(browser, tmp_path / "report.html").ask(
        "(({ clientHeight, scrollHeight }) => [clientHeight, scrollHeight])(document.querySelector('.wide'))"
    )
    assert (height >= content) == whole


def test_what_was_measured_of_a_line_stands_in_the_line_s_own_entry(browser, tmp_path):
    gains, knee = Tracking(kp=200.0, kd=1.0, period_s=1e-4), load_mechanism("optimus-knee")
    at, poses = np.array([20.0, 40.0, 300.0]), np.radians([[-40.0], [20.0]])
    study = bode_study(knee, poses, gains, knee.effort_limit, scanned=0, setup=Setup(), frequency_hz=at)
    write_report(bode_report(study), tmp_path / "report.html")
    opened = Opened(browser, tmp_path / "report.html", width=400)
    opened.build()
    plot = opened.page.locator("figure.plot", has_text="Open loop L: gain; dots measured").first
    entries = plot.locator(".u-series:visible")
    assert entries.locator(".u-label").all_inner_texts() == ["frequency [Hz]", "O = -40 deg", "O = 20 deg"]
    over = plot.locator(".u-over")
    room, said = over.bounding_box(), []
    for share in np.linspace(0.01, 0.99, 80):
        over.hover(position={"x": share * room["width"], "y": 20})
        opened.settle()
        said.append(entries.nth(1).locator(".u-value").inner_text())
    beside = [text.split(DOT) for text in said if DOT in text]
    assert 0 < len(beside) < len(said) / 2  # where a dot is, alone
    for line, dot in beside:
        assert abs(float(line) - float(dot)) < 1.5  # dB: the line falls by so much over six pixels at the most
