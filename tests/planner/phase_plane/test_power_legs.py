"""Legs along limits on power: as exact as they are integrated, whatever the path's parts; none where no power binds."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.closed_chain.case import held_arcs_of
from linkplan.planner.phase_plane.power_legs import power_guess
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.solving import mesh_along_power
from tests.support.least_time import least_time

# The legs' integration, of the least time.
INTEGRATED = 1e-6
# Efforts along an interval of a graded mesh change by no more than this factor.
HALVED = 2.5
# M w = U t in a bang from rest, with what weight and the inertia's change add in 20 ms.
FROM_REST = 0.05


def knee(*settings: str):
    problem = load_problem("knee-sprint", settings)
    return problem, power_guess(problem, problem.start_pose())


@pytest.mark.parametrize("power", ["10", "[-50,400]", "[-1e9,400]"])
def test_legs_take_the_least_time(power):
    problem, guess = knee(f"limits.power_w.act_O={power}")
    assert guess.duration_s == pytest.approx(least_time(problem), rel=INTEGRATED)


def test_arcs_are_a_bang_the_power_that_is_given_the_one_that_is_taken_back_and_a_bang():
    problem, guess = knee("limits.power_w.act_O=10")
    np.testing.assert_array_equal(guess.power_arcs.ravel(), [0, 1, -1, 0])
    np.testing.assert_array_equal(guess.bang_efforts.ravel(), [100.0, np.nan, np.nan, -100.0])
    first = guess.switch_times_s[0]
    assert guess.effort(np.array([0.5 * first])) == 100.0
    assert (guess.effort(np.array([2 * first])) * guess.velocity(np.array([2 * first]))).item() == pytest.approx(10.0)
    assert guess.velocity(np.array([first])).item() == pytest.approx(10.0 / 100.0)
    inertia = problem.mechanism.dynamics.reduced_inertia(guess.start_pose)
    assert first == pytest.approx(float(inertia) * 0.1 / 100.0, rel=FROM_REST)


def test_a_waypoint_on_the_way_is_passed_in_turn_and_changes_nothing():
    problem, straight = knee("limits.power_w.act_O=400")
    passing = replace(problem, motion=replace(problem.motion, waypoints=(Waypoint(position=[0.0]),)))
    guess = power_guess(passing, passing.start_pose())
    assert guess.duration_s == straight.duration_s
    assert guess.position(guess.boundaries_s).ravel() == pytest.approx(
        [problem.motion.start[0], 0.0, problem.motion.goal[0]], abs=INTEGRATED
    )
    mesh, durations = mesh_along_power(guess, 20)
    assert mesh.n_phases == 2
    assert durations.sum() == pytest.approx(guess.duration_s)
    assert len(held_arcs_of(passing, guess).paths) == mesh.n_segments == 5


def test_speeds_asked_at_the_ends_are_those_of_the_legs():
    _, guess = knee("limits.power_w.act_O=400", "motion.start_speed_deg_s={O=50}", "motion.goal_speed_deg_s={O=100}")
    ends = guess.velocity(np.array([0.0, guess.duration_s])).ravel()
    np.testing.assert_allclose(np.degrees(ends), [50.0, 100.0], atol=1e-6)


def test_where_no_power_is_at_its_limit_there_are_no_such_legs():
    assert knee("limits.power_w.act_O=400")[1] is not None
    assert knee("limits.power_w.act_O=40000")[1] is None


def test_a_way_that_weight_shuts_has_no_such_legs():
    assert knee("limits.power_w.act_O=10", "limits.effort.act_O=[-1, 1]")[1] is None


def test_a_mesh_along_power_has_an_interval_for_each_halving_of_the_effort():
    _, guess = knee("limits.power_w.act_O=10")
    mesh, durations = mesh_along_power(guess, 5)
    breaks, on_power = mesh.breaks(durations), guess.power_arcs[mesh.segment, 0] != 0
    begin, end = (
        np.abs(guess.effort(breaks[at] + inside).ravel()) for at, inside in ((slice(-1), 1e-12), (slice(1, None), -1e-12))
    )
    assert begin.max() / begin[on_power].min() > 4  # the effort falls by far more than that along the motion
    assert np.abs(np.log(end / begin)[on_power]).max() < np.log(HALVED)
