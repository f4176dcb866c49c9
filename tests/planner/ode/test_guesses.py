"""What a guess lacks, its duration and efforts; and which rows a formulation has where no node stands."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.ode.formulation import _open_end_path, guesses_of, units_of
from linkplan.planner.ode.problem import OdeProblem, StateGuess
from linkplan.planner.transcription.collocation import Curves
from tests.support.ode import squared_effort


def problem(duration: object, effort_limit: list[list[float]], *guesses: StateGuess) -> OdeProblem:
    return OdeProblem(
        name="straight",
        rate=lambda x, u, p, t: [u[0]],  # noqa: ARG005
        start=[0],
        goal=[1],
        effort_limit=effort_limit,
        duration_s=duration,
        final_cost=lambda x0, xT, T, p: T,  # noqa: ARG005
        guesses=guesses,
    )


def completed(duration: object, effort_limit: list[list[float]], **guess) -> Curves:
    """Return the motion of a guess, with what it lacks."""
    return guesses_of(problem(duration, effort_limit, StateGuess(**guess)))[0]


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
    line = guesses_of(replace(problem(1.0, [[-1.0, 1.0]]), start=start))[-1]
    assert line.state_at(np.array([0.0, 1.0]))[:, 0] == pytest.approx(ends)


@pytest.mark.parametrize(
    ("limit", "guessed", "unit"),
    [([-4.0, 3.0], 0.0, 4.0), ([-4.0, 3.0], 0.5, 0.5), ([-4.0, 3.0], 7.0, 4.0), ([-np.inf, np.inf], 7.0, 7.0)],
)
def test_the_unit_of_an_effort_is_the_guess_s_within_the_limits(limit, guessed, unit):
    guess = completed(1.0, [limit], state=[[0.0], [0.5], [1.0]], effort=np.full((3, 1), guessed))
    assert units_of(problem(1.0, [limit]), guess).effort == pytest.approx([unit])


def test_rows_where_no_node_stands_are_those_of_inequalities_with_an_effort():
    """At an end without a node the effort jumps; a state does not, and equalities are the nodes' own."""
    asked = OdeProblem(
        name="rows",
        rate=lambda x, u, p, t: [u[0]],  # noqa: ARG005
        start=[0],
        goal=[1],
        effort_limit=[[-1.0, 1.0]],
        duration_s=1.0,
        path=lambda x, u, p, t: [x[0], x[0] * u[0], u[0] - x[0]],  # noqa: ARG005
        path_limit=[[-1.0, 2.0], [-0.5, 0.5], [0.0, 0.0]],
        running_cost=squared_effort,
    )
    assert _open_end_path(asked) == (1,)
