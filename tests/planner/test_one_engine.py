"""What every search shares: bends, held durations, de Casteljau, integration, ends, words."""

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.certificate.flow import implicit
from linkplan.planner.certificate.integration import relative_violation
from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess, perturbed
from linkplan.planner.problem.limits import exact_bounds
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.solvers.solve import INVALID, OUT_OF_TIME, SUCCEEDED, why_stopped
from linkplan.planner.transcription.bernstein import bernstein_matrix, bernstein_value
from tests.support.tolerances_planner import UNIT

# The cases.


def test_what_a_case_aims_at_follows_from_its_objective():
    quick, cheap = case_of(load_problem("knee-sprint")).target, case_of(load_problem("knee-reach")).target
    assert (quick.switches, quick.bang_bang, quick.continuous_efforts) == (True, True, False)
    assert (cheap.switches, cheap.bang_bang, cheap.continuous_efforts) == (True, False, True)
    assert not case_of(load_problem("knee-reach"), kinks=False).target.switches
    asked = case_of(load_problem("knee-reach", ["mesh.tolerance_deg=1e-4"])).target
    assert asked.tolerance_given
    assert asked.strictness == pytest.approx(100.0)


# Perturbed guesses.


def test_a_perturbed_guess_keeps_the_ends_and_is_the_same_in_every_run():
    problem, span, times = load_problem("knee-reach"), np.array([3.0]), np.linspace(0.0, 0.16, 2001)
    base = first_guess(problem, problem.start_pose())
    moved, again, other, larger = (perturbed(base, number, span) for number in (7, 7, 6, 40))
    np.testing.assert_array_equal(moved.position(times), again.position(times))
    offset, bend = (guess.position(times) - base.position(times) for guess in (moved, larger))
    np.testing.assert_allclose(offset[[0, -1]], 0.0, atol=UNIT)
    assert 0.03 < np.abs(offset).max() < 3.0 < np.abs(bend).max()
    assert not np.allclose(other.position(times), moved.position(times))
    waves = np.sin(np.pi * np.outer(times / 0.16, [1, 2, 3]))
    np.testing.assert_allclose(waves @ np.linalg.lstsq(waves, offset, rcond=None)[0], offset, atol=UNIT)


def test_a_perturbed_guess_moves_at_its_own_speed_and_acceleration():
    problem, times, h = load_problem("knee-reach"), np.linspace(0.01, 0.15, 29), 1e-5
    moved = perturbed(first_guess(problem, problem.start_pose()), 3, np.array([1.0]))
    for value, slope in ((moved.position, moved.velocity), (moved.velocity, moved.acceleration)):
        np.testing.assert_allclose((value(times + h) - value(times - h)) / (2 * h), slope(times), rtol=1e-5, atol=1e-3)


# Free durations.


def test_a_waypoint_at_a_given_instant_does_not_make_a_free_duration_one_without_end():
    waypoint = "motion.waypoints=[{at_deg={O=10}, time_s=0.1}]"
    plan = plan_motion(load_problem("knee-reach", ["objective.minimize=time", "motion.duration_s=free", waypoint]))
    assert plan.status == "optimal", plan.message
    assert plan.trajectory.duration_s > 0.1


# Polynomials, integration, ends, words.


@pytest.mark.parametrize("degree", [0, 1, 4, 9])
def test_de_casteljau_is_the_sum_of_bernstein_polynomials_of_numbers_and_of_symbols(degree):
    coefficients = np.random.default_rng(degree).uniform(-1, 1, (degree + 1, 3))
    symbol = ca.SX.sym("tau")
    symbolic = ca.Function("value", [symbol], [bernstein_value(ca.SX(coefficients), symbol)])
    for tau in (0.0, 0.3, 1.0):
        expected = bernstein_matrix(degree, np.array([tau]))[0] @ coefficients
        np.testing.assert_allclose(bernstein_value(coefficients, tau), expected, atol=UNIT)
        np.testing.assert_allclose(np.array(symbolic(tau))[0], expected, atol=UNIT)


def test_implicit_steps_that_end_within_an_interval_say_so():
    def blows_up(t: float, y: np.ndarray) -> np.ndarray:
        del t
        return y**2  # from 1, infinite at 1 s

    assert implicit(blows_up, 0.9, np.ones(1), np.ones(1))[0, 0] == pytest.approx(10.0)
    assert implicit(blows_up, 1.1, np.ones(1), np.ones(1)) is None


def test_ends_are_missed_by_what_they_are_outside_of_what_is_asked():
    low, high = np.array([0.0, -np.inf]), np.array([1.0, np.inf])
    assert relative_violation(np.array([0.5, 1e9]), (low, high), 1.0) == 0.0
    assert relative_violation(np.array([1.5, 1e9]), (low, high), np.array([2.0, 1.0])) == pytest.approx(0.25)
    assert relative_violation(np.array([-1.0, 0.0]), (low, high), 1.0) == pytest.approx(1.0)
    assert relative_violation(np.array([3.0, 5.0]), exact_bounds(np.array([3.5, np.nan])), 1.0) == pytest.approx(0.5)
    assert relative_violation(
        np.array([3.0, 5.0]), exact_bounds(np.array([3.5, 7.0]), np.array([True, False])), 1.0
    ) == pytest.approx(2.0)


def test_why_a_solver_stopped_is_said_where_it_says_nothing_of_the_problem():
    assert "ran out of its 2.5 s (solver.max_time_s)" in why_stopped(OUT_OF_TIME, 2.5)
    assert "not finite (NaN)" in why_stopped(INVALID, 2.5)
    assert why_stopped(SUCCEEDED, 2.5) is None
    assert why_stopped("Infeasible_Problem_Detected", 2.5) is None
