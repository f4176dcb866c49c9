"""Newton steps on programs of one or two unknowns: error bounds, active bounds, violations, the nearest feasible point."""

import time
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.solvers.newton import (
    Conditions,
    NewtonStep,
    Optimum,
    _changed,
    _sides,
    _violation,
    nearest_feasible,
    newton_step,
)
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Layout
from tests.support.refinement_states import guessed

WIDE = np.array([1e3])


def program(parameters: np.ndarray, bounds: tuple[np.ndarray, np.ndarray], rows: np.ndarray) -> Transcribed:
    """Return a program with these numbers in place of its own: bounds of the unknowns, and what the rows equal."""
    numbers = {"parameters": parameters, "lower": bounds[0], "upper": bounds[1], "row_lower": rows, "row_upper": rows}
    return replace(guessed(10).found.solution.transcribed, **numbers)


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

    def numbers(target: float, most: np.ndarray) -> Transcribed:
        return program(np.array([target]), (-WIDE, most), np.zeros(0))

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


def moved(gradient, row, begin: Optimum, asked: float, target: float = 0.0, start: float = 0.0) -> NewtonStep:
    """Return Newton steps on grad f = p, g = target, from a point at p = `start` and g = 0; x has the size of `begin`."""
    n = len(begin.x)
    x, p, lam = ca.MX.sym("x", n), ca.MX.sym("p"), ca.MX.sym("lam")
    slope, g = gradient(x, p), row(x)
    J = ca.jacobian(g, x)
    H = ca.jacobian(slope + J.T * lam, x)
    K = ca.densify(ca.blockcat([[H, J.T], [J, ca.MX(1, 1)]]))
    conditions = Conditions(
        slopes=ca.Function("slopes", [x, p, lam], [ca.densify(slope), g, K]),
        gaps=ca.Function("gaps", [x, p, lam], [ca.densify(slope + J.T * lam), g]),
        rows=np.tile(np.arange(n + 1), n + 1),
        columns=np.repeat(np.arange(n + 1), n + 1),
    )

    def numbers(p: float, row: float) -> Transcribed:
        return program(np.array([p]), (np.full(n, -1e3), np.full(n, 1e3)), np.array([row]))

    return newton_step(conditions, numbers(start, 0.0), begin, numbers(asked, target), 3)


def test_an_unknown_that_stays_leaves_the_bound_to_the_one_that_moves():
    """x_0 + 0.1 x_0^2 = p from the root of 1.1 towards that of 0; x_1 = 0 all along."""
    begin = Optimum(x=np.array([1.0, 0.0]), rows=np.zeros(1), bounds=np.zeros(2))
    found = moved(lambda x, p: ca.vertcat(x[0] + 0.1 * x[0] ** 2 - p, 0.0), lambda x: x[1], begin, 0.0, start=1.1)
    assert 1e-3 < abs(found.optimum.x[0]) == pytest.approx(found.error_bound, rel=0.2)


def test_a_multiplier_that_moves_more_than_the_unknown_is_what_the_bound_is_for():
    """x + 100 x^2 = 1e-4 with lambda (1 + 200 x) = p: while x moves by 1e-4, lambda goes from 0 to 1 / sqrt(1.04)."""
    begin = Optimum(x=np.zeros(1), rows=np.zeros(1), bounds=np.zeros(1))
    found = moved(lambda _x, p: -p, lambda x: x + 100.0 * x**2, begin, 1.0, target=1e-4)
    error = abs(found.optimum.rows[0] - 1.0 / np.sqrt(1.04))
    assert error > 1e-5
    assert error <= found.error_bound < 1e-2


def test_the_same_numbers_leave_the_optimum_where_it_is():
    begin = Optimum(x=np.array([1.0]), rows=np.zeros(1), bounds=np.zeros(1))
    found = moved(lambda x, p: x - p, lambda x: 1e-3 * (x - 1.0), begin, 1.0, start=1.0)
    assert (found.optimum.x[0], found.error_bound, found.violation) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("side", "value", "push", "after"),
    [
        (0, 5.0, 0.0, 0),  # at the bound, not beyond it
        (0, 5.0 + 3e-10, 0.0, 0),
        (0, 5.0 + 3e-9, 0.0, 1),
        (0, 2.0, 0.0, 0),
        (0, 2.0 - 3e-10, 0.0, 0),
        (0, 2.0 - 3e-9, 0.0, -1),
        (1, 5.0, -3e-10, 1),
        (1, 5.0, -3e-9, 0),
        (-1, 2.0, 3e-10, -1),
        (-1, 2.0, 3e-9, 0),
        (1, 5.0, 1.0, 1),
        (-1, 2.0, -1.0, -1),
    ],
)
def test_a_bound_becomes_active_where_it_is_violated_and_inactive_where_it_pulls(side, value, push, after):
    bounds = np.array([2.0]), np.array([5.0])
    assert _changed(np.array([side]), np.array([value]), np.array([push]), *bounds).tolist() == [after]
    assert _changed(np.array([1]), np.array([value]), np.array([-1.0]), bounds[0], bounds[0]).tolist() == [1]


@pytest.mark.parametrize(("room", "expected"), [(9.0, [0.5, -1.5]), (0.25, [1.75, -0.25])])
@pytest.mark.parametrize("side", [+1, -1])
@pytest.mark.parametrize("repeated", [1, 2])
def test_the_nearest_feasible_point_leaves_a_bound_inwards_and_stops_at_the_next(side, room, expected, repeated):
    """x_0 + |x|^2 / 2 is least at x_0 = 0.5 with x_0 - side x_1 = 2, given once or twice, if x_1 has so much room."""
    x, p = ca.MX.sym("x", 2), ca.MX.sym("p", 0)
    row = ca.repmat(x[0] - side * x[1], repeated)
    functions = {
        "jac_g": ca.Function("jac_g", [x, p], [row, ca.jacobian(row, x)]),
        "grad_f": ca.Function("grad_f", [x, p], [x[0], ca.vertcat(1.0, 0.0)]),
    }
    layout = Layout(n_s=0, n_z=0, n_u=2, n_nodes=1, n_intervals=1, n_segments=0)
    bounds = sorted([0.0, -side * room])  # begins at a bound
    transcribed = program(np.zeros(0), (np.array([-9.0, bounds[0]]), np.array([9.0, bounds[1]])), np.full(repeated, 2.0))
    units = replace(transcribed.units, objective=3.0)
    transcribed = replace(
        transcribed,
        program=replace(transcribed.program, functions=functions, layout=layout),
        formulation=replace(transcribed.formulation, units=units),
    )
    begin = time.perf_counter()
    found = nearest_feasible(transcribed, np.zeros(2))
    assert 0.0 < found.solve_s <= time.perf_counter() - begin
    assert found.converged
    assert found.x == pytest.approx([expected[0], side * expected[1]], abs=1e-9)
    assert found.objective == pytest.approx(3.0 * found.x[0])
