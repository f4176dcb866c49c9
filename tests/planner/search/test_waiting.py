"""Rest: motions that wait or hold a pose, by efforts within their limits."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import close_at
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.proof import prove
from linkplan.planner.search import waiting, without_solver
from linkplan.planner.search.methods import FULL_BUDGET, Search
from linkplan.planner.search.planning import plan_motion, search_for
from tests.support.bodies import PENDULUM, body_problem, cart
from tests.support.motions import motion_along

DURATION_S = 0.8
# Efforts that hold a pose, of inverse dynamics and of the plan, relative.
HELD = 1e-9
# The objective against adaptive quadrature, relative.
QUADRATURE = 1e-7


@pytest.fixture(scope="module")
def search() -> Search:
    problem = load_problem("five-bar-reach", [f"motion.duration_s={DURATION_S}", "objective.minimize=effort"])
    return search_for(problem)


@pytest.fixture(scope="module")
def plan(search):
    return waiting.from_waiting(search, FULL_BUDGET)


@pytest.mark.slow
def test_a_rest_and_a_motion_are_a_certified_motion_of_the_duration_asked(search, plan):
    assert plan is not None
    assert plan.status == "feasible", plan.message  # it does not claim to be the best
    assert plan.certificate.passed
    assert plan.trajectory.duration_s == pytest.approx(DURATION_S, rel=1e-12)
    np.testing.assert_allclose(plan.trajectory.position[0, 0], search.problem.motion.start)
    np.testing.assert_allclose(plan.trajectory.position[-1, -1], search.problem.motion.goal, atol=1e-9)
    assert "a longer motion may be better" in plan.message


@pytest.mark.slow
def test_while_it_waits_it_is_held_still_by_the_effort_that_its_weight_asks_for(search, plan):
    mechanism, trajectory = search.problem.mechanism, plan.trajectory
    time = np.linspace(0.0, 0.9 * trajectory.breaks_s[1], 5)
    assert trajectory.breaks_s[1] > 0.1
    still = np.zeros((1, mechanism.dof))
    weight, _ = needed_effort(mechanism, close_at(mechanism, search.problem.motion.start)[None], still, still)
    assert np.abs(weight).max() > 0.1
    np.testing.assert_array_equal(trajectory.velocity_at(time), 0.0)
    np.testing.assert_allclose(trajectory.effort_at(time), np.repeat(weight, 5, axis=0), rtol=HELD)


@pytest.mark.slow
def test_the_objective_of_a_rest_and_a_motion_is_the_integral_of_its_efforts_squared(plan):
    trajectory = plan.trajectory

    def squared(at: float) -> float:
        return float((trajectory.effort_at(np.array([at])) ** 2).sum())

    ends = zip(trajectory.breaks_s[:-1], trajectory.breaks_s[1:], strict=True)
    assert plan.objective == pytest.approx(sum(quad(squared, *pair)[0] for pair in ends), rel=QUADRATURE)


def test_what_adds_to_an_objective_beyond_effort_and_time_is_not_waited_through(search):
    tracked = search.problem.varied(objective={"effort": 1.0, "work": 1.0})
    other = replace(search, problem=tracked)
    assert waiting.from_waiting(other, FULL_BUDGET) is None


@pytest.mark.parametrize(("share", "can_wait"), [(1 - 1.2e-9, False), (1 - 8e-10, True)])
def test_a_pose_is_held_only_by_an_effort_within_its_limit(share, can_wait):
    """Held at 30 deg, the pendulum's rod needs m g l sin 30 deg; at 60 deg it needs more."""
    limit = share * 9.81 * 0.5 * np.sin(np.radians(30.0))
    motion = 'kind = "reach"\nstart_deg = { J = 30.0 }\ngoal_deg = { J = 60.0 }\nduration_s = 4.0\n'
    problem = body_problem(PENDULUM.format(limit=repr(float(limit))), motion)
    assert waiting.may_wait(search_for(problem)) is can_wait


def pushed(minimize: str, duration: float | str) -> Problem:
    """Return the problem of pushing two kilograms a metre on."""
    return Problem.reach(cart(), start_m={"x": 0.0}, goal_m={"x": 1.0}, duration_s=duration, minimize=minimize)


