"""A platform on six rods, whose loops close together: J_z of 18 dependent joints is one block."""

import pytest

from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support.hexapod import hexapod


@pytest.mark.long
def test_a_platform_on_six_rods_is_raised_and_turned():
    goal = {f"s{k}": 0.03 + 0.02 * (-1) ** k for k in range(6)}
    ends = {"start_m": {f"s{k}": 0.0 for k in range(6)}, "goal_m": goal}
    plan = plan_motion(Problem.reach(hexapod(), **ends, duration_s=0.5, mesh={"intervals": 10}))
    assert plan.status == "optimal", plan.message
