"""No time is the least where efforts have no limits: what asks for it on the way to another answer hears of none."""

from linkplan.planner.search.ladder import Search
from linkplan.planner.search.starts import shortest_motion
from tests.support.plans import problem_of


def test_without_effort_limits_there_is_no_shortest_motion():
    """It was asked for, and a least effort of servos without a forcerange was refused for its objective 'time'."""
    problem = problem_of("knee-reach", "limits.effort.act_O=[-inf, inf]")
    search = Search(problem=problem, start_pose=problem.start_pose())
    assert shortest_motion(search) is None
