"""Limits that were tightened on coarse meshes are given back on finer ones: what is best touches them."""

import json
from pathlib import Path

import numpy as np
import pytest

from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion

# A five-bar of ten tonnes with two motors, whose pin is not to rise above the higher of its ends by more than 23 mm. Drawn
# at random; rounded, its limit is touched at a node and nothing is tightened.
CRANE = Path(__file__).parents[2] / "data" / "crane-under-a-height.json"
# Its least effort [N2 m2 s] by a collocation of closed forms on 200 intervals of degree 4, all lengths free, that keeps the
# height at its nodes; limits that stayed tightened cost 4.6e-3.
BEST, NEAR = 8.391653e11, 1e-4
# How far from the limit the best motion may stay [m], of 25 m; it stayed 0.7 mm.
TOUCHED_M = 1e-4


@pytest.fixture(scope="module")
def plan() -> Plan:
    tables = json.loads(CRANE.read_text(encoding="utf-8"))
    height = tables["limits"]["site"]["tip"]["z"]
    height[0] = -np.inf
    return plan_motion(Problem.from_tables("crane", tables)).require()


@pytest.mark.slow
def test_a_height_that_is_tightened_between_the_nodes_costs_no_more_than_it_must(plan):
    assert any("tightened" in step.what for step in plan.history)
    assert plan.objective == pytest.approx(BEST, rel=NEAR)


@pytest.mark.slow
def test_the_best_motion_under_a_height_touches_it(plan):
    (height,) = [margin for margin in plan.certificate.margins if margin.what == "site"]
    assert height.left < TOUCHED_M
