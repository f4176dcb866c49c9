"""A user's function that is not a finite number makes `solve_ocp` fail with its name."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import linkplan
from linkplan.planner.ode.certificate import certify_ode

CART = linkplan.OdeProblem(
    name="cart",
    rate=lambda x, u, p, t: [x[1], u[0]],  # noqa: ARG005
    start=[0, 0],
    goal=[1, 0],
    effort_limit=[[-1, 1]],
    duration_s=3.0,
    running_cost=lambda x, u, p, t: u[0] ** 2,  # noqa: ARG005
)


def outside(x, u, p, t):
    del u, p, t
    return ca.sqrt(0.5 - x[0])


def at_ends(start, end, duration_s, p):
    del start, end, p
    return ca.log(-duration_s)


CASES = {
    "running_cost": ({"running_cost": outside}, "running_cost is not finite (NaN) at t = "),
    "path": ({"path": outside, "path_limit": [[-9, 9]]}, "path is not finite (NaN) at t = "),
    "rate": ({"rate": lambda x, u, p, t: [x[1], u[0] + outside(x, u, p, t)]}, "rate is not finite (NaN) at t = "),
    "final_cost": ({"final_cost": at_ends}, "final_cost is not finite (NaN)"),
    "ends": ({"ends": at_ends, "ends_limit": [[-9, 9]]}, "ends is not finite (NaN)"),
}


@pytest.fixture(scope="module")
def plain():
    return linkplan.solve_ocp(CART).require()


@pytest.mark.parametrize(("changes", "said"), CASES.values(), ids=CASES)
def test_a_solution_fails_and_the_function_is_named(changes, said):
    plan = linkplan.solve_ocp(replace(CART, **changes))
    assert plan.status == "failed"
    assert plan.objective is None
    assert said in plan.message


@pytest.mark.parametrize(("changes", "said"), CASES.values(), ids=CASES)
def test_a_certificate_names_the_function(plain, changes, said):
    certificate = certify_ode(replace(CART, **changes), plain.trajectory)
    assert any(said in failure for failure in certificate.failures), certificate.failures


def test_a_path_that_is_not_finite_between_two_nodes_does_not_pass(plain):
    time = plain.trajectory.times_at(np.array([0.37]))[3]
    place = float(plain.trajectory.state_at(np.array([time]))[0, 0])
    narrow = replace(CART, path=lambda x, u, p, t: ca.sqrt((x[0] - place) ** 2 - 1e-4), path_limit=[[-9, 9]])  # noqa: ARG005
    assert not certify_ode(narrow, plain.trajectory).passed
