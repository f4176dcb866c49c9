"""Newton steps on programs of one unknown: error bounds, active bounds, violations."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.solvers.newton import Conditions, NewtonStep, Optimum, _sides, _violation, newton_step

WIDE = np.array([1e3])


def steps_to_zero(slope, upper: np.ndarray = WIDE) -> NewtonStep:
    """Return three Newton steps from the root at 1 of slope(x) = slope(1) towards the root at 0 of slope(x) = 0."""
    x, p, lam = ca.MX.sym("x"), ca.MX.sym("p"), ca.MX.sym("lam", 0)
    gradient, none = slope(x) - p, ca.MX(0, 1)
    conditions = Conditions(
        slopes=ca.Function("slopes", [x, p, lam], [gradient, none, ca.jacobian(gradient, x)]),
        gaps=ca.Function("gaps", [x, p, lam], [gradient, none]),
        rows=np.zeros(1, dtype=int),
        columns=np.zeros(1, dtype=int),
    )

    def numbers(target: float, most: np.ndarray) -> SimpleNamespace:
        rows = {"row_lower": np.zeros(0), "row_upper": np.zeros(0)}
        return SimpleNamespace(parameters=np.array([target]), lower=-WIDE, upper=most, **rows)

    begin = Optimum(x=np.ones(1), rows=np.zeros(0), bounds=np.zeros(1))
    return newton_step(conditions, numbers(float(slope(1.0)), WIDE), begin, numbers(0.0, upper), 3)


def test_steps_that_shrink_by_less_than_a_half_give_no_bound():
    """x^3 with the slope at 1: steps of 0.33, 0.099 and 0.061, and 0.51 is left, five times what their ratio promises."""
    found = steps_to_zero(lambda x: x**3)
    assert found.steps == 3
    assert found.optimum.x[0] == pytest.approx(0.507, abs=1e-3)
    assert found.error_bound == np.inf


def test_steps_that_shrink_quickly_bound_what_is_left():
    found = steps_to_zero(lambda x: x + 0.1 * x**2)
    left = abs(found.optimum.x[0])
    assert left > 1e-3
    assert found.error_bound == pytest.approx(left, rel=0.2)


def test_a_program_that_is_quadratic_is_solved_at_once():
    found = steps_to_zero(lambda x: 3.0 * x)
    assert found.steps == 2
    assert found.optimum.x[0] == pytest.approx(0.0, abs=1e-15)
    assert found.error_bound < 1e-15


def test_a_bound_that_the_first_step_violates_is_kept():
    found = steps_to_zero(lambda x: 3.0 * x, upper=np.array([-0.5]))
    assert found.optimum.x[0] == -0.5
    assert found.violation == 0.0


@pytest.mark.parametrize(
    ("value", "multiplier", "side"), [(1.0, 0.3, 1), (-2.0, -0.3, -1), (0.9, 0.0, 0), (-1.9, 0.0, 0), (0.9, 1e-9, 0)]
)
def test_a_bound_is_active_where_its_multiplier_exceeds_the_distance_to_it(value, multiplier, side):
    bounds = np.array([-2.0]), np.array([1.0])
    assert _sides(np.array([value]), np.array([multiplier]), *bounds, *bounds).tolist() == [side]


@pytest.mark.parametrize(("value", "beyond"), [(3.0, 0.0), (1.5, 0.5), (7.0, 2.0)])
def test_a_violation_is_the_distance_to_the_nearer_bound(value, beyond):
    assert _violation(np.array([value]), np.array([2.0]), np.array([5.0])) == beyond
