"""A plan's motion as a table, in any order and beyond its ends, and its distance from a reference."""

import numpy as np
import pytest

from linkplan.planner.plan.plan import Plan, motion_table, tracking_errors
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem
from tests.support.motions import motion_along

BEGIN = 0.7
BREAKS = BEGIN + np.array([0.0, 0.5, 2.0])


def turning(start: float = 2.0, *, periodic: bool = True) -> Trajectory:
    """Return a hinge's turn at a constant speed over two seconds from 0.7 s on, with efforts of 3 and then 4."""
    s = start + np.pi * (BREAKS - BEGIN)
    return motion_along(BREAKS, [s[:-1], s[1:]], effort=[[[3.0], [4.0]]], periodic=periodic)


def problem() -> Problem:
    return body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n")


@pytest.mark.parametrize("start", [2.0, -0.5])
def test_a_turning_motion_goes_on_before_and_beyond_its_period_in_any_order_of_times(start):
    time = BEGIN + np.array([5.5, 0.0, -0.75, 1.9, 2.0, 0.2])
    table = motion_table(problem(), turning(start), time)
    assert table.position_deg["J"] == pytest.approx(np.degrees(start) + 180.0 * (time - BEGIN))
    assert table.speed_deg_s["J"] == pytest.approx(np.full(6, 180.0))
    assert table.effort["motor"] == pytest.approx([3.0 if (t - BEGIN) % 2.0 < 0.5 - 1e-9 else 4.0 for t in time])


def test_another_motion_rests_at_its_ends():
    table = motion_table(problem(), turning(periodic=False), BEGIN + np.array([-0.7, 1.0, 4.0]))
    assert np.radians(table.position_deg["J"]) == pytest.approx([2.0, 2.0 + np.pi, 2.0 + 2 * np.pi])
    assert table.speed_deg_s["J"] == pytest.approx([0.0, 180.0, 0.0])


def test_default_times_increase_and_a_break_appears_twice_where_jumps_are_shown():
    once, twice = (motion_table(problem(), turning(), jumps=jumps) for jumps in (False, True))
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
    rms, largest = tracking_errors(Plan(problem=along, status="optimal", message="", trajectory=turning()))
    assert largest == pytest.approx(0.5)
    assert rms == pytest.approx(np.sqrt(1.0 / 12.0))  # of 0.5 - t / 4 over 2 s
