"""The least factor on effort limits of several starts is the least of theirs; one that is at most 1 ends the search."""

import pytest

from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.search import least_limit
from linkplan.planner.search.solving import first_mesh
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_problem


def test_the_least_factor_of_a_pure_inertia_is_exact_once_its_switch_is_known():
    """A quarter turn in T seconds needs 4 I b / T^2 N.m, of the 4 that it has; known from another start it is no other."""
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 0.5\n")
    guess = first_guess(problem, problem.start_pose())
    mesh, durations = first_mesh(problem, guess)
    found = least_limit.least_limit(problem, guess, mesh, durations)
    assert found.factor == pytest.approx(4 * HINGE_INERTIA * TURN / 0.5**2 / 4.0, rel=1e-7)
    assert found.first == pytest.approx(found.factor, rel=1e-2)
    assert found.durations.sum() == pytest.approx(0.5)
    for factor, same in ((1 + 0.9e-7, True), (1 - 0.9e-7, True), (1 + 1.2e-7, False), (1 - 1.2e-7, False)):
        again = least_limit.least_limit(problem, guess, mesh, durations, known=factor * found.first)
        assert (again is None) is same, factor
