"""Which starts are worth trying: the phase plane's least time beside the time that is given, on both sides of its error."""

import pytest

from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search import starts
from linkplan.planner.search.starts import with_switch_times
from tests.support.bodies import HINGE, QUARTER_TURN, body_plan, body_problem


def test_a_least_time_plan_is_a_guess_that_knows_its_switch():
    plan = body_plan(HINGE, QUARTER_TURN + 'duration_s = "free"\n', "objective.minimize=time")
    guess = with_switch_times(plan)
    assert guess.switch_times_s == pytest.approx([plan.trajectory.duration_s / 2], rel=1e-6)
    assert not starts.other_limits(body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n"))


@pytest.mark.parametrize(
    ("setting", "others"),
    [("limits.speed_deg_s.O=900", False), ("limits.range_deg.A=[0, 100]", False), ("limits.power_w.act_O=500", True)],
)
def test_the_phase_plane_leaves_out_all_limits_but_those_on_effort_range_and_speed(setting, others):
    assert starts.other_limits(load_problem("knee-reach", [setting])) == others
