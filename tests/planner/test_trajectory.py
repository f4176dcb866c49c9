"""Trajectories and sampled plans within and beyond their ends, and the distance from a reference."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.plan.plan import Plan, motion_table, tracking_errors
from linkplan.planner.plan.verdict import Verdict
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem
from tests.support.motions import motion_along

BREAKS = np.array([1.0, 1.5, 3.0])
TURN = 2 * np.pi


def accelerated() -> Trajectory:
    """Return s = (t - 1) + (t - 1)^2 with v = 1 + 2 (t - 1), and an effort of 3 and then 4."""
    t, h = BREAKS - 1.0, np.diff(BREAKS)
    s, v = t + t**2, 1.0 + 2 * t
    return motion_along(BREAKS, [s[:-1], s[:-1] + h * v[:-1] / 2, s[1:]], effort=[[[3.0], [4.0]]])


def turning() -> Trajectory:
    """Return a turn at a constant speed from 1 s to 3 s, again and again."""
    s = TURN * (BREAKS - 1.0) / 2.0
    return motion_along(BREAKS, [s[:-1], s[1:]], effort=[[[3.0], [4.0]]], periodic=True)


def test_within_its_ends_a_motion_is_its_polynomials():
    motion, time = accelerated(), np.array([1.0, 1.2, 1.5, 2.9, 3.0])
    t = time - 1.0
    np.testing.assert_allclose(motion.position_at(time)[:, 0], t + t**2)
    np.testing.assert_allclose(motion.velocity_at(time)[:, 0], 1 + 2 * t)
    np.testing.assert_allclose(motion.slope_at(time)[:, 0], 1 + 2 * t)
    np.testing.assert_allclose(motion.acceleration_at(time)[:, 0], 2.0)
    assert motion.effort_at(time)[:, 0].tolist() == [3.0, 3.0, 4.0, 4.0, 4.0]


def test_beyond_its_ends_a_motion_rests_under_the_effort_of_the_nearer_end():
    motion, time = accelerated(), np.array([0.0, 0.99, 3.01, 9.0])
    assert motion.position_at(time)[:, 0].tolist() == [0.0, 0.0, 6.0, 6.0]
    assert not motion.velocity_at(time).any()
    assert not motion.acceleration_at(time).any()
    assert motion.effort_at(time)[:, 0].tolist() == [3.0, 3.0, 4.0, 4.0]


def test_a_periodic_motion_goes_on_with_its_turns_on_both_sides():
    motion, time = turning(), np.array([-3.5, 0.5, 1.0, 2.0, 3.5, 7.25])
    assert motion.advance == pytest.approx(TURN)
    assert motion.periods_at(time).tolist() == [-3, -1, 0, 0, 1, 3]
    np.testing.assert_allclose(motion.position_at(time)[:, 0], TURN * (time - 1.0) / 2.0)
    np.testing.assert_allclose(motion.velocity_at(time)[:, 0], TURN / 2.0)


def test_dense_times_have_both_sides_of_every_break():
    time = accelerated().dense_times(2)
    np.testing.assert_allclose(time, [1.0, 1.25, 1.5, 1.5, 2.25, 3.0])
    assert time[2] < 1.5 <= time[3]


@pytest.mark.parametrize("start", [-2.0, 0.0, 5.0])
def test_a_turn_advances_by_a_turn_wherever_it_begins(start):
    motion = turning()
    begun = replace(motion, position=motion.position + start, start_pose=np.full(1, start))
    assert begun.advance == pytest.approx([TURN])
    assert begun.position_at(np.array([0.0, 1.0, 5.0]))[:, 0] == pytest.approx(start + TURN * np.array([-0.5, 0.0, 2.0]))
    assert replace(begun, periodic=False).advance.tolist() == [0.0]


def test_a_period_that_begins_at_any_time_is_repeated_from_there():
    motion = replace(turning(), breaks_s=BREAKS - 0.3)
    time = 0.7 + np.array([-1.2, 0.2, 2.4, 5.0])
    assert motion.position_at(time)[:, 0] == pytest.approx(TURN * (time - 0.7) / 2.0)
    assert motion.effort_at(time)[:, 0].tolist() == [4.0 if (t - 0.7) % 2 > 0.5 else 3.0 for t in time]


@pytest.mark.parametrize(("beyond_s", "moves"), [(3e-13, True), (3e-11, False)])
def test_a_short_motion_still_moves_at_its_ends_but_for_rounding(beyond_s, moves):
    motion = replace(accelerated(), breaks_s=0.01 * BREAKS)
    at = np.array([motion.breaks_s[0] - beyond_s, motion.breaks_s[-1] + beyond_s])
    assert (motion.velocity_at(at) != 0).all() == moves


BEGIN = 0.7
PLAN_BREAKS = BEGIN + np.array([0.0, 0.5, 2.0])


def turning_plan(start: float = 2.0, *, periodic: bool = True) -> Trajectory:
    """Return a hinge's turn at a constant speed over two seconds from 0.7 s on, with efforts of 3 and then 4."""
    s = start + np.pi * (PLAN_BREAKS - BEGIN)
    return motion_along(PLAN_BREAKS, [s[:-1], s[1:]], effort=[[[3.0], [4.0]]], periodic=periodic)


