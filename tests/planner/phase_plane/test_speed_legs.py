"""Least times along limits on speed, power and a torque-speed line, and the motions of such legs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.phase_plane.leg_field import VelocityCurve
from linkplan.planner.phase_plane.legs_motion import legs_motion
from linkplan.planner.phase_plane.power_legs import power_legs
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search import starts
from linkplan.planner.search.planning import SEARCH_METHODS, plan_motion, search_for
from tests.support.bodies import HINGE, HINGE_INERTIA, body_problem
from tests.support.fourbar_problems import random_case
from tests.support.least_time import least_time

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
    problem = problem.varied(limits=replace(problem.limits, speed=limits))
    legs, _ = power_legs(problem, problem.start_pose())
    at_o, at_a, at_c = (legs[0].field.at_speed + joint for joint in range(3))
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
    assert {held for leg in legs for _, (held,) in leg.arcs()} == {legs[0].field.at_speed}


@pytest.mark.parametrize("end", ["start", "goal"])
def test_an_end_above_the_velocity_curve_has_no_legs(end):
    problem = hinge(60.0, f"motion.{end}_speed_deg_s={{J=59}}")
    assert power_legs(problem, problem.start_pose()) is not None
    slower = problem.varied(limits=replace(problem.limits, speed=np.radians([[-58.0, 58.0]])))
    assert power_legs(slower, problem.start_pose()) is None


def test_a_speed_that_is_never_reached_has_no_legs():
    problem = hinge(1e5)
    assert power_legs(problem, problem.start_pose()) is None


def test_a_direction_that_may_not_be_taken_has_no_legs():
    problem = hinge(60.0)
    still = problem.varied(limits=replace(problem.limits, speed=np.radians([[-60.0, 0.0]])))
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


# A panel that a slow motor tilts: inertia about its axis, weight out of the axis, a damper.
PANEL = """
<mujoco><worldbody><body name="panel"><joint name="tilt" axis="0 1 0" range="-60 60" damping="20"/>
  <inertial mass="40" pos="0.05 0 0.02" diaginertia="8 6 12"/></body></worldbody>
