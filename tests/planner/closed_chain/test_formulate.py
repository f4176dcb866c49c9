"""The program of a mechanism: prescribed coordinates, smoothing, tightened limits, overruns of intervals."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.formulate import _exact_costs, _is_given_with_pose, formulate, free_goal_endpoint
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.mechanics import _row_kind
from linkplan.planner.closed_chain.transcribe import choose_scales
from linkplan.planner.limits.kinds import limits_of
from linkplan.planner.problem.instant import Scales
from linkplan.planner.problem.problem import load_problem
from tests.support.arms import LOWER, UPPER, foot_of
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem
from tests.support.margins import with_margin
from tests.support.plans import optimal, planned
from tests.support.sites import ABOVE, BELOW, arm_of, site_problem


def test_a_motion_ends_where_the_site_is_at_the_place_asked_for():
    motion = {"start_deg": {"J1": 60.0, "J2": 40.0, "J3": 20.0}, "goal_at": {"foot": [0.2, 0.0, -0.3]}, "duration_s": 0.5}
    problem, unit = site_problem(arm_of(0.25, 0.2, 0.15), motion), np.array([2.0, 0.5, 3.0])
    ends, given = free_goal_endpoint(
        problem, Scales(time_s=1.0, position=unit, effort=np.ones(3), residual=np.ones(3), length_m=1.0), 0
    )

    def rows(position: np.ndarray) -> np.ndarray:
        last = np.concatenate([position / unit, np.zeros(3)])
        return np.array(ends.function(np.zeros(6), last, 1.0, given)).ravel()

    assert rows(problem.motion.goal) == pytest.approx(np.zeros(len(given) + 1), abs=1e-9)
    assert np.abs(rows(problem.motion.goal + 0.1)).max() > 1e-2


def test_smoothing_adds_to_the_cost_of_efforts_that_change():
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n")
    scales = choose_scales(problem, first_guess(problem, problem.start_pose()))
    assert set(_exact_costs(problem, scales, None, 2.0, 0.0)) == {"effort"}
    smoothed = _exact_costs(problem, scales, 0.3, 2.0, 0.0)
    assert smoothed["effort_rate"] == pytest.approx([0.3])
    assert smoothed["effort"] == pytest.approx(scales.effort**2 * scales.time_s / 2.0)


def test_a_singular_margin_is_a_row_of_given_poses_too_and_ranges_are_not():
    limits = limits_of(load_problem("knee-reach", ["limits.singular_margin=0.1", "limits.power_w.act_O=500"]))
    given = {limit.key: _is_given_with_pose(limit) for limit in limits}
    assert given == {"effort": False, "position": True, "power": False, "singular_margin": False}
    kinds = {limit.key: _row_kind(limit.facts) for limit in limits}
    assert kinds == {"effort": "effort", "position": "path", "power": "power", "singular_margin": "path"}


@pytest.mark.parametrize("what", ["position", "speed"])
def test_one_joint_beyond_its_range_is_an_overrun(what):
    plan = planned("knee-reach", "limits.speed_deg_s.C=1e4")
    case = case_of(plan.problem)
    assert not case.error_report(plan.certificate).overruns
    assert len(plan.certificate.margins) > 1
    report = case.error_report(with_margin(plan.certificate, what, 2, left=-0.01))
    assert report.overruns
    assert report.leaves_positions == (what == "position")


def test_the_overrun_of_an_interval_is_the_largest_of_all_joints():
    plan = planned("knee-reach")
    first, last = np.zeros((2, len(plan.certificate.growth)))
    first[1], last[2] = 0.3, 0.2
    over = with_margin(plan.certificate, "position", 0, overrun=first)
    report = case_of(plan.problem).error_report(with_margin(over, "position", 2, overrun=last))
    assert report.overrun[[1, 2]] == pytest.approx([0.3, 0.2])


def test_a_range_and_a_speed_are_tightened_by_what_was_overrun():
    plan = optimal("knee-reach", "limits.speed_deg_s.A=1e4")
    n_q, before = plan.problem.mechanism.n_q, plan.problem.limits
    over = with_margin(plan.certificate, "position", 0, left=np.degrees(-0.01))
    over = with_margin(over, "speed", 1, left=np.degrees(-0.2))
    case = case_of(plan.problem)
    first = case.tightened(over, plan.trajectory)
    second = first.tightened(over, plan.trajectory)

    inward = np.array([1.0, -1.0])
    once = first.problem.limits
    assert once.position[0] == pytest.approx(before.position[0] + 1.1 * 0.01 * inward)
    np.testing.assert_array_equal(once.position[1:], before.position[1:])
    np.testing.assert_array_equal(once.speed, before.speed)
    bounded = replace(second, problem=second.problem.varied(limits=replace(once, speed=np.full((n_q, 2), [-9.0, 9.0]))))
    speeds = bounded.tightened(over, plan.trajectory).problem.limits.speed
    assert speeds[1] == pytest.approx([-9.0 + 1.1 * 0.2, 9.0 - 1.1 * 0.2])
    np.testing.assert_array_equal(speeds[[0, 2]], [[-9.0, 9.0], [-9.0, 9.0]])


def test_a_coordinate_is_prescribed_at_the_phase_boundary_of_its_waypoint():
    waypoints = [{"at": {"foot": {"x": 0.4}}, "time_s": 0.2}, {"at": {"foot": {"z": -0.1}}, "time_s": 0.5}]
    motion = {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}, "waypoints": waypoints, "duration_s": 0.6}
    problem = site_problem(arm_of(UPPER, LOWER), motion)
    scales = choose_scales(problem, first_guess(problem, problem.start_pose()))
    formulation = formulate(problem, scales)
    at_home = foot_of(problem.mechanism.home)[0]
    times = [float(formulation.boundaries[boundary].time[0]) * scales.time_s for boundary, _, _ in formulation.passed]
    moves = [value * problem.mechanism.extent_m for _, _, value in formulation.passed]
    assert times == pytest.approx([0.2, 0.5], rel=1e-12)
    assert moves == pytest.approx(np.array([0.4, -0.1]) - at_home[[0, 2]], rel=1e-9)
    assert len({row for _, row, _ in formulation.passed}) == 2