def problem() -> Problem:
    return body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n")


@pytest.mark.parametrize("start", [2.0, -0.5])
def test_a_turning_motion_goes_on_before_and_beyond_its_period_in_any_order_of_times(start):
    time = BEGIN + np.array([5.5, 0.0, -0.75, 1.9, 2.0, 0.2])
    table = motion_table(problem(), turning_plan(start), time)
    assert table.position_deg["J"] == pytest.approx(np.degrees(start) + 180.0 * (time - BEGIN))
    assert table.speed_deg_s["J"] == pytest.approx(np.full(6, 180.0))
    assert table.effort["motor"] == pytest.approx([3.0 if (t - BEGIN) % 2.0 < 0.5 - 1e-9 else 4.0 for t in time])


def test_another_motion_rests_at_its_ends():
    table = motion_table(problem(), turning_plan(periodic=False), BEGIN + np.array([-0.7, 1.0, 4.0]))
    assert np.radians(table.position_deg["J"]) == pytest.approx([2.0, 2.0 + np.pi, 2.0 + 2 * np.pi])
    assert table.speed_deg_s["J"] == pytest.approx([0.0, 180.0, 0.0])


def test_default_times_increase_and_a_break_appears_twice_where_jumps_are_shown():
    once, twice = (motion_table(problem(), turning_plan(), jumps=jumps) for jumps in (False, True))
    assert once.time_s == pytest.approx([*(BEGIN + 0.05 * np.arange(10)), *(BEGIN + 0.5 + 0.15 * np.arange(11))], abs=1e-9)
    assert np.all(np.diff(once.time_s) > 1e-3)
    assert len(twice.time_s) == len(once.time_s) + 1
    assert np.diff(twice.effort["motor"]).max() == 1.0


def test_the_distance_from_a_reference_is_its_mean_square_and_its_largest():
    """A motion at 2 + pi t beside a reference at 1.5 + (pi + 0.25) t is off by up to half a radian.

    The mean is over time: the second interval is three times as long as the first.
    """
    rows = f"time_s = [0.0, 2.0]\nposition_deg = {{ J = {np.degrees([1.5, 2.0 + 2 * np.pi]).tolist()} }}\n"
    along = body_problem(HINGE, f'kind = "track"\n[reference]\nspline = "natural"\n{rows}')
    rms, largest = tracking_errors(Plan(problem=along, verdict=Verdict(kind="optimal", words=""), trajectory=turning_plan()))
    assert largest == pytest.approx(0.5)
    assert rms == pytest.approx(np.sqrt(1.0 / 12.0))  # of 0.5 - t / 4 over 2 s
