"""Least times along limits on power and on pin forces: legs of bangs and arcs, against closed forms and MuJoCo."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.tree.friction import TRANSITION
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.samples import closure_forces
from linkplan.planner.phase_plane.bang_bang_motions import parts_of
from linkplan.planner.phase_plane.leg_field import AT_EFFORT, field_along
from linkplan.planner.phase_plane.legs_motion import legs_motion
from linkplan.planner.phase_plane.power_legs import power_legs
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import cart
from tests.support.least_time import curves_of, least_time, least_time_within
from tests.support.sliders import drawn_with_a_pin

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
    assert [held for _, (held,) in arcs] == [1, AT_EFFORT + 1, -(AT_EFFORT + 1), -1]
    first, ahead = arcs[0][0], legs[0]
    effort, _ = ahead.field.along(*ahead.state(2 * first), np.array([AT_EFFORT + 1]))
    assert effort.item() * ahead.state(2 * first)[1] == pytest.approx(10.0)
    assert ahead.state(first)[1] == pytest.approx(10.0 / 100.0)
    inertia = problem.mechanism.dynamics.reduced_inertia(problem.start_pose())
    assert first == pytest.approx(float(inertia) * 0.1 / 100.0, rel=FROM_REST)


def test_a_waypoint_on_the_way_is_passed_in_turn_and_changes_nothing():
    problem, (_, straight) = knee("limits.power_w.act_O=400")
    passing = problem.varied(motion=replace(problem.motion, waypoints=(Waypoint(position=[0.0]),)))
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


@pytest.mark.parametrize("start", [-1.0, 0.0, 1.0])
def test_a_mass_that_is_pushed_and_braked_by_a_power_takes_the_closed_form_s_time_wherever_it_starts(start):
    """Half the way: 6 N up to the speed v = P / F, then m v^2 / 2 grows by the power, and m v^3 / 3 by it times the way."""
    mass, force, power = 2.0, 6.0, 4.0
    ends = {"start_m": {"x": start}, "goal_m": {"x": start + 2.0}}
    problem = Problem.reach(cart(), **ends, minimize="time", limits={"power_w": {"push": power}})
    _, boundaries = power_legs(problem, problem.start_pose())
    v = power / force
    way = mass * v**2 / (2 * force)
    fastest = (v**3 + 3 * power * (1.0 - way) / mass) ** (1 / 3)
    least = 2 * (mass * v / force + mass * (fastest**2 - v**2) / (2 * power))
    assert boundaries[-1] == pytest.approx(least, rel=INTEGRATED)


# A crank of 0.3 m and a slider in a loop, with weight, a damper and dry friction on the crank.
CRANK = """<mujoco><worldbody>
<body><joint name="O" axis="0 1 0" damping="0.4" {friction}/><inertial pos="0.1 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
<body pos="0.3 0 0"><joint name="A" axis="0 1 0"/><inertial pos="0.4 0 0" mass="1" diaginertia="0.05 0.05 0.05"/>
<site name="tip" pos="0.8 0 0"/></body></body>
<body pos="1.1 0 0"><joint name="P" type="slide" axis="1 0 0" {friction}/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<site name="pin"/></body></worldbody>
<equality><connect name="pin" site1="tip" site2="pin"/></equality>
<actuator><motor name="u" joint="{driven}" gear="2" ctrlrange="-60 50"/></actuator></mujoco>"""


def crank(start_deg: float, goal_deg: float, friction: str = "", driven: str = "O", **limits) -> Problem:
    ends = {"start_deg": {"O": start_deg}, "goal_deg": {"O": goal_deg}}
    return Problem.reach(CRANK.format(friction=friction, driven=driven), **ends, minimize="time", limits=limits)


@pytest.mark.parametrize(("start", "goal"), [(20.0, 80.0), (80.0, 20.0)])
@pytest.mark.parametrize("friction", ["", 'frictionloss="1.5"'])
def test_the_field_has_the_mechanism_s_accelerations(start, goal, friction):
    problem = crank(start, goal, friction)
    mechanism, way = problem.mechanism, np.sign(goal - start)
    found = field_along(problem, parts_of(problem.motion)[0], problem.start_pose())
    for place, speed, effort in ((25.0, 0.5, 9.0), (50.0, 3.0, -20.0), (77.0, 7.0, 3.0)):
        s, v, u = np.radians(place), way * speed, np.array([effort])
        pose = close_at(mechanism, np.array([s]))
        exact = float(mechanism.dynamics.acceleration(pose, [v], u))
        inertia, still, square, linear, by = found.curves(s)
        rub = 0.0 if found.friction is None else found.friction(s, v)
        assert (still + square * v**2 + linear * v + by * effort - rub) / inertia == pytest.approx(exact, rel=1e-6)
        assert inertia == pytest.approx(float(mechanism.dynamics.reduced_inertia(pose)))
    assert found.way == way


@pytest.mark.parametrize(("start", "goal"), [(20.0, 80.0), (80.0, 20.0)])
@pytest.mark.parametrize("friction", ["", 'frictionloss="1.5"'])
@pytest.mark.parametrize("driven", ["A", "O"])
def test_the_field_has_the_mechanism_s_pin_forces(start, goal, friction, driven):
    problem = crank(start, goal, friction, driven, closure_force={"pin": 400.0})
    mechanism, way = problem.mechanism, np.sign(goal - start)
    found = field_along(problem, parts_of(problem.motion)[0], problem.start_pose())
    (closure,) = problem.limits.limited_closures
    for place, speed, effort in ((25.0, 0.5, 9.0), (50.0, 3.0, -20.0), (77.0, 7.0, 3.0)):
        s, v, u = np.radians(place), np.array([[way * speed]]), np.array([[effort]])
        pose = close_at(mechanism, np.array([s]))[None]
        a = np.array(mechanism.dynamics.acceleration(pose[0], v[0], u[0])).reshape(1, 1)
        exact = closure_forces(problem, pose, v, a, u)[0, closure] / 400.0
        still, square, linear, by_a, by = found.affine.curves(s)
        force = still + square * v[0, 0] ** 2 + linear * v[0, 0] + by_a * a.item() + by * effort
        force += 0.0 if found.affine.friction is None else found.affine.friction(s, v[0, 0])
        assert (found.affine.friction is None) is (friction == "")
        assert np.linalg.norm(force) / 400.0 == pytest.approx(exact, rel=1e-6)


@pytest.mark.slow
def test_dry_friction_beside_a_limit_on_acceleration_leaves_a_plan_of_legs():
    problem = crank(20.0, 80.0, 'frictionloss="1.5"', acceleration_deg_s2={"A": 3000.0})
    legs, _ = power_legs(problem, problem.start_pose())
    assert all(leg.is_possible() for leg in legs)


def test_a_descent_that_no_effort_brakes_has_no_legs():
    """A hinge that is pulled down to 90 degrees by more than it is held with."""
    rod = """<mujoco><worldbody><body><joint name="J" axis="0 1 0"/>
    <inertial pos="0 0 0.5" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
    <actuator><motor name="u" joint="J" ctrlrange="-{hold} 20"/></actuator></mujoco>"""
    asked = {"start_deg": {"J": 80.0}, "goal_deg": {"J": 100.0}, "minimize": "time", "limits": {"power_w": {"u": 10.0}}}
    for hold, known in ((8.0, True), (4.0, False)):
        problem = Problem.reach(rod.format(hold=hold), **asked)
        assert (power_legs(problem, problem.start_pose()) is not None) is known


def test_parts_that_turn_follow_each_other_in_time():
    """Up to a waypoint at which it turns and back: the legs of each part alone, one after the other."""
    there, back = crank(20.0, 80.0, power_w={"u": 30.0}), crank(80.0, 20.0, power_w={"u": 30.0})
    problem = crank(20.0, 20.001, power_w={"u": 30.0})
    turning = problem.varied(motion=replace(problem.motion, waypoints=(Waypoint(position=np.radians([80.0])),)))
    legs, boundaries = power_legs(turning, turning.start_pose())
    times = [power_legs(one, one.start_pose())[1][-1] for one in (there, back)]
    assert boundaries == pytest.approx([0.0, times[0], sum(times)], rel=1e-4)
    assert [leg.later + leg.begin for leg in legs] == pytest.approx(
        [0.0, legs[0].end, times[0], times[0] + legs[2].end], rel=1e-4
    )


@pytest.mark.parametrize("place", [25.0, 75.0])
def test_a_waypoint_is_passed_on_the_leg_that_it_lies_on(place):
    problem = crank(80.0, 20.0, power_w={"u": 30.0})
    passing = problem.varied(motion=replace(problem.motion, waypoints=(Waypoint(position=np.radians([place])),)))
    legs, (_, at, _) = power_legs(passing, passing.start_pose())
    passes = [leg for leg in legs if leg.begin <= at - leg.later <= leg.end]
    assert [leg.state(at - leg.later)[0] for leg in passes] == pytest.approx([np.radians(place)])


# Against the exact least time, relative.
EXACT = 1e-6
# A force or an effort at its limit, as a share of that.
AT_LIMIT = 1e-6
# Of the random sliders, such as were 4e-3 late and called optimal, and 2e-6 late.
LATE = (3, 7)


def rated(newton: float):
    problem = load_problem("knee-sprint", [f"limits.closure_force.B={newton}"])
    return problem, problem.start_pose()


@pytest.mark.parametrize("number", LATE)
def test_legs_along_a_pin_s_rating_take_the_least_time(number):
    case = drawn_with_a_pin(1, number)
    problem = Problem.from_tables("slider", case.tables)
    legs, boundaries = power_legs(problem, problem.start_pose())
    assert boundaries[-1] == pytest.approx(case.best, rel=INTEGRATED)
    assert any(abs(held) >= leg.field.at_force for leg in legs for _, (held,) in leg.arcs())


@pytest.mark.slow
@pytest.mark.parametrize("number", LATE)
def test_a_least_time_along_a_pins_rating_is_exact(number):
    case = drawn_with_a_pin(1, number)
    plan = plan_motion(Problem.from_tables("slider", case.tables))
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(case.best, rel=EXACT)


def test_a_pin_or_the_effort_is_at_its_limit_at_every_instant_of_the_legs_motion():
    problem, pose = rated(2.5)
    motion = legs_motion(problem, pose)
    certificate = certify(problem, motion)
    assert certificate.passed, certificate.failures
    time = motion.dense_times()
    s, v, a, u = (of(time) for of in (motion.position_at, motion.velocity_at, motion.acceleration_at, motion.effort_at))
    (closure,) = problem.limits.limited_closures
    force = closure_forces(problem, follow(problem.mechanism, s, pose), v, a, u)[:, closure]
    borne, full = np.abs(force / 2.5 - 1.0) < AT_LIMIT, np.abs(np.abs(u[:, 0]) / 100.0 - 1.0) < AT_LIMIT
    assert np.all(borne | full)
    assert np.mean(borne) > 0.1


def test_where_no_pin_is_at_its_rating_there_are_no_such_legs():
    assert power_legs(*rated(2.5)) is not None
    assert power_legs(*rated(1e4)) is None


def test_a_rating_below_what_rest_asks_has_no_such_legs():
    case = drawn_with_a_pin(1, 3)
    tables = case.tables | {"limits": case.tables["limits"] | {"closure_force": {"P": 1e-3}}}
    problem = Problem.from_tables("slider", tables)
    assert power_legs(problem, problem.start_pose()) is None


# An arm with a servo of gain kp on position and kv on speed, through a gear.
ARM = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="q" axis="0 1 0" damping="0.1" frictionloss="{rub}"/>
<inertial mass="1.5" pos="0.3 0 0" diaginertia="0.05 0.05 0.05"/></body></worldbody><actuator><general name="m" joint="q"
gear="{gear}" gainprm="{gain}" biastype="affine" biasprm="0 {kp} {kv}" ctrlrange="-{end} {end}"
forcerange="-{force} {force}"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("gain", "kp", "kv", "gear", "end", "force", "rub"),
    [
        (6, 0, -6, 1, 4, 20, 0),  # a velocity servo
        (6, 0, -6, 1, 4, 20, 1.2),  # with dry friction, which is none at rest
        (30, -30, -4, 1, 1.3, 20, 0),  # a position servo
        (60, -60, -0.5, 1, 0.25, 9, 0),  # all of its range is beyond a force clamp at start and goal
        (-3, 0, -0.5, -2, 2, 9, 0),
    ],
)
def test_along_the_ctrlrange_of_a_servo_a_motion_takes_the_least_time(gain, kp, kv, gear, end, force, rub):
    asked = {"start_deg": {"q": 60.0}, "goal_deg": {"q": -30.0}, "minimize": "time"}
    smooth, problem = (
        Problem.reach(ARM.format(gain=gain, kp=kp, kv=kv, gear=gear, end=end, force=force, rub=f), **asked) for f in (0, rub)
    )
    legs, _ = power_legs(problem, problem.start_pose())
    assert any(abs(held) == AT_EFFORT + 1 for leg in legs for _, (held,) in leg.arcs())

    def within(s: float, v: float) -> tuple[float, float]:
        efforts = np.array([-1, 1]) * abs(gain) * end + gear * (kp * s + kv * v)
        low, high = np.clip(efforts, -force, force) - rub * np.tanh(v / TRANSITION) / gear
        return low, max(high, low + 1e-8)  # the oracle's legs end where there is only one effort

    start, goal = np.radians([60.0, -30.0])
    plan = plan_motion(problem)
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(least_time_within(curves_of(smooth, start, goal), start, goal, within), rel=EXACT)
    assert plan.prove().verdict == "proved"
