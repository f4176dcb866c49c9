"""Legs along limits on speeds: as quick as an answer that knows nothing of linkplan, each instant at some limit."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.phase_plane.leg_field import AT_FORCE, VelocityCurve
from linkplan.planner.phase_plane.legs_motion import legs_motion
from linkplan.planner.phase_plane.power_legs import power_legs
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import HINGE, HINGE_INERTIA, body_problem
from tests.support.fourbar_problems import random_case

# Random four-bars with a limit on the speed of a joint. The velocity curve of 21 falls faster than full effort brakes and
# rises faster than it accelerates; 152 has a limit on the crank; the least time of 10, near singular poses, was 1.4e-4 late.
DRAWN = ((77, 21), (77, 152), (4243, 10))
# Against the least time from quadrature on a grid.
LEAST_TIME = 1e-6
# A speed or an effort at its limit, as a share of it.
AT_LIMIT = 1e-6
MOTION = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 90.0 }\nduration_s = "free"\n'


def drawn(seed: int, number: int) -> tuple[Problem, float]:
    case = random_case(seed, number)
    motion = case.tables["motion"] | {"duration_s": "free"}
    tables = case.tables | {"motion": motion, "objective": {"minimize": "time"}}
    return Problem.from_tables("four-bar", tables), case.shortest


def hinge(speed_deg_s: float, *settings: str) -> Problem:
    return body_problem(HINGE, MOTION, "objective.minimize=time", f"limits.speed_deg_s.J={speed_deg_s}", *settings)


def always_at_a_limit(problem: Problem) -> float:
    """Plan the legs' motion, check that its certificate passes and that it is always at some limit; return its duration."""
    motion = legs_motion(problem, problem.start_pose())
    certificate = certify(problem, motion)
    assert certificate.passed, certificate.failures
    time = motion.dense_times()
    s, v, u = (of(time)[:, 0] for of in (motion.position_at, motion.velocity_at, motion.effort_at))
    ratio = sampled(problem.mechanism.dynamics.velocity_map, follow(problem.mechanism, s[:, None], problem.start_pose()))
    low, high = problem.limits.speed.T
    speeds = ratio[:, :, 0] * v[:, None]
    fast = np.max(np.where(speeds > 0, speeds / high, speeds / low), axis=1) > 1 - AT_LIMIT
    low, high = problem.limits.effort[0]
    full = (np.abs(u / high - 1) < AT_LIMIT) | (np.abs(u / low - 1) < AT_LIMIT)
    assert np.all(fast | full)
    assert 0.01 < np.mean(fast) < 0.95
    return motion.duration_s


@pytest.mark.parametrize(("seed", "number"), DRAWN)
def test_a_motion_along_its_velocity_curve_passes_takes_the_least_time_and_is_always_at_some_limit(seed, number):
    problem, least = drawn(seed, number)
    assert always_at_a_limit(problem) == pytest.approx(least, rel=LEAST_TIME)


def test_of_three_limited_joints_each_is_at_its_limit_in_turn():
    problem, _ = drawn(77, 21)
    limits = np.array([[-23.7, 23.7], [-16.2, 16.2], problem.limits.speed[2]])
    problem = replace(problem, limits=replace(problem.limits, speed=limits))
    legs, _ = power_legs(problem, problem.start_pose())
    at_o, at_a, at_c = (AT_FORCE + joint for joint in range(3))
    assert [held for leg in legs for _, (held,) in leg.arcs()] == [1, at_c, 1, at_a, at_o, -1, at_c, -1]
    always_at_a_limit(problem)


def test_a_hinge_takes_the_trapezoid_s_time():
    problem = hinge(60.0)
    top, push = np.radians(60.0), float(problem.limits.effort[0, 1]) / HINGE_INERTIA
    motion = legs_motion(problem, problem.start_pose())
    assert motion.duration_s == pytest.approx(np.radians(90.0) / top + top / push, rel=1e-7)


def test_ends_on_the_velocity_curve_are_joined_along_it():
    problem = hinge(60.0, "motion.start_speed_deg_s={J=60}", "motion.goal_speed_deg_s={J=60}")
    legs, boundaries = power_legs(problem, problem.start_pose())
    assert boundaries[-1] == pytest.approx(1.5, rel=1e-7)
    assert {held for leg in legs for _, (held,) in leg.arcs()} == {AT_FORCE}


@pytest.mark.parametrize("end", ["start", "goal"])
def test_an_end_above_the_velocity_curve_has_no_legs(end):
    problem = hinge(60.0, f"motion.{end}_speed_deg_s={{J=59}}")
    assert power_legs(problem, problem.start_pose()) is not None
    slower = replace(problem, limits=replace(problem.limits, speed=np.radians([[-58.0, 58.0]])))
    assert power_legs(slower, problem.start_pose()) is None


def test_a_speed_that_is_never_reached_has_no_legs():
    problem = hinge(1e5)
    assert power_legs(problem, problem.start_pose()) is None


def test_a_direction_that_may_not_be_taken_has_no_legs():
    problem = hinge(60.0)
    still = replace(problem, limits=replace(problem.limits, speed=np.radians([[-60.0, 0.0]])))
    assert power_legs(still, problem.start_pose()) is None


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_velocity_curve_is_that_of_the_joint_nearest_to_its_limit(way):
    """Speeds of -2 v and s v, within -3 and 6, and within -1 and 4: at s = 0.5 the first counts, at s = 3 the second."""

    def curves(s: np.ndarray, order: int = 0) -> np.ndarray:
        s = np.asarray(s, dtype=float)
        rows = [np.full_like(s, -2.0), s] if order == 0 else [np.zeros_like(s), np.ones_like(s)]
        return np.stack(rows, axis=-1)

    curve = VelocityCurve(curves=curves, speed=np.array([[-3.0, 6.0], [-1.0, 4.0]]), way=way)
    top, joint = curve.at(np.array([0.5, 3.0]))
    np.testing.assert_allclose(top, [1.5, 4.0 / 3.0] if way > 0 else [2.0, 1.0 / 3.0])
    np.testing.assert_array_equal(joint, [0, 1] if way > 0 else [1, 1])
    np.testing.assert_allclose(curve.acceleration(3.0, way * 0.5, 1), -(0.5**2) / 3.0)
    np.testing.assert_allclose(curve.acceleration(3.0, way * 0.5, 0), 0.0)


@pytest.mark.slow
def test_a_least_time_along_a_velocity_curve_is_that_of_the_legs():
    problem, least = drawn(4243, 10)
    plan = plan_motion(problem)
    assert plan.status == "optimal", plan.message
    assert plan.solved is None
    assert plan.objective == pytest.approx(least, rel=LEAST_TIME)
