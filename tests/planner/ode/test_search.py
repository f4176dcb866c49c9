"""Guesses for a differential equation: a motion as a guess, other durations, perturbed ones and constant efforts."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.ode import search
from linkplan.planner.ode.case import OdeCase
from linkplan.planner.ode.formulation import straight_guess, units_of
from linkplan.planner.ode.problem import CompletedGuess, OdeProblem
from linkplan.planner.ode.search import (
    OdeSearch,
    first_solutions,
    integrated,
    of_other_durations,
    perturbed,
    piecewise_constant,
    sampled_guess,
    with_smallest_efforts,
)
from linkplan.planner.ode.solve_ocp import RUNGS, _further_guesses, plan_ode
from linkplan.planner.ode.trajectory import OdeTrajectory
from tests.support.ode import FREE_EFFORT, NAN, squared_effort


def problem_of(duration_s=2.0, **given) -> OdeProblem:
    settings = {"effort_limit": FREE_EFFORT, "running_cost": squared_effort} | given
    return OdeProblem(
        name="one", rate=lambda x, u, p, t: [u[0]], start=[0], goal=[NAN], duration_s=duration_s, **settings  # noqa: ARG005
    )  # fmt: skip


def test_a_motion_as_a_guess_is_the_motion_whenever_it_begins():
    motion = OdeTrajectory(
        breaks_s=np.array([1.0, 2.0, 4.0]), state=np.array([[[0.0], [2.0]], [[2.0], [-4.0]]]),
        effort=np.array([2.0, -3.0])[None, :, None], n_x=1,
    )  # fmt: skip
    guess = sampled_guess(motion)
    share = np.linspace(0.0, 1.0, len(guess.state))
    assert guess.duration_s == 3.0
    assert guess.state[:, 0] == pytest.approx(np.interp(1.0 + 3.0 * share, [1.0, 2.0, 4.0], [0.0, 2.0, -4.0]), abs=1e-12)


@pytest.mark.parametrize(
    ("bounds", "others"), [((0.1, 100.0), [4.0, 16.0, 0.25]), ((0.5, 3.0), [3.0, 0.5]), ((1.0, 10.0), [4.0, 10.0])]
)
def test_a_guess_is_tried_at_other_durations_longer_ones_first_within_their_bounds(bounds, others):
    guess = CompletedGuess(state=np.zeros((2, 1)), effort=np.zeros((2, 1)), duration_s=1.0)
    assert [one.duration_s for one in of_other_durations(problem_of(bounds), guess)] == others


@pytest.mark.parametrize(("limit", "least"), [([-3.0, 4.0], 0.0), ([1.0, 4.0], 1.0), ([-4.0, -2.0], -2.0)])
def test_the_smallest_efforts_are_as_near_to_zero_as_their_limits_allow(limit, least):
    guess = CompletedGuess(state=np.zeros((2, 1)), effort=np.full((2, 1), 9.0), duration_s=1.0)
    found = with_smallest_efforts(problem_of(effort_limit=[limit]), guess)
    assert found.effort == pytest.approx(np.full((2, 1), least))


def test_constant_efforts_lead_where_their_integral_does():
    """From the middle of the range of efforts, and from a tenth of it above the lower limit."""
    guesses = list(integrated(problem_of(effort_limit=[[-3.0, 5.0]])))
    assert [guess.effort[0, 0] for guess in guesses] == pytest.approx([1.0, -2.2])
    for guess in guesses:
        share = np.linspace(0.0, 1.0, len(guess.state))
        assert guess.state[:, 0] == pytest.approx(guess.effort[0, 0] * 2.0 * share, abs=1e-8)


def test_perturbed_guesses_keep_limits_and_bounds_and_are_the_same_in_every_run():
    problem = problem_of((1.0, 2.2), state_limit=[[-1.5, 0.2]], guesses=())
    guess = CompletedGuess(state=np.array([[0.0], [-1.0]]), effort=np.zeros((2, 1)), duration_s=2.0)
    first, again = (list(perturbed(problem, [guess], 6)) for _ in range(2))
    assert first[0] is guess
    for one, other in zip(first[1:], again[1:], strict=True):
        assert np.array_equal(one.state, other.state)
        assert 1.0 <= one.duration_s <= 2.2
        assert one.state.min() >= -1.5
        assert one.state.max() <= 0.2
        line = np.interp(np.linspace(0.0, 1.0, len(one.state)), [0.0, 1.0], [0.0, -1.0])
        assert np.abs(one.state[:, 0] - line).max() > 0.01


def test_a_flat_guess_is_perturbed_by_the_range_of_its_state():
    problem = problem_of(state_limit=[[-3.0, 3.0]])
    flat = CompletedGuess(state=np.zeros((2, 1)), effort=np.zeros((2, 1)), duration_s=2.0)
    for one in list(perturbed(problem, [flat], 4))[1:]:
        assert 0.05 < np.abs(one.state).max() <= 3.0


def test_efforts_held_over_intervals_are_those_next_to_their_beginnings():
    """Where the first of the three nodes of an interval stands: (4 - sqrt(6)) / 10 of it."""
    problem = problem_of()
    case = OdeCase(problem, problem, units_of(problem, straight_guess(problem)))
    motion = OdeTrajectory(
        breaks_s=np.array([1.0, 2.0, 4.0]), state=np.zeros((2, 2, 1)), n_x=1,
        effort=np.array([[[0.0], [10.0]], [[1.0], [20.0]]]),
    )  # fmt: skip
    efforts = piecewise_constant(case, motion).nodes(np.array([1.0, 1.9, 2.0, 3.0, 4.0]))[3]
    share = (4 - np.sqrt(6)) / 10
    assert efforts[:, 0] == pytest.approx([share, share, *[10 + 10 * share] * 3], abs=0.01)


# Which solutions are kept; the solves are not made.


@pytest.mark.parametrize(("starts", "words"), [(1, ["first solve", "start 2"]), (2, ["start 1", "start 2"])])
def test_starts_are_counted_from_one(monkeypatch, starts, words):
    said, problem = [], problem_of()
    problem = replace(problem, solver=replace(problem.solver, starts=starts))
    monkeypatch.setattr(search, "_solved", lambda _p, _g, word, _n: said.append(word))
    first_solutions(problem, [straight_guess(problem)] * 2)
    assert said == words


# The ladder.


@pytest.mark.parametrize(("starts", "several"), [(1, False), (2, True)])
def test_several_starts_are_solved_where_they_are_asked_for_and_guesses_in_turn_elsewhere(starts, several):
    problem = problem_of()
    given = OdeSearch(problem=replace(problem, solver=replace(problem.solver, starts=starts)))
    assert [rung.tried(given) for rung in RUNGS[:2]] == [several, not several]


def test_further_guesses_are_other_durations_and_four_perturbed_ones():
    problem = problem_of((0.01, 1e6))
    guesses = _further_guesses(OdeSearch(problem=problem))
    straight = straight_guess(problem)
    assert len(guesses) == len(of_other_durations(problem, straight)) + 4


@pytest.mark.parametrize(("goal", "asked"), [([3.0, 4.0], "3"), ([-9.0, -2.0], "-2"), ([7.0, 7.0], "7")])
def test_a_goal_beyond_the_limits_is_refused_by_its_value_nearest_to_them(goal, asked):
    problem = OdeProblem(
        name="one", rate=lambda x, u, p, t: [u[0]], start=[0], goal=[goal], duration_s=1.0,  # noqa: ARG005
        effort_limit=FREE_EFFORT, state_limit=[[-1.0, 1.0]], running_cost=squared_effort,
    )  # fmt: skip
    plan = plan_ode(problem)
    assert plan.status == "infeasible"
    assert f"goal asks for state0 = {asked}, beyond its limits -1 to 1" in plan.message
