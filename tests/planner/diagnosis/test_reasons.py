"""Reasons without a motion: what is proved infeasible, and what a known motion or enough effort contradicts."""

from linkplan.models import deadline
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion


def test_a_search_that_runs_out_of_time_names_the_effort_that_the_smooth_path_lacks():
    """A reach of a five-bar with two actuators, too short but not by far."""

    def late(_search):
        deadline._CHILD_TIME.seconds += 1000.0
        raise deadline.OutOfTimeError("late")

    problem = load_problem("five-bar-reach", ["motion.duration_s=0.1", "solver.max_time_s=20"])
    plan = plan_motion(problem, methods=(), diagnoses=(late,))
    assert plan.status == "failed"
    assert "ran out of its 20 s" in plan.message
    assert "along the smooth path from start to goal act_O" in plan.message
    assert "times its limit of" in plan.message
