"""What a plan of a differential equation promises: its objective's tolerance, its time, and no false "infeasible"."""

import itertools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.deadline import Deadline
from linkplan.models.errors import InfeasibleError
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.solve_ocp import plan_ode
from linkplan.planner.problem.settings import SolverSettings
from tests.support.ode import bryson_denham, duration, robbins, solved


@pytest.mark.slow
@pytest.mark.parametrize("limit", [1 / 9, 0.04, 0.1, 0.13])
def test_the_tolerance_asked_of_the_objective_is_kept_beside_an_arc_along_a_limit(limit):
    assert solved(bryson_denham(limit, 1e-6)).objective == pytest.approx(4 / (9 * limit), rel=1e-6)


def test_an_objective_that_has_not_settled_is_feasible_and_said_with_what_it_changed_by():
    plan = plan_ode(replace(robbins(1e-12), solver=SolverSettings(max_time_s=8)))
    assert plan.certificate.passed
    assert plan.status == "feasible"
    assert "failed" not in plan.message
    assert "objective_tolerance = 1e-12 was not reached" in plan.message
    assert "changed by" in plan.message
    with pytest.raises(InfeasibleError, match="was not reached"):
        plan.require()


def swing_up(limit: float = 0.5) -> OdeProblem:
    """Return the least-time swing-up of a pendulum whose torque is half its weight's moment."""
    return OdeProblem(
        name="swing-up",
        rate=lambda x, u, p, t: [x[1], u[0] - ca.sin(x[0])],  # noqa: ARG005
        start=[0, 0],
        goal=[np.pi, 0],
        effort_limit=[[-limit, limit]],
        duration_s=(0.5, 10),
        final_cost=duration,
    )


def test_the_longest_time_bounds_a_whole_plan():
    """The refinement for so many digits takes minutes."""
    looks = itertools.count()  # a clock that goes on by a second each time that it is read: each solve reads it often
    deadline = Deadline(clock=lambda: float(next(looks)))
    problem = replace(robbins(1e-12), solver=SolverSettings(max_time_s=100, deadline=deadline))
    plan = plan_ode(problem)
    assert plan.problem is problem
    assert plan.status == "feasible"
    assert "the plan ran out of its 100 s" in plan.message
    assert next(looks) < 200