def test_of_the_known_motions_the_one_that_costs_least_with_its_rest_is_taken():
    quick, slow = plan_motion(pushed("time", "free")), plan_motion(pushed("effort", 1.5))
    asked = pushed("effort", 2.5)
    search = search_for(asked)
    for plan in (quick, slow):
        search.known.add(plan.trajectory)
    joined = waiting.from_waiting(search, FULL_BUDGET)
    assert joined.passed
    assert joined.trajectory.duration_s == pytest.approx(2.5, rel=1e-12)
    assert joined.objective == pytest.approx(slow.objective, rel=1e-9)
    assert joined.objective < 0.6 * quick.trajectory.duration_s * 6.0**2


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_the_way_to_a_rest_beside_the_quickest_motion_is_gone_only_if_there_is_time_for_it(factor):
    """From rest to rest over a metre with 3 m/s2 either way: 2 sqrt(1 / 3) s."""
    least = 2.0 * np.sqrt(1.0 / 3.0)
    quick = plan_motion(pushed("time", "free"))
    asked = pushed("effort", factor * quick.trajectory.duration_s)
    plan = waiting.from_waiting(search_for(asked), FULL_BUDGET)
    assert quick.trajectory.duration_s == pytest.approx(least, rel=1e-6)
    if factor == 1.0:
        assert plan is None
    else:
        assert plan.passed
        assert plan.trajectory.duration_s == pytest.approx(factor * least, rel=1e-6)


@pytest.mark.parametrize("first", [True, False])
def test_a_rest_is_joined_to_a_motion_as_constants(first):
    """A metre in a second, and a quarter of a second at rest under 3 N before or after it."""
    motion = motion_along(
        [0.0, 0.25, 1.0],
        np.array([[0.0, 0.0, 0.1], [0.1, 0.5, 1.0]]).T,
        velocity=np.array([[0.0, 0.8], [0.5, 0.6]]).T,
        effort=[[6.0, -6.0]],
    )
    rest = motion_along([0.0, 0.25], [1.0, 1.0], velocity=[0.0, 0.0], effort=[3.0, 3.0], start_pose=[0.0])
    joined = without_solver.joined(motion, rest, first=first)
    assert joined.breaks_s.tolist() == ([0.0, 0.25, 0.5, 1.25] if first else [0.0, 0.25, 1.0, 1.25])
    rest, moves = (0.1, 0.25 + np.array([0.1, 0.9])) if first else (1.1, np.array([0.1, 0.9]))
    at = np.array([rest])
    assert joined.position_at(at)[0, 0] == (0.0 if first else 1.0)
    assert (joined.velocity_at(at)[0, 0], joined.effort_at(at)[0, 0]) == (0.0, 3.0)
    for name in ("position_at", "velocity_at", "effort_at"):
        np.testing.assert_allclose(getattr(joined, name)(moves), getattr(motion, name)(np.array([0.1, 0.9])))


def test_the_cheapest_legs_of_a_swing_up_follow_a_rest_that_costs_nothing():
    problem = Problem.reach(PENDULUM.format(limit=6), start_deg={"J": 0.0}, goal_deg={"J": 90.0}, duration_s=6.0)
    plan = without_solver.legs_plan(search_for(problem))
    assert plan.passed, plan.message
    assert plan.trajectory.duration_s == pytest.approx(6.0, rel=1e-12)
    hanging = np.linspace(0.0, 4.0, 41)
    assert np.abs(plan.trajectory.position_at(hanging)).max() == 0.0
    assert np.abs(plan.trajectory.effort_at(hanging)).max() < 1e-12


@pytest.mark.parametrize(("sign", "limit", "held"), [(1, 2.46, True), (1, 2.44, False), (-1, 2.46, True), (-1, 2.44, False)])
def test_a_weight_is_held_on_either_side_up_to_the_limit_there(sign, limit, held):
    """At 30 deg the rod weighs 2.4525 N.m; the other limit is 9 N.m, and the goal is beyond it."""
    motion = f'kind = "reach"\nstart_deg = {{ J = {sign * 30.0} }}\ngoal_deg = {{ J = {sign * 60.0} }}\nduration_s = 4.0\n'
    limits = f"limits.effort.m=[-9, {limit}]" if sign > 0 else f"limits.effort.m=[-{limit}, 9]"
    problem = body_problem(PENDULUM.format(limit=9), motion, limits)
    holding = without_solver.held(problem, "start")
    assert (holding is not None) is held
    if held:
        assert holding.effort == pytest.approx([sign * 9.81 * 0.25])
    assert without_solver.held(problem, "goal") is None
    moving = problem.varied(motion=replace(problem.motion, start_speed=np.array([-0.1])))
    assert without_solver.held(moving, "start") is None


@pytest.mark.parametrize(("angle", "held"), [(0.0, True), (30.0, False)])
def test_a_pose_in_which_an_undriven_rod_would_fall_is_not_held(angle, held):
    """Two rods hang side by side, the first one driven; the second one begins at an angle."""
    rod = PENDULUM.format(limit=9)
    body = rod[rod.index('<body name="rod">') : rod.index("</worldbody>")]
    both = rod.replace("</worldbody>", body.replace("rod", "free").replace('"J"', '"K"') + "</worldbody>")
    motion = (
        f'kind = "reach"\nstart_deg = {{ J = 0.0, K = {angle} }}\ngoal_deg = {{ J = 60.0, K = 10.0 }}\nduration_s = 4.0\n'
    )
    assert (without_solver.held(body_problem(both, motion), "start") is not None) is held


