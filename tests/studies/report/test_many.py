"""Reports of mechanisms with many joints: everything is there, as much at a time as can be told apart."""

import numpy as np
import pytest

from linkplan.planner.search.planning import Price, with_price
from linkplan.studies.compare import comparison_blocks, tracking_sections
from linkplan.studies.compare.compare import compare
from linkplan.studies.output.document import Plot, Table, Text
from linkplan.studies.output.lines import TIME, Line, plots
from linkplan.studies.output.plan_sections import plan_sections
from tests.support.arms import arm
from tests.support.bodies import body_plan
from tests.support.plans import planned

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
    monkeypatch.setattr(tracking_sections, "_MAX_JOINTS_SHOWN", 1)  # as eight joints are to six
    monkeypatch.setattr(comparison_blocks, "MAX_PEAK_COLUMNS", 1)
    motion = 'kind = "reach"\nstart_deg = { J1 = 0.0, J2 = 0.0 }\ngoal_deg = { J1 = 20.0, J2 = 30.0 }\nduration_s = 0.5\n'
    plan = body_plan(arm(0.3, 0.25), motion)
    assert plan.status == "optimal", plan.message
    sections = tracking_sections.comparison_sections(compare(plan, None, asked=("pd",)))
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
