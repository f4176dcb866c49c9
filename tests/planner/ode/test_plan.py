"""What a plan says of the error of its objective, and of its digits."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.ode.plan import OdePlan, plan_of
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.solvers.solve import SOLVER_TOLERANCE
from tests.support.ode import FREE_EFFORT, NAN, squared_effort

N_INTERVALS = 5


def problem_of(duration_s=2.0) -> OdeProblem:
    return OdeProblem(
        name="one", rate=lambda x, u, p, t: [u[0]], start=[0], goal=[NAN], effort_limit=FREE_EFFORT,  # noqa: ARG005
        duration_s=duration_s, running_cost=squared_effort,
    )  # fmt: skip


def answered(objective: float, moved: float, integrated: float, duration_s=2.0) -> OdePlan:
    """Return the plan of a motion whose objective moved by a share, and that is another one along the integrated state."""
    certificate = SimpleNamespace(
        passed=True, failures=(), integration_error=0.0, integrated_objective=integrated, integration_restarts=0
    )
    motion = SimpleNamespace(breaks_s=np.linspace(0.0, 2.0, N_INTERVALS + 1), duration_s=1.23456789012)
    solution = SimpleNamespace(objective=objective)
    refined = SimpleNamespace(
        certificate=certificate, solution=solution, motion=motion, objective_error=moved, moved=None, settled=True
    )
    return plan_of(problem_of(duration_s), refined)


@pytest.mark.parametrize("objective", [3.0, -3.0])
def test_the_error_of_an_objective_is_ten_times_its_last_change_and_its_distance_from_the_integrated_one(objective):
    assert answered(objective, 1e-4, objective).objective_error == pytest.approx(3.0 * 10 * 1e-4)
    assert answered(objective, 1e-4, objective + 0.5).objective_error == pytest.approx(3.0 * 10 * 1e-4 + 0.5)


def test_an_objective_that_does_not_change_has_the_error_that_the_solver_leaves_in_each_interval():
    assert answered(3.0, 0.0, 3.0).objective_error == pytest.approx(3.0 * SOLVER_TOLERANCE * N_INTERVALS, rel=1e-6)


def test_a_free_duration_has_the_digits_that_the_objective_s_error_leaves_and_a_given_one_all():
    assert answered(np.pi, 1e-5, np.pi, (1.0, 5.0)).message.startswith("optimum 3.142 in 1.2 s")
    assert answered(np.pi, 1e-5, np.pi).message.startswith("optimum 3.142 in 1.23456789 s")