G, MASS_KG, ARM_M = 9.81, 0.5, 0.4
STICK_ON_SLIDER = f"""
<mujoco><worldbody><body name="slider"><joint name="x" type="slide" axis="1 0 0"/>
  <inertial mass="2" pos="0 0 0" diaginertia="0.01 0.01 0.01"/>
  <body name="stick"><joint name="q" axis="0 1 0"/>
    <inertial mass="{MASS_KG}" pos="0 0 -{ARM_M}" diaginertia="0.01 0.01 0.001"/></body></body></worldbody>
<actuator><motor name="f" joint="x" ctrlrange="-30 30"/></actuator></mujoco>
"""
# An arm that stands out level, with its weight of m g l = 1.962 N.m.
ARM = f"""
<mujoco><worldbody><body name="arm"><joint name="q" axis="0 1 0"/>
  <inertial mass="{MASS_KG}" pos="{ARM_M} 0 0" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator>{{}}</actuator></mujoco>
"""
ONE = ARM.format('<motor name="m" joint="q" ctrlrange="-5 5"/>')
TWO = ARM.format('<motor name="weak" joint="q" ctrlrange="-0.5 0.5"/><motor name="m" joint="q" ctrlrange="-5 5"/>')
WEIGHT = MASS_KG * G * ARM_M


@pytest.mark.parametrize("duration_s", [2.0, 120.0])
def test_a_stick_that_stands_on_a_slider_is_held_at_rest_by_no_effort(duration_s):
    plan = plan_motion(Problem.hold(STICK_ON_SLIDER, start_m={"x": 0.0}, start_deg={"q": 180.0}, duration_s=duration_s))
    assert plan.status == "optimal", plan.message
    assert plan.certificate.passed
    assert plan.objective == pytest.approx(0.0, abs=1e-12)
    assert plan.trajectory.duration_s == pytest.approx(duration_s, rel=1e-12)
    np.testing.assert_array_equal(plan.trajectory.velocity, 0.0)


@pytest.mark.parametrize("angle_deg", [0.0, 180.0])
def test_a_reach_in_equilibrium_whose_goal_is_its_start_is_answered_by_a_rest_that_costs_nothing(angle_deg):
    ends = {"start_m": {"x": 0.0}, "start_deg": {"q": angle_deg}, "goal_m": {"x": 0.0}, "goal_deg": {"q": angle_deg}}
    plan = plan_motion(Problem.reach(STICK_ON_SLIDER, duration_s=2.0, **ends))
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("duration_s", [0.5, 2.0])  # in 2 s no motion of the model is proved near the plan
def test_a_reach_whose_goal_is_its_start_is_a_proved_rest_where_holding_costs_something(duration_s, monkeypatch):
    """On a sloping rail a motion of the solver's rounding costs as much, and its speed has no digits to prove."""
    sloping = STICK_ON_SLIDER.replace('<body name="slider">', '<body name="slider" euler="0 15 0">')
    ends = {"start_m": {"x": 0.0}, "start_deg": {"q": 165.0}, "goal_m": {"x": 0.0}, "goal_deg": {"q": 165.0}}
    tubes, neighbourhood = [], prove.Neighbourhood
    monkeypatch.setattr(prove, "Neighbourhood", lambda *given: tubes.append(given[2]) or neighbourhood(*given))
    plan = plan_motion(Problem.reach(sloping, duration_s=duration_s, **ends))
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(duration_s * ((2 + MASS_KG) * G * np.sin(np.radians(15.0))) ** 2, rel=1e-9)
    assert plan.prove().verdict == "proved"
    assert len(tubes) <= 2


def test_a_level_arm_is_held_by_its_weight_and_that_is_proved():
    plan = plan_motion(Problem.hold(ONE, start_deg={"q": 0.0}, duration_s=3.0))
    assert plan.status == "optimal", plan.message
    np.testing.assert_allclose(plan.trajectory.effort, -WEIGHT, rtol=1e-12)
    assert plan.objective == pytest.approx(3.0 * WEIGHT**2, rel=1e-12)
    assert plan.prove().verdict == "proved"


def test_the_actuator_that_cannot_hold_a_pose_is_named_with_its_need_and_its_limit():
    problem = Problem.hold(ONE, start_deg={"q": 0.0}, duration_s=1.0, limits={"effort": {"m": [-1.5, 1.5]}})
    plan = plan_motion(problem)
    assert plan.status == "infeasible"
    for said in ("m on joint q", "-1.962 N.m", "0.462 N.m beyond its limit of -1.5"):
        assert said in plan.message, plan.message


