"""Pages on feedback loops, and on many joints, actuators and corners."""

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.planner.search.planning import Price, with_price
from linkplan.studies.compare import comparison_blocks, tracking_result
from linkplan.studies.compare.compare import compare
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.output.document import Axis, Plane, Plot, Series, Table, Text
from linkplan.studies.output.lines import TIME, Line, plots
from linkplan.studies.output.plan_blocks import radius_figure
from linkplan.studies.output.plan_sections import plan_sections
from tests.support.arms import arm
from tests.support.bodies import body_plan
from tests.support.plans import planned
from tests.support.reports import blocks

# Digits of a table.
SHOWN = 5e-4


@pytest.fixture(scope="module")
def study():
    knee = load_mechanism("optimus-knee")
    gains = Tracking(kp=200.0, kd=1.0, period_s=1e-4)
    return bode_study(knee, np.radians([[-40.0], [20.0]]), gains, knee.effort_limit, scanned=0)


def test_every_figure_of_the_table_stands_under_its_own_head(study):
    table = blocks(study.document(), Table)[0]
    rows = [dict(zip((head for head, _ in table.columns), row, strict=True)) for row in table.rows]
    for row, entry in zip(rows, study.points, strict=True):
        m = entry
        assert row["phase margin"] == pytest.approx(m.phase_margin_deg, rel=SHOWN)
        assert row["gain margin"] == pytest.approx(m.gain_margin_db, rel=SHOWN)
        assert row["largest pole"] == radius_figure(m.spectral_radius)
        assert row["peak of |S|"] == pytest.approx(m.sensitivity_peak, rel=SHOWN)
        assert row["delay margin"] == pytest.approx(1e3 * m.delay_margin_s, rel=SHOWN)
    assert dict(table.columns)["delay margin"] == "ms"


def test_the_open_loop_s_gain_is_one_at_the_crossover(study):
    plot = next(plot for plot in blocks(study.document(), Plot) if plot.title == "Open loop L: gain")
    sampled = [series for series in plot.series if series.name]
    for series, entry in zip(sampled, study.points, strict=True):
        gain = np.interp(np.log(entry.crossover_hz), np.log(series.x), series.y)
        assert gain == pytest.approx(0.0, abs=0.05)  # [dB], between samples of a thinned curve


def test_the_least_disk_margin_s_disk_is_not_entered(study):
    (plane,) = blocks(study.document(), Plane)
    disk = next(curve for curve in plane.curves if curve.look == "area")
    centre, radius = 0.5 * (max(disk.x) + min(disk.x)), 0.5 * (max(disk.x) - min(disk.x))
    curves = [curve for curve in plane.curves if curve.name.startswith("O = ")]
    assert len(curves) == len(study.points)
    known = [(x, y) for curve in curves for x, y in zip(curve.x, curve.y, strict=True) if x is not None]
    nearest = min(np.hypot(x - centre, y) for x, y in known)
    assert nearest == pytest.approx(radius, rel=0.01)  # it is touched, by the loop whose margin is the least


def test_rows_and_lines_that_do_not_fit_are_refused():
    axis = Axis(label="x", unit="s")
    with pytest.raises(ValueError, match="1 values for 2 columns"):
        Table(title="t", columns=[("a", ""), ("b", "")], rows=[[1]])
    with pytest.raises(ValueError, match="1 values for 2 places"):
        Plot(title="p", group="", x_axis=axis, y_axis=axis, x=[0, 1], series=[Series(name="s", y=[1])])
    with pytest.raises(ValueError, match="1 values for 2 places"):
        Plane(title="p", x_axis=axis, y_axis=axis, curves=[Series(name="c", x=[0, 1], y=[1])])


_PLOTS = (("J", ", desired and tracked"), ("Size of the error of J", ""), ("Effort of act_J", ""))


def test_of_many_lines_each_is_drawn_once_in_one_of_several_plots():
    time = np.linspace(0, 1, 5)
    lines = [Line(name=f"J{k}", values=k * time, unit="deg" if k < 20 else "m") for k in range(23)]
    found = plots("Position", "position", TIME, time, lines)
    assert [[series.name for series in plot.series] for plot in found[-1:]] == [["J20", "J21", "J22"]]
    assert [series.name for plot in found for series in plot.series] == [line.name for line in lines]
    assert max(len(plot.series) for plot in found) <= 9
    assert len({plot.title for plot in found}) == len(found) == 4


def test_every_joint_and_actuator_is_drawn_those_of_the_smaller_figures_folded(monkeypatch):
    monkeypatch.setattr(tracking_result, "_MAX_JOINTS_SHOWN", 1)  # as eight joints are to six
    monkeypatch.setattr(comparison_blocks, "MAX_PEAK_COLUMNS", 1)
    motion = 'kind = "reach"\nstart_deg = { J1 = 0.0, J2 = 0.0 }\ngoal_deg = { J1 = 20.0, J2 = 30.0 }\nduration_s = 0.5\n'
    plan = body_plan(arm(0.3, 0.25), motion)
    assert plan.status == "optimal", plan.message
    sections = tracking_result.comparison_sections(compare(plan, None, asked=("pd",)))
    shown, folded = ([section for section in sections if section.folded == which] for which in (False, True))
    drawn = [[block.title for one in some for block in one.blocks if isinstance(block, Plot)] for some in (shown, folded)]
    assert len(drawn[0]) == len(drawn[1]) == 3
    wanted = {f"{what}{k}{more}" for k in (1, 2) for what, more in _PLOTS}
    assert {*drawn[0], *drawn[1]} == wanted
    peaks = next(block for block in shown[0].blocks if isinstance(block, Table) and block.title.startswith("Peak efforts"))
    assert [row[0] for row in peaks.rows] == ["act_J1", "act_J2"]


@pytest.mark.slow
def test_a_robust_plan_has_its_corners_their_margins_and_its_price():
    plan = planned("knee-sprint", "robust.payload_factor=[0.8, 1.2]", "limits.reserve=0.05")
    price = Price(objective=plan.objective, nominal=0.8 * plan.objective, unit="s", name="time")
    section = next(one for one in plan_sections(with_price(plan, price)) if one.title == "Reserve and corners")
    (table,) = [block for block in section.blocks if isinstance(block, Table)]
    margins = {margin.item: margin for margin in plan.certificate.margins if margin.what == "robust"}
    assert [row[0] for row in table.rows] == ["payload 0.8", "payload 1.2"]
    for item, row in enumerate(table.rows):
        np.testing.assert_allclose(row[3:6], [margins[item].value, margins[item].limit, margins[item].left], atol=1e-3)
    (said,) = [block.text for block in section.blocks if isinstance(block, Text)]
    assert "+25 %" in said
    (plot,) = [block for block in section.blocks if isinstance(block, Plot)]
    heavy = next(series for series in plot.series if series.name == "payload 1.2")
    assert np.max(np.abs(heavy.y)) == np.max(np.abs([limit.value for limit in plot.limits]))


def test_a_plan_without_reserve_or_ranges_has_no_such_section():
    assert not [one for one in plan_sections(planned("knee-sprint")) if one.title == "Reserve and corners"]