<actuator><motor name="m" joint="tilt" ctrlrange="-80 80"/></actuator></mujoco>
"""
INERTIA, DAMPING, LIMIT, STALL = 6 + 40 * (0.05**2 + 0.02**2), 20.0, 80.0, 100.0
WEIGHT = 40 * 9.81
ENDS = np.radians([-45.0, 45.0])
# The share of every limit that is left for polynomials, and the oracle's own error.
LATE = 2e-8


def falls(s: float) -> float:
    """Return the torque of the weight [N.m]."""
    return WEIGHT * (0.05 * np.cos(s) + 0.02 * np.sin(s))


def exact(no_load: float) -> float:
    """Return the least time [s]: of full driving torque, then of full braking torque from where their speeds meet."""

    def forth(_, y):
        return [y[1], (min(LIMIT, STALL * (1 - y[1] / no_load)) - DAMPING * y[1] + falls(y[0])) / INERTIA]

    def back(_, y):
        return [-y[1], -(max(-LIMIT, -STALL * (1 + y[1] / no_load)) - DAMPING * y[1] + falls(y[0])) / INERTIA]

    def arrived(_, y):
        return y[0] - ENDS[1]

    def fast(_, y):
        return y[1] - 1.5 * no_load

    def returned(_, y):
        return y[0] - ENDS[0]

    arrived.terminal = fast.terminal = returned.terminal = True
    span, settings = (0.0, 10.0 + 40.0 / no_load), {"method": "Radau", "rtol": 1e-11, "atol": 1e-14, "dense_output": True}
    first = solve_ivp(forth, span, [ENDS[0], 0.0], events=arrived, **settings)
    last = solve_ivp(back, span, [ENDS[1], 0.0], events=[fast, returned], **settings)

    def passed(s):
        if s <= ENDS[0] or s >= first.y[0, -1]:
            return 0.0 if s <= ENDS[0] else first.t[-1]
        return brentq(lambda t: first.sol(t)[0] - s, 0.0, first.t[-1], xtol=1e-15)

    def ahead(t):
        s, v = last.sol(t)
        return v - first.sol(passed(s))[1]

    t = brentq(ahead, 1e-9 * last.t[-1], last.t[-1], xtol=1e-15)
    return t + passed(last.sol(t)[0])


def tilted(no_load_deg_s: float, **changes: object) -> Plan:
    """Return the plan of the least time."""
    start, goal = np.degrees(ENDS)
    given = {"start_deg": {"tilt": start}, "goal_deg": {"tilt": goal}, "duration_s": "free", "minimize": "time"}
    motors = {"m": {"stall_effort": STALL, "no_load_speed_deg_s": no_load_deg_s}}
    return plan_motion(Problem.reach(PANEL, **given | {"motors": motors} | changes))


@pytest.mark.parametrize("no_load_deg_s", [1000.0, 30.0, 15.0, 8.0, 0.1])
def test_the_least_time_of_a_motor_is_that_of_its_exact_motion(no_load_deg_s):
    plan = tilted(no_load_deg_s)
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(exact(np.radians(no_load_deg_s)), rel=LATE)


def test_along_a_line_the_motor_gives_no_more_than_its_line_and_no_less_where_it_drives():
    plan = tilted(10.0)
    time = plan.trajectory.dense_times(20)
    used = plan.trajectory.effort_at(time)[:, 0] / STALL + plan.trajectory.velocity_at(time)[:, 0] / np.radians(10.0)
    assert used.max() <= 1 + 1e-12
    driven = (time > 0.5) & (time < 0.99 * plan.objective)
    np.testing.assert_allclose(used[driven], 1.0, rtol=LATE)


def test_a_slow_speed_limit_costs_the_way_over_it_and_the_gathering_of_speed():
    """900 s at 0.1 deg/s; to gather and lose that speed takes thousandths of a second."""
    plan = tilted(1e6, limits={"speed_deg_s": {"tilt": 0.1}})
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(900.0, rel=1e-6)
    assert plan.objective > 900.0


# What is left of limits for what polynomials do between their nodes, of the least time; and of the power along its limit.
ROOM = 1e-7
# What the legs' curves over the way differ from the mechanism by, of the largest effort.
SAME_LAW = 1e-7


def within(watts: float):
    return load_problem("knee-sprint", [f"limits.power_w.act_O={watts}"])


def test_its_certificate_passes_and_it_takes_the_least_time():
    problem = within(100.0)
    motion = legs_motion(problem, problem.start_pose())
    certificate = certify(problem, motion)
    assert certificate.passed, certificate.failures
    assert certificate.dynamics_residual < SAME_LAW * np.abs(motion.effort).max()
    assert motion.duration_s == pytest.approx(least_time(problem), rel=ROOM)


def test_power_is_at_its_limit_all_along_but_for_bangs():
    problem = within(10.0)
    motion = legs_motion(problem, problem.start_pose())
    time = motion.dense_times(20)
    effort, power = motion.effort_at(time), motion.effort_at(time) * motion.velocity_at(time)
    spent = np.isclose(np.abs(power), 10.0, rtol=ROOM)
    assert np.all(spent | np.isclose(np.abs(effort), 100.0, rtol=ROOM))
    assert np.mean(spent) > 0.9


def test_a_waypoint_on_the_way_is_passed_at_a_break():
    problem = within(100.0)
    passing = problem.varied(motion=replace(problem.motion, waypoints=(Waypoint(position=[0.0]),)))
    certificate = certify(passing, legs_motion(passing, passing.start_pose()))
    assert certificate.passed, certificate.failures


@pytest.mark.parametrize("place", [-0.8, 0.9])
def test_of_either_leg_a_waypoint_s_instant_is_a_break(place):
    """From -0.86 to 0.98 rad, the legs' switch lies between."""
    problem = within(100.0)
    passing = problem.varied(motion=replace(problem.motion, waypoints=(Waypoint(position=[place]),)))
    motion, straight = (legs_motion(one, one.start_pose()) for one in (passing, problem))
    breaks = motion.position_at(motion.breaks_s)[:, 0]
    assert np.abs(breaks - place).min() < 1e-9
    assert np.abs(straight.position_at(straight.breaks_s)[:, 0] - place).min() > 1e-6
    assert motion.duration_s == pytest.approx(straight.duration_s, rel=ROOM)


@pytest.mark.slow
def test_a_least_time_is_that_of_the_legs():
    problem = within(10.0)
    plan = plan_motion(problem, methods=SEARCH_METHODS[:1])
    assert plan.status == "optimal", plan.message
    assert plan.solved is None
    assert plan.scheme == f"radau-{len(plan.trajectory.effort)}"  # that of its polynomials, not the problem's
    assert plan.objective == pytest.approx(least_time(problem), rel=ROOM)


@pytest.mark.slow
def test_a_limit_that_the_legs_do_not_know_forbids_them():
    for further, passes in (([], True), (["limits.effort_rate.act_O=1e6"], False)):
        problem = load_problem("knee-sprint", ["limits.power_w.act_O=100", *further])
        search = search_for(problem)
        assert (starts.along_limits(search, SEARCH_METHODS[0].budget) is not None) == passes