def test_a_pose_that_nothing_drives_out_of_equilibrium_names_the_joint_and_its_effort():
    plan = plan_motion(Problem.hold(STICK_ON_SLIDER, start_m={"x": 0.0}, start_deg={"q": 90.0}, duration_s=1.0))
    assert plan.status == "infeasible"
    assert "no actuator can give" in plan.message
    assert f"{WEIGHT:.4g} N.m on joint q" in plan.message


def test_two_actuators_hold_by_the_least_efforts_within_the_limits_of_each():
    plan = plan_motion(Problem.hold(TWO, start_deg={"q": 0.0}, duration_s=1.0))
    assert plan.status == "optimal", plan.message
    np.testing.assert_allclose(plan.trajectory.effort[0, 0], [-0.5, 0.5 - WEIGHT], rtol=1e-9)  # half each is too much


def test_where_a_rest_costs_effort_a_reach_to_its_start_costs_no_more():
    ends = {"start_deg": {"q": 0.0}, "goal_deg": {"q": 0.0}, "duration_s": 2.0}
    rest = plan_motion(Problem.hold(ONE, start_deg={"q": 0.0}, duration_s=2.0))
    plan = plan_motion(Problem.reach(ONE, **ends))
    assert plan.passed, plan.message
    assert plan.objective <= (1 + 1e-4) * rest.objective


def test_a_linear_tracker_keeps_a_stick_standing_as_modelled_and_with_a_mismatch():
    plan = linkplan.plan(Problem.hold(STICK_ON_SLIDER, start_m={"x": 0.0}, start_deg={"q": 180.0}, duration_s=4.0))
    assert linkplan.compare(plan, ["lqr"]).stable


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"duration_s": None}, "needs a motion.duration_s in seconds"), ({"start_deg": None}, "needs a start")],
)
def test_a_hold_without_a_start_or_a_duration_is_refused(changes, said):
    given = {"start_deg": {"q": 0.0}, "duration_s": 1.0} | changes
    with pytest.raises(ProblemError, match=said):
        Problem.hold(ONE, **given)


def test_a_hold_that_is_asked_to_move_is_refused():
    tables = {"motion": {"kind": "hold", "start_deg": {"q": 0.0}, "goal_deg": {"q": 10.0}, "duration_s": 1.0}}
    with pytest.raises(ProblemError, match=r"motion.goal_deg belongs to a motion, but motion.kind 'hold' stays"):
        Problem.from_tables("hold", tables, mechanism=linkplan.load_mechanism(ONE))


# A random four-bar. Its direct motion of 0.8087 s is at the limit of the effort and costs 3.757; that of least time swings.
SWINGING = """<mujoco><compiler angle="degree" autolimits="true"/><option><flag contact="disable"/></option><worldbody>
<body pos="0 0 1"><joint name="J1" axis="0 1 0" range="-180 180"/>
<inertial pos="0.02544675114650236 0 0.07606415154526104" mass="1.7249742961286216"
diaginertia="0.013280561785203303 0.013280561785203303 0.013280561785203303"/>
<body pos="0 0 0.2564812051359891" euler="0 108.86453924086246 0"><joint name="J2" axis="0 1 0"/>
<inertial pos="0.006117832076229466 0 0.10379494811144316" mass="0.44344950179996134"
diaginertia="0.0020826252647760573 0.0020826252647760573 0.0020826252647760573"/>
<site name="tip" pos="0 0 0.19896648578065446"/></body></body>
<body pos="0.1297216822783873 0 1" euler="0 16.94861042502845 0"><joint name="J3" axis="0 1 0"/>
<inertial pos="0.02935037234701824 0 0.07808107954108828" mass="1.3280808300749736"
diaginertia="0.006125459372013351 0.006125459372013351 0.006125459372013351"/>
<site name="pin" pos="0 0 0.20087363367296407"/></body></worldbody><equality><connect site1="tip" site2="pin"/></equality>
<actuator><motor joint="J1" ctrlrange="-2.2522627784765348 2.2522627784765348"/></actuator></mujoco>"""


@pytest.mark.slow
def test_the_cost_of_a_shorter_motion_and_a_rest_bounds_that_of_a_plan():
    ends = {"start_deg": {"J1": -40.15037593984961}, "goal_deg": {"J1": -172.78195488721806}}
    plan = plan_motion(Problem.reach(SWINGING, **ends, duration_s=0.8087291935427037, minimize="effort"))
    assert plan.passed, plan.message
    assert plan.objective < 3.433
