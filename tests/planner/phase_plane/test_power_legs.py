"""Legs along limits on power: as exact as they are integrated, whatever the path's parts; none where no power binds."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.phase_plane.power_legs import AT_POWER, power_legs
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.problem import load_problem
from tests.support.least_time import least_time

# The legs' integration, of the least time.
INTEGRATED = 1e-6
# M w = U t in a bang from rest, with what weight and the inertia's change add in 20 ms.
FROM_REST = 0.05


def knee(*settings: str):
    problem = load_problem("knee-sprint", settings)
    return problem, power_legs(problem, problem.start_pose())


@pytest.mark.parametrize("power", ["10", "[-50,400]", "[-1e9,400]"])
def test_legs_take_the_least_time(power):
    problem, (_, boundaries) = knee(f"limits.power_w.act_O={power}")
    assert boundaries[-1] == pytest.approx(least_time(problem), rel=INTEGRATED)


def test_arcs_are_a_bang_the_power_that_is_given_the_one_that_is_taken_back_and_a_bang():
    problem, (legs, _) = knee("limits.power_w.act_O=10")
    arcs = [arc for leg in legs for arc in leg.arcs()]
    assert [held for _, (held,) in arcs] == [1, AT_POWER, -AT_POWER, -1]
    first, ahead = arcs[0][0], legs[0]
    effort, _ = ahead.field.along(*ahead.state(2 * first), np.array([AT_POWER]))
    assert effort.item() * ahead.state(2 * first)[1] == pytest.approx(10.0)
    assert ahead.state(first)[1] == pytest.approx(10.0 / 100.0)
    inertia = problem.mechanism.dynamics.reduced_inertia(problem.start_pose())
    assert first == pytest.approx(float(inertia) * 0.1 / 100.0, rel=FROM_REST)


def test_a_waypoint_on_the_way_is_passed_in_turn_and_changes_nothing():
    problem, (_, straight) = knee("limits.power_w.act_O=400")
    passing = replace(problem, motion=replace(problem.motion, waypoints=(Waypoint(position=[0.0]),)))
    (ahead, back), boundaries = power_legs(passing, passing.start_pose())
    assert boundaries[-1] == straight[-1]
    at = boundaries[1]
    leg = ahead if at < ahead.later + ahead.end else back
    assert leg.state(at - leg.later)[0] == pytest.approx(0.0, abs=INTEGRATED)


def test_speeds_asked_at_the_ends_are_those_of_the_legs():
    _, ((ahead, back), _) = knee(
        "limits.power_w.act_O=400", "motion.start_speed_deg_s={O=50}", "motion.goal_speed_deg_s={O=100}"
    )
    ends = [ahead.state(ahead.begin)[1], back.state(back.end)[1]]
    np.testing.assert_allclose(np.degrees(ends), [50.0, 100.0], atol=1e-6)


def test_where_no_power_is_at_its_limit_there_are_no_such_legs():
    assert knee("limits.power_w.act_O=400")[1] is not None
    assert knee("limits.power_w.act_O=40000")[1] is None


def test_a_way_that_weight_shuts_has_no_such_legs():
    assert knee("limits.power_w.act_O=10", "limits.effort.act_O=[-1, 1]")[1] is None
