"""What a plan of a differential equation promises: its objective's tolerance, and the longest time that it takes."""

import itertools
from dataclasses import replace

import pytest

from linkplan.models.deadline import Deadline
from linkplan.models.errors import InfeasibleError
from linkplan.planner.ode.plan import plan_ode
from linkplan.planner.problem.settings import SolverSettings
from tests.support.ode import bryson_denham, robbins, solved


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0.04, 0.13])
def test_the_tolerance_asked_of_the_objective_is_kept_beside_an_arc_along_a_limit(limit):
    assert solved(bryson_denham(limit, 1e-6)).objective == pytest.approx(4 / (9 * limit), rel=1e-6)


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
    with pytest.raises(InfeasibleError, match="was not reached"):
        plan.require()
