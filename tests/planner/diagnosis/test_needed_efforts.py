"""Why a motion is impossible: efforts that it needs, the way of a single degree of freedom, durations far too short."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.planner.closed_chain.guess import Guess, guess_from
from linkplan.planner.limits.actuators import PowerLimit
from linkplan.planner.limits.kinds import violation, without
from linkplan.planner.limits.rates import AccelerationLimit
from linkplan.planner.phase_plane.bang_bang_motions import least_share
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.refinement.history import recording
from linkplan.planner.search import reasons
from linkplan.planner.search.least_limit import LeastLimit, least_relaxation_of_legs, settled_relaxation
from linkplan.planner.search.planning import plan_motion, search_for
from linkplan.planner.search.reasons import effort_sentence, far_too_short, nothing_found, path_effort, share_sentence
from linkplan.planner.search.solving import solve_from
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.mesh import uniform
from tests.support.bodies import HINGE, HINGE_INERTIA, LIFT, PENDULUM, QUARTER_TURN, TURN, body_problem, cart
from tests.support.data import KNEE_TABLE
from tests.support.fourbar import G
from tests.support.fourbar_problems import random_case
from tests.support.legs import leg
from tests.support.motions import motion_along
from tests.support.plans import GOAL, LIMIT, START, planned, problem_of
from tests.support.slider_crank import CRANK, ROD

# The quarter turn in a second along t^2 (3 - 2 t): 6 I b (1 - 2 t) N.m.
PEAK_EFFORT = 6 * HINGE_INERTIA * TURN


def problem(limit: str = "[-4, 4]", mjcf: str = HINGE) -> Problem:
    name = "m" if 'name="m"' in mjcf else "motor"
    return body_problem(mjcf, QUARTER_TURN + "duration_s = 1.0\n", f"limits.effort.{name}={limit}")


def least(trajectory: Trajectory) -> LeastLimit:
    """Return a motion as that of 1.25 times the limits."""
    return LeastLimit(factor=1.25, trajectory=trajectory, mesh=uniform(1), durations=np.ones(1), first=1.25)


def two_hinges(actuators: str) -> Problem:
    """Return the quarter turn of two hinges with equal inertias."""
    body = HINGE[HINGE.index('<body name="arm">') : HINGE.index("</worldbody>")]
    both = HINGE.replace("</worldbody>", body.replace("arm", "other").replace('"J"', '"K"') + "</worldbody>")
    ends = 'kind = "reach"\nstart_deg = { J = 10.0, K = 10.0 }\ngoal_deg = { J = 100.0, K = 100.0 }\nduration_s = 1.0\n'
    return body_problem(both.replace("</actuator>", f"{actuators}</actuator>"), ends)


def with_efforts(first: float, last: float) -> Trajectory:
    begin = np.radians(10.0)
    return motion_along([0.0, 1.0], [begin, begin, begin + TURN, begin + TURN], effort=[first, last])


@pytest.mark.parametrize(
    ("limit", "first", "last", "words"),
    [
        ("[-4, 4]", 5.0, -4.0, "would have to give 5 N.m at t = 0 s, 1 N.m beyond its limit of 4 N.m"),
        ("[-4, 4]", -5.0, 4.0, "would have to give 5 N.m at t = 0 s, 1 N.m beyond its limit of 4 N.m"),
        ("[-2, 9]", 5.0, -5.0, "would have to give 5 N.m at t = 1 s, 3 N.m beyond its limit of 2 N.m"),
    ],
)
def test_the_largest_excess_of_an_effort_is_named_with_its_limit(limit, first, last, words):
    said, over = effort_sentence(problem(limit), least(with_efforts(first, last)))
    assert said == f"motor on joint J {words}"
    assert (over.limit, over.name, abs(over.value)) == ("effort", "motor", pytest.approx(5.0))
    assert f"{abs(over.value) - abs(over.bound):.4g} N.m beyond" in said
    assert f"t = {over.time_s:.3g} s" in said


def test_of_two_actuators_the_one_with_the_larger_excess_is_named():
    """The other is always just within its limit."""
    asked, one = two_hinges('<motor name="m" joint="K" ctrlrange="-4 4"/>'), with_efforts(5.0, -5.0)
    arrays = {name: np.repeat(getattr(one, name), 2, axis=2) for name in ("position", "velocity", "effort")}
    arrays["effort"][:, :, 1] = 3.9
    both = replace(one, **arrays, start_pose=np.repeat(one.start_pose, 2))
    assert effort_sentence(asked, least(both))[0].startswith("motor on joint J")


def test_what_no_actuator_gives_is_named_with_its_joint():
    asked, one = two_hinges(""), with_efforts(0.0, 0.0)
    arrays = {name: np.repeat(getattr(one, name), 2, axis=2) for name in ("position", "velocity")}
    both = replace(one, **arrays, start_pose=np.repeat(one.start_pose, 2))
    found = path_effort(asked, guess_from(both))
    assert found.sentence.endswith(f", and no actuator can give the {PEAK_EFFORT:.4g} N.m needed on K")
    assert "no actuator can give" not in path_effort(problem(), guess_from(one)).sentence


def test_rounding_is_no_effort_that_no_actuator_gives():
    """Two motors share an effort that passes through zero half-way: their sum is not the effort to the last bit."""
    second = '<motor name="other" joint="J" gear="0.3" ctrlrange="-4 4"/></actuator>'
    geared = problem(mjcf=HINGE.replace("</actuator>", second))
    assert "no actuator can give" not in path_effort(geared, guess_from(with_efforts(0.0, 0.0))).sentence


@pytest.mark.parametrize(("share", "refused"), [(0.09, True), (0.11, False)])
def test_a_tenth_of_the_least_time_is_far_too_short(share, refused):
    least = 2 * np.sqrt(HINGE_INERTIA * TURN / 4.0)
    asked = body_problem(HINGE, QUARTER_TURN + f"duration_s = {share * least}\n")
    found = far_too_short(search_for(asked))
    assert (found is not None) is refused
    if refused:
        assert found.remedy["motion.duration_s"] == pytest.approx(least, rel=2e-3)
        assert f"is {1 / share:.3g} times too short" in found.sentence


def test_of_an_excess_that_lasts_its_first_instant_is_named():
    effort = np.array([[0.0, 5.0, 0.0], [0.0, 5.0, 0.0]])[:, :, None]
    trajectory = with_efforts(0.0, 0.0)
    halves = np.repeat(trajectory.position[:1], 4, axis=0)
    still = motion_along([0.0, 0.25, 0.5, 1.0], np.repeat(halves, 3, axis=1), effort=effort)
    said, _ = effort_sentence(problem(), least(still))
    assert "5 N.m at t = 0.25 s" in said


@pytest.mark.parametrize(
    ("limit", "factor", "words"),
    [
        ("[-4, 4]", PEAK_EFFORT / 4, f"give {PEAK_EFFORT:.4g} N.m at t = 0 s, {PEAK_EFFORT / 4:.4g} times its limit of 4"),
        ("[-2, 4]", PEAK_EFFORT / 2, f"give -{PEAK_EFFORT:.4g} N.m at t = 1 s, {PEAK_EFFORT / 2:.4g} times its limit of -2"),
    ],
)
def test_a_path_needs_the_effort_of_its_inertia_as_a_share_of_the_limit_on_its_side(limit, factor, words):
    found = path_effort(problem(limit), guess_from(with_efforts(0.0, 0.0)))
    assert found.factor == pytest.approx(factor)
    assert words in found.sentence
    low, high = np.fromstring(limit.strip("[]"), sep=",")
    assert found.inertial_factor == pytest.approx(PEAK_EFFORT / max(-low, high))


@pytest.mark.parametrize("limit", ["[-2, 0]", "[-2, -1]"])
def test_in_a_direction_in_which_an_actuator_gives_nothing_the_other_limit_is_its_measure(limit):
    pushing = guess_from(with_efforts(0.0, 0.0))
    found = path_effort(problem(limit), pushing)
    assert found.factor == pytest.approx(PEAK_EFFORT / 2)
    first, last = found.sentence.split(" at t = ")
    assert first.endswith(f"{PEAK_EFFORT:.4g} N.m")
    assert "a direction in which its limit is 0" in last if last.startswith("0 s") else "times its limit of -2" in last


def test_the_weight_that_a_path_is_held_against_is_no_effort_of_its_inertia():
    """A pendulum of 4.905 N.m and 0.26 kg m2, so slow that only its weight counts, and so fast that its inertia does."""
    asked = problem("[-10, 10]", PENDULUM.format(limit=10))
    inertia, angle, turn = 0.26, np.radians(100.0), guess_from(with_efforts(0.0, 0.0))
    for duration in (100.0, 0.5):
        slow = Guess(
            position=lambda t, d=duration: turn.position(t / d),
            velocity=lambda t, d=duration: turn.velocity(t / d) / d,
            acceleration=lambda t, d=duration: turn.acceleration(t / d) / d**2,
            effort=None,
            duration_s=duration,
            start_pose=np.radians([10.0]),
        )
        found = path_effort(asked, slow)
        of_inertia = 6 * inertia * TURN / duration**2
        assert found.inertial_factor == pytest.approx(of_inertia / 10, rel=1e-6)
        if duration == 100.0:
            assert found.factor == pytest.approx(4.905 / 10, rel=1e-3)
        else:
            at_start = of_inertia + 4.905 * np.sin(np.radians(10.0))
            at_end = abs(4.905 * np.sin(angle) - of_inertia)
            assert found.factor == pytest.approx(max(at_start, at_end) / 10, rel=1e-6)


@pytest.mark.parametrize("slowest", [0.5, 1.5])
def test_the_slowest_passage_is_looked_for_between_both_ends_and_not_where_it_turns(slowest):
    """A speed of 1 but near the slowest instant, in the first and last 2 % and where it turns back, at 1 s."""

    def speed(t: np.ndarray) -> np.ndarray:
        dips = [
            1.0 - depth * np.exp(-(((t - at) / 0.01) ** 2)) for at, depth in ((slowest, 0.9), (0.02, 0.95), (1.98, 0.95))
        ]
        return (np.where(t < 1.0, 1.0, -1.0) * np.minimum(1.0, 20 * np.abs(t - 1.0)) * np.prod(dips, axis=0))[:, None]

    guess = Guess(
        position=lambda t: t[:, None],
        velocity=speed,
        acceleration=speed,
        effort=lambda t: 2.0 + t[:, None],
        duration_s=2.0,
        start_pose=np.zeros(1),
    )
    said = share_sentence(problem(), 1.25, guess, at_all=True)
    assert f"t = {slowest:.3g} s" in said
    assert f"give {2 + slowest:.4g} N.m, 1.25 times its limit of {(2 + slowest) / 1.25:.4g}" in said


# The cage of 2 kg and its motor, too weak to lift it, which it does not know from below.
MASS, WEAK, WAY = 2.0, 12.0, 0.4
TOO_WEAK = LIFT.replace("-30 50", f"-{WEAK} {WEAK}")
LIFTED = f'kind = "reach"\nstart_deg = {{ J = 0.0 }}\ngoal_deg = {{ J = {WAY} }}\n'.replace("_deg", "_m")
# A servo of 1 N.m/rad on 1 kg m2, whose ctrl, the angle and the effort, leaves no full effort of 1 N.m above 0.05 rad.
MOTOR, POSITION = (
    '<motor name="motor" joint="J" ctrlrange="-4 4"/>',
    '<position name="s" joint="J" kp="1" ctrlrange="-4 1.05"/>',
)
SERVO = HINGE.replace("0.3 0.3 0.3", "1 1 1").replace(MOTOR, POSITION)
# The least factor is found to 2^(1 / 256) of itself.
FACTOR = 5e-3
# Over the outer dead centre, where the slider is furthest out.
ACROSS = ("motion.start_deg.O=-60", "motion.goal_deg.O=70")


@pytest.mark.parametrize(("short", "status"), [(1e-3, "infeasible"), (-1e-6, "optimal")])
def test_a_range_that_is_left_on_the_only_way_is_named_without_solving(short, status):
    most = CRANK + ROD - short
    plan = plan_motion(load_problem("slider-crank-turn", [*ACROSS, f"limits.range_m.B=[0.0, {most!r}]"]))
    assert plan.status == status, plan.message
    if status == "infeasible":
        assert not plan.history
        said = re.search(r"joint B stands at ([\d.]+) m where O = (-?[\d.]+) deg.*, ([\d.e-]+) m beyond", plan.message)
        assert float(said[1]) == pytest.approx(CRANK + ROD, rel=1e-4)
        assert abs(float(said[2])) < 0.5
        assert float(said[3]) == pytest.approx(short, rel=1e-2)


def test_the_least_factor_in_any_time_is_the_weight_over_the_limit():
    problem = body_problem(TOO_WEAK, LIFTED + 'duration_s = "free"\n', "objective.minimize=time")
    plan = reasons.efforts_by_the_phase_plane(search_for(problem))
    assert plan.status == "infeasible"
    assert plan.verdict.needed_factor == pytest.approx(MASS * G / WEAK, rel=FACTOR)
    assert "in any time: motor on joint J would have to give 19.6" in plan.message


@pytest.mark.parametrize("duration", [0.3, 0.6])
def test_the_least_factor_in_a_duration_is_that_of_the_bang_bang_motion(duration):
    problem = body_problem(TOO_WEAK, LIFTED + f"duration_s = {duration}\n")

    def over(force: float) -> float:
        up, down = force / MASS - G, force / MASS + G
        return np.sqrt(2 * WAY * (1 / up + 1 / down)) - duration

    exact = brentq(over, MASS * G * (1 + 1e-9), 1e4) / WEAK
    factor, motion = least_share(problem, problem.start_pose(), duration)
    assert factor == pytest.approx(exact, rel=FACTOR)
    assert motion.duration_s <= duration


def test_a_thousandth_too_little_time_is_infeasible_though_a_motion_with_errors_was_found():
    """The least time by quadrature of a crank that turns around; a solve converges on a coarse mesh in less."""
    case = random_case(4244, 99)
    plan = plan_motion(Problem.from_tables("too short", case.tables))
    assert plan.status == "infeasible", plan.message
    assert plan.verdict.remedy["motion.duration_s"] == pytest.approx(case.shortest, rel=1e-7)
    assert case.tables["motion"]["duration_s"] == pytest.approx(0.999 * case.shortest)


def test_efforts_that_suffice_are_not_blamed():
    problem = body_problem(LIFT, LIFTED + 'duration_s = "free"\n', "objective.minimize=time")
    assert reasons.efforts_by_the_phase_plane(search_for(problem)) is None


def test_a_phase_plane_that_leaves_out_a_servo_s_ctrl_does_not_contradict_the_efforts_that_are_missing():
    """Over a radian in 2.015 s: full effort alone takes 2 s, and within the range of the ctrl 2.033 s."""
    turn = f'kind = "reach"\nstart_deg = {{ J = 0.0 }}\ngoal_deg = {{ J = {np.degrees(1.0)} }}\nduration_s = 2.015\n'
    problem = body_problem(SERVO, turn, "limits.effort.s=[-1, 1]")
    assert search_for(problem).quickest.duration_s == pytest.approx(2.0, rel=1e-3)
    diagnoses = (reasons.efforts_contradicted, reasons.efforts, reasons.nothing_found)
    plan = plan_motion(problem, diagnoses=diagnoses)
    assert plan.status == "infeasible", plan.message
    assert plan.verdict.remedy["motion.duration_s"] == pytest.approx(2.0328, abs=1e-4)


SHORTEST = KNEE_TABLE["min_time_rest_to_rest"]["shank_s"]
# What the phase plane's grid costs of the least time, relative.
PHASE_PLANE = 2e-3
TOO_SHORT = "motion.duration_s=0.001"


def test_a_reach_in_a_millisecond_is_answered_without_a_solve():
    plan = planned("knee-reach", TOO_SHORT)
    assert plan.status == "infeasible"
    assert plan.history == ()
    assert plan.verdict.remedy["motion.duration_s"] == pytest.approx(SHORTEST, rel=PHASE_PLANE)
    assert "122 times too short" in plan.message
    assert "the shortest feasible duration is about 0.1219 s" in plan.message
    assert f"times its limit of {LIMIT:g}" in plan.message


def test_the_factor_is_that_of_inverse_dynamics_along_the_smoothest_path():
    mechanism = problem_of("knee-reach").mechanism
    x, T = np.linspace(0.0, 1.0, 400), 1e-3
    s = START + (GOAL - START) * (10 * x**3 - 15 * x**4 + 6 * x**5)
    v = (GOAL - START) * (30 * x**2 - 60 * x**3 + 30 * x**4) / T
    a = (GOAL - START) * (60 * x - 180 * x**2 + 120 * x**3) / T**2
    q = follow(mechanism, s[:, None], planned("knee-reach").trajectory.start_pose)
    effort, _ = needed_effort(mechanism, q, v[:, None], a[:, None])
    asked = problem_of("knee-reach", TOO_SHORT)
    found = path_effort(asked, search_for(asked).smooth).factor
    assert found == pytest.approx(np.abs(effort).max() / LIMIT, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("duration", ["0.1", "0.03"])
def test_a_duration_that_is_only_a_little_too_short_is_looked_into_as_before(duration):
    plan = planned("knee-reach", f"motion.duration_s={duration}")
    assert plan.status == "infeasible"
    assert plan.history
    assert "times too short" not in plan.message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("problem", "words"),
    [
        ("five-bar-reach", ["act_O", "times its limit of 1.4", "0.2293 s"]),
        ("cart-pole-swing-up", ["act_cart", "no actuator can give", "needed on pole"]),
        ("gripper-close", ["pull on tendon cable", "times its limit of 20", "0.0885"]),
        ("squeezer-turn", ["drive on joint beta", "0.01408 s"]),
    ],
)
def test_other_mechanisms_are_answered_so_too(problem, words):
    free = ["limits.speed_deg_s={}"] if problem == "five-bar-reach" else []
    plan = planned(problem, TOO_SHORT, *free)
    assert plan.status == "infeasible"
    assert plan.history == ()
    for word in ["times too short", "shortest feasible duration", *words]:
        assert word in plan.message


@pytest.mark.slow
def test_a_weak_motor_that_swings_up_is_not_taken_for_hurried():
    weak = planned("knee-reach", "motion.duration_s=0.2", "limits.effort.act_O=[-0.1, 0.1]")
    assert "times too short" not in weak.message


@pytest.mark.slow
def test_with_several_motors_the_least_time_ends_the_search_for_a_motion_in_too_little_time():
    least_s, efforts = 0.18663512, {"m_hip_pitch": 130.0, "m_knee_motor": 120.0}
    asked = {"duration_s": 0.98 * least_s, "minimize": "effort"}
    plan = plan_motion(leg(**asked))
    assert plan.status == "infeasible"
    assert plan.verdict.remedy["motion.duration_s"] == pytest.approx(least_s, rel=1e-4)
    failed = [step.what for step in plan.history if not step.converged]
    assert len(failed) <= 2, failed  # two starts; neither further ones nor swings
    factor = 1.002 * plan.verdict.needed_factor
    stronger = {name: [-factor * effort, factor * effort] for name, effort in efforts.items()}
    assert plan_motion(leg(**asked, limits={"effort": stronger})).status == "optimal"


def test_a_search_without_a_motion_and_a_reason_names_the_shortest_known_motion():
    search = search_for(problem())
    for duration_s, named in ((0.9, False), (2.0, True)):
        search.known.motions[:] = [motion_along([0.0, duration_s], np.radians([10.0, 10.0, 100.0, 100.0]))]
        with recording():
            assert (f"the shortest motion found takes {duration_s:g} s" in nothing_found(search).message) is named


# A mass of 2 kg pushed over 0.3 m in 0.5 s by a force that its limits on power and acceleration leave alone.
SLED_MASS, SLED_FORCE, SLED_WAY, SLED_TIME = 2.0, 400.0, 0.3, 0.5


def half_way(power: float) -> float:
    """Return the way [m] in the first half of the time: a bang to the speed P / F, then constant power."""
    speed = power / SLED_FORCE
    bang = SLED_MASS * speed / SLED_FORCE
    later = speed**2 + 2 * power * (SLED_TIME / 2 - bang) / SLED_MASS
    return 0.5 * speed * bang + SLED_MASS / (3 * power) * (later**1.5 - speed**3)


def sled(key: str, limit: float) -> Problem:
    ends = {"start_m": {"x": 0.0}, "goal_m": {"x": SLED_WAY}, "duration_s": SLED_TIME}
    name = "push" if key == "power_w" else "x"
    return Problem.reach(cart(f"{-SLED_FORCE} {SLED_FORCE}"), **ends, limits={key: {name: limit}})


LEAST_POWER = brentq(lambda p: half_way(p) - SLED_WAY / 2, 1.0, 10.0)


@pytest.mark.parametrize(
    ("kind", "key", "least"),
    [
        (AccelerationLimit, "acceleration_m_s2", 4 * SLED_WAY / SLED_TIME**2),
        (PowerLimit, "power_w", LEAST_POWER),
    ],
    ids=["acceleration", "power"],
)
def test_the_least_limit_of_a_motion_in_time_is_that_of_the_legs(kind, key, least):
    low = sled(key, 0.4 * least)
    motion = plan_motion(sled(key, 1.2 * least)).trajectory
    legs = least_relaxation_of_legs(low, kind, low.start_pose(), motion)
    over = violation(kind, low, legs)
    assert abs(over.value) == pytest.approx(least, rel=1e-5)


@pytest.mark.slow
def test_the_power_that_a_limit_lacks_is_exact_although_the_motion_overruns_it_between_nodes():
    low = sled("power_w", 0.4 * LEAST_POWER)
    search = search_for(low)
    with recording():
        found = solve_from(without(PowerLimit, low), search.smooth, uniform(12), np.array([SLED_TIME]), "without power")
        motion, factor = settled_relaxation(low, PowerLimit, found.motion, found.mesh, found.durations)
    over = violation(PowerLimit, low, motion, factor)
    assert -over.left == pytest.approx(0.6 * LEAST_POWER, rel=0.02)
