"""What a plan of a differential equation promises: the longest time that it takes."""

import itertools
from dataclasses import replace

import pytest

from linkplan.models.deadline import Deadline
from linkplan.models.errors import PlanError
from linkplan.planner.ode.plan import plan_ode
from linkplan.planner.problem.settings import SolverSettings
from tests.support.ode import robbins


def test_the_longest_time_bounds_a_whole_plan_whose_objective_has_not_settled():
    """The refinement for so many digits takes minutes."""
    looks = itertools.count()  # a clock that goes on by a second each time that it is read: each solve reads it often
    deadline = Deadline(clock=lambda: float(next(looks)))
    problem = replace(robbins(1e-12), solver=SolverSettings(max_time_s=400, deadline=deadline))
    plan = plan_ode(problem)
    assert next(looks) < 800
    assert plan.problem is problem
    assert plan.certificate.passed
    assert plan.status == "feasible"
    assert "failed" not in plan.message
    assert "objective_tolerance = 1e-12 was not reached" in plan.message
    assert "changed by" in plan.message
    assert "the plan ran out of its 400 s" in plan.message
    with pytest.raises(PlanError, match="was not reached"):
        plan.require()
