"""Units, guesses and starts of a differential equation's problem, from what the user gave."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.ode.case import OdeCase, case_of, guesses_of
from linkplan.planner.ode.problem import OdeProblem, StateGuess
from linkplan.planner.transcription.collocation import Curves
from linkplan.planner.transcription.formulation import Units
from tests.support.ode import INF, NAN, squared_effort

T = 2.0


def chain(n: int = 1, **given) -> OdeProblem:
    """Return a problem of n states that one effort moves."""
    settings = {
        "start": [0.0] * n, "goal": [NAN] * n, "effort_limit": [[-INF, INF]], "duration_s": T,
        "running_cost": squared_effort,
    }  # fmt: skip
    return OdeProblem(name="chain", rate=lambda x, u, p, t: [u[0]] * n, **settings | given)  # noqa: ARG005


def units(state: np.ndarray, effort: np.ndarray, **given) -> Units:
    """Return the units for a guess of states (n, n_x) and efforts (n, 1)."""
    problem = chain(np.shape(state)[1], **given, guesses=[StateGuess(state=state, effort=effort)])
    return case_of(problem, guesses_of(problem)[0]).units


@pytest.mark.parametrize(
    ("what", "expected", "given", "guess"),
    [
        ("the larger of its ends", 4.0, {"start": [-1.0], "goal": [4.0]}, [0.0, 0.5]),
        ("the larger end, the first", 3.0, {"start": [-3.0], "goal": [1.0]}, [0.0, 0.0]),
        ("the guess beyond its ends", 5.0, {"start": [1.0], "goal": [2.0]}, [1.0, -5.0]),
        ("the range of its limits", 6.0, {"start": [0.0], "state_limit": [[-2.0, 4.0]]}, [0.0, 0.0]),
        ("one, without any number", 1.0, {"start": [0.0]}, [0.0, 0.0]),
        ("a small number", 3e-8, {"start": [3e-8]}, [0.0, 0.0]),
        ("one, where a number is rounding", 1.0, {"start": [3e-9]}, [0.0, 0.0]),
    ],
)
def test_the_unit_of_a_state_is(what, expected, given, guess):
    del what
    assert units(np.array(guess)[:, None], np.zeros((2, 1)), **given).state == pytest.approx([expected])


@pytest.mark.parametrize(
    ("limit", "guess", "expected"),
    [
        ([-10.0, 4.0], [1.0, -2.0], 2.0),
        ([-10.0, 4.0], [0.0, 0.0], 10.0),
        ([-10.0, 4.0], [30.0, 0.0], 10.0),
        ([-INF, INF], [1.0, -2.0], 2.0),
        ([-INF, INF], [0.0, 0.0], 1.0),
        ([-INF, 7.0], [0.0, 0.0], 7.0),
        ([-10.0, 4.0], [3e-8, 0.0], 3e-8),
    ],
)
def test_the_unit_of_an_effort_is_of_its_guess_within_its_limits(limit, guess, expected):
    found = units(np.zeros((2, 1)), np.array(guess)[:, None], effort_limit=[limit])
    assert found.effort == pytest.approx([expected])


@pytest.mark.parametrize(
    ("guess", "given", "expected"),
    [
        ([3.0, 3.0], {}, T * 9.0),
        ([0.0, 2.0, 4.0], {}, T * (0 + 4 + 16) / 3),  # the mean of three instants
        ([0.0, 0.0], {"effort_limit": [[-5.0, 5.0]]}, T * 25.0),
        ([3.0, 3.0], {"final_cost": lambda x0, xT, T, p: -5.0 * T}, T * 9.0 + 5 * T),  # noqa: ARG005
        ([3.0, 3.0], {"running_cost": lambda x, u, p, t: 1e-12 * u[0]}, 1.0),  # noqa: ARG005
        ([3.0, 3.0], {"running_cost": lambda x, u, p, t: 1e-6 * u[0]}, T * 3e-6),  # noqa: ARG005
    ],
)
def test_the_unit_of_the_objective_is_the_cost_of_the_guess(guess, given, expected):
    found = units(np.zeros((len(guess), 1)), np.array(guess)[:, None], **given)
    assert found.objective == pytest.approx(expected)


def timed() -> OdeProblem:
    return chain(running_cost=lambda x, u, p, t: t * u[0] ** 2, final_cost=lambda x0, xT, T, p: xT[0] * T)  # noqa: ARG005


def test_time_is_a_state_of_its_own_where_something_depends_on_it():
    """Its unit is the duration; starts carry it, and the rate of time is one."""
    given = [StateGuess(state=[[0.0], [6.0]], effort=np.ones((2, 1)))]
    for problem, is_timed in ((replace(timed(), guesses=given), True), (chain(guesses=given), False)):
        guess = guesses_of(problem)[0]
        case = case_of(problem, guess)
        assert case.units.state == pytest.approx([6.0, T] if is_timed else [6.0])
        start, at = case.start_from(guess), np.array([0.5, 1.5])
        clock = [[0.25], [0.75]] if is_timed else np.zeros((2, 0))
        assert start.states(at) == pytest.approx(np.hstack([[[0.25], [0.75]], clock]))
        assert start.nodes(at)[1] == pytest.approx(np.ones((2, 1 + is_timed)))


def test_the_cost_of_the_ends_is_that_of_the_states_without_their_clock():
    problem = timed()
    found = Units(time_s=T, state=np.array([3.0, T]), effort=np.ones(1), objective=10.0)
    ends = OdeCase(problem, found).formulation().endpoint
    assert ends.function.size1_in(0) == ends.function.size1_in(1) == 2
    # x(T) = 2 * 3, in a duration of 1.5 * 2.
    assert float(ends.function([0.0, 0.0], [2.0, 1.0], 1.5, [])) == pytest.approx(6.0 * 3.0 / 10.0)


def completed(duration: object, effort_limit: list[list[float]], **guess) -> Curves:
    """Return the motion of a guess, completed where the guess has no values."""
    problem = chain(goal=[1.0], duration_s=duration, effort_limit=effort_limit, guesses=[StateGuess(**guess)])
    return guesses_of(problem)[0]


@pytest.mark.parametrize(
    ("bounds", "given", "duration"),
    [
        ((0.0, np.inf), None, 1.0),
        ((3.0, np.inf), None, 3.0),
        ((0.0, 0.5), None, 0.5),
        ((2.0, 6.0), None, 4.0),
        ((0.001, 6.0), None, 1.0),
        ((2.0, 6.0), 2.5, 2.5),
        ((2.0, 6.0), 9.0, 6.0),
        (0.7, 2.0, 0.7),
    ],
)
def test_a_guess_lasts_as_long_as_it_says_and_may_and_else_a_second_or_the_middle(bounds, given, duration):
    guess = completed(bounds, [[-1.0, 1.0]], state=[[0.0], [1.0]], duration_s=given)
    assert guess.duration_s == pytest.approx(duration, rel=1e-12)


@pytest.mark.parametrize(
    ("limit", "effort"), [([-1.0, 3.0], 1.0), ([-np.inf, 3.0], 3.0), ([-2.0, np.inf], -2.0), ([-np.inf, np.inf], 0.0)]
)
def test_an_effort_that_a_guess_lacks_is_the_middle_of_its_limits_or_their_finite_end(limit, effort):
    guess = completed(1.0, [limit], state=[[0.0], [0.5], [1.0]])
    assert guess.effort_at(np.array([0.0, 0.7, 1.0])) == pytest.approx(np.full((3, 1), effort))


@pytest.mark.parametrize(("state", "effort"), [([0.0, 4.0, 0.0], [1.0, 3.0]), ([0.0, 4.0, 0.0], [1.0, 5.0, 0.0, 3.0, 3.0])])
def test_a_guess_is_straight_between_its_rows_of_states_and_of_efforts(state, effort):
    guess = completed(2.0, [[-9.0, 9.0]], state=np.array(state)[:, None], effort=np.array(effort)[:, None])
    time = 2.0 * np.linspace(0.0, 1.0, 5)
    assert guess.state_at(time)[:, 0] == pytest.approx(np.interp(time, np.linspace(0.0, 2.0, len(state)), state))
    assert guess.effort_at(time)[:, 0] == pytest.approx(np.interp(time, np.linspace(0.0, 2.0, len(effort)), effort))


@pytest.mark.parametrize(
    ("start", "ends"), [([np.nan], (1.0, 1.0)), ([[0.0, 0.5]], (0.25, 1.0)), ([[-np.inf, 0.5]], (0.5, 1.0))]
)
def test_the_straight_line_begins_in_the_middle_of_the_start_or_at_the_goal_if_the_start_is_free(start, ends):
    line = guesses_of(chain(start=start, goal=[1.0], duration_s=1.0))[-1]
    assert line.state_at(np.array([0.0, 1.0]))[:, 0] == pytest.approx(ends)


def test_rows_where_no_node_stands_are_those_of_inequalities_with_an_effort():
    """At an end without a node the effort jumps; a state does not, and equalities are the nodes' own."""
    asked = chain(
        effort_limit=[[-1.0, 1.0]],
        path=lambda x, u, p, t: [x[0], x[0] * u[0], u[0] - x[0]],  # noqa: ARG005
        path_limit=[[-1.0, 2.0], [-0.5, 0.5], [0.0, 0.0]],
    )
    assert case_of(asked, guesses_of(asked)[0]).formulation().rows.open_end_path == (1,)
