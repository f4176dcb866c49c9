"""A plan's deadline in every loop: wherever it passes the command has an answer, and a motion that is known is kept."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.deadline import Deadline, OutOfTimeError
from linkplan.models.poses.assembly import follow
from linkplan.planner.ode.plan import plan_ode
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.ladder import FULL_BUDGET, SearchMethod
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.replan import Replanner
from linkplan.planner.solvers.solve import OF_TIME
from tests.support.ode import robbins

TOO_WEAK = ["limits.effort={ act_O = [-20.0, 20.0] }"]
MANY = ["solver.starts=1000"]
LEGS = ["limits.power_w={ act_O = [-300.0, 300.0] }"]
# Looks at the clock after which there is no time: in the first loops, in starts, in solves, in diagnosis.
LOOKS = (1, 10, 100, 1600)


class Clock:
    """A clock that goes on by a second each time that it is read."""

    reads = 0

    def __call__(self) -> float:
        self.reads += 1
        return float(self.reads)


def timed(problem, looks: float):
    """Return a problem that has time for so many looks at its clock, and the clock."""
    clock = Clock()
    return replace(problem, solver=problem.solver.replace(max_time_s=looks, deadline=Deadline(clock=clock))), clock


def test_a_path_is_not_followed_beyond_its_deadline():
    mechanism = load_problem("knee-reach").mechanism
    path = np.radians(np.linspace(-49.0, 56.0, 50))[:, None]
    assert len(follow(mechanism, path)) == 50
    with pytest.raises(OutOfTimeError):
        follow(mechanism, path, deadline=Deadline().within(-1.0))


@pytest.mark.parametrize("looks", LOOKS)
@pytest.mark.parametrize(
    ("name", "overrides"),
    [("knee-sprint", []), ("knee-reach", TOO_WEAK), ("knee-sprint", LEGS), ("knee-reach", MANY), ("knee-sine", [])],
    ids=["least time", "too weak", "along a power limit", "many starts", "prescribed"],
)
def test_wherever_the_time_ends_there_is_a_plan_that_says_so(name, overrides, looks):
    problem, clock = timed(load_problem(name, overrides), looks)
    plan = plan_motion(problem)
    assert plan.status in ("optimal", "feasible", "infeasible", "failed")
    assert plan.problem is problem
    if plan.status == "failed":
        assert OF_TIME in plan.message
    # What is left of the plan then is no loop: some looks on the way out.
    assert clock.reads < 3 * looks + 300


def test_a_certified_motion_is_kept_when_a_later_rung_runs_out_of_time():
    found = plan_motion(load_problem("knee-reach"))

    def late(*_):
        raise OutOfTimeError("late")

    methods = [
        SearchMethod(name="finds", run=lambda *_: found, budget=FULL_BUDGET),
        SearchMethod(name="late", run=late, budget=FULL_BUDGET),
    ]
    plan = plan_motion(load_problem("knee-reach"), methods=methods)
    assert plan.status == "optimal"
    assert plan.trajectory is found.trajectory


def test_starts_that_were_solved_are_judged_when_the_time_for_further_ones_is_over():
    problem, _ = timed(load_problem("knee-reach", MANY), 1000)
    plan = plan_motion(problem)
    assert plan.passed
    assert 1 <= plan.details["starts_solved"] < 100
    assert OF_TIME in plan.message


@pytest.mark.parametrize("looks", [1, 30, 300])
def test_a_differential_equations_plan_has_an_answer_wherever_its_time_ends(looks):
    """Of Robbins' problem, whose refinement for so many digits takes minutes."""
    problem, clock = timed(robbins(1e-12), looks)
    plan = plan_ode(problem)
    assert plan.status in ("optimal", "feasible", "failed")
    if plan.status == "failed":
        assert OF_TIME in plan.message
    assert clock.reads < 3 * looks + 300


def test_a_planner_gives_a_warm_solve_and_a_plan_from_the_beginning_one_budget():
    planner, problem = Replanner(), load_problem("knee-reach")
    planner.plan(problem).require()
    late, clock = timed(problem, 1)
    late = replace(late, motion=replace(late.motion, goal=np.radians([40.0])))
    assert not planner.plan(late).passed
    assert clock.reads < 30
    assert planner.plan(problem).passed
