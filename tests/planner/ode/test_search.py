"""Guesses for a differential equation: a motion as a guess, other durations, perturbed ones and constant efforts."""

import numpy as np
import pytest

from linkplan.planner.ode.problem import CompletedGuess, OdeProblem
from linkplan.planner.ode.search import integrated, of_other_durations, perturbed, sampled_guess, with_smallest_efforts
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
