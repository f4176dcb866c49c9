"""Waypoints at given and free instants, periodic motions, bounds on a free duration; and what is refused of them."""

import numpy as np
import pytest
from scipy.optimize import minimize

from linkplan.models.errors import ProblemError
from linkplan.planner.plan.plan import Plan
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_plan
from tests.support.plans import optimal, planned, problem_of
from tests.support.refusals import assert_refused
from tests.support.tolerances_planner import (
    BOUNDARY,
    CONTINUITY,
    EXACT_EFFORT,
    MINIMUM_TIME,
    SPEED_DEG_S,
    WAYPOINT_DEG,
    WAYPOINT_EFFORT,
)

TIMED = "duration_s = 1.5\n"
FREE = 'duration_s = "free"\n'
EFFORT = 4.0


# Limits that bind nowhere, for least effort's closed forms.
STRONG = "limits.effort.motor=[-100.0,100.0]"


def hinge(motion: str, *overrides: str) -> Plan:
    plan = body_plan(HINGE, motion, *(overrides or (STRONG,)))
    assert plan.status == "optimal", plan.message
    return plan


def least_effort(times: np.ndarray, positions: np.ndarray, speeds: np.ndarray) -> float:
    """Return J^2 times the integral of the squared acceleration of the cubics between states: 4, 6 and 12 of Hermite's."""
    h, d = np.diff(times), np.diff(positions)
    a, b = speeds[:-1], speeds[1:]
    return HINGE_INERTIA**2 * float(np.sum(4 * (a**2 + a * b + b**2) / h - 12 * (a + b) * d / h**2 + 12 * d**2 / h**3))


def spline_effort(times: list[float], positions: list[float]) -> float:
    """Return the least effort through positions at given times, at rest at both ends: the best speeds on the way."""

    def cost(inner: np.ndarray) -> float:
        return least_effort(np.array(times), np.array(positions), np.concatenate([[0.0], inner, [0.0]]))

    return float(minimize(cost, np.zeros(len(times) - 2), tol=1e-12).fun)


# At given instants.


def test_a_waypoint_at_a_given_instant_is_passed_with_the_effort_of_the_cubic_spline():
    via = np.radians(80.0)
    plan = hinge(QUARTER_TURN + TIMED + "waypoints = [{ at_deg = { J = 80.0 }, time_s = 0.5 }]\n")
    assert plan.trajectory.position_at([0.5])[0, 0] == pytest.approx(via, abs=BOUNDARY)
    exact = spline_effort([0.0, 0.5, 1.5], [np.radians(10.0), via, np.radians(100.0)])
    assert exact > 1.1 * 12 * HINGE_INERTIA**2 * TURN**2 / 1.5**3  # it is a way round
    assert plan.objective == pytest.approx(exact, rel=EXACT_EFFORT)


def test_a_waypoint_s_speed_is_kept():
    plan = hinge(
        QUARTER_TURN + TIMED + "waypoints = [{ at_deg = { J = 55.0 }, speed_deg_s = { J = 0.0 }, time_s = 0.75 }]\n"
    )
    assert plan.trajectory.velocity_at([0.75])[0, 0] == pytest.approx(0.0, abs=BOUNDARY)
    assert plan.objective == pytest.approx(2 * 12 * HINGE_INERTIA**2 * (TURN / 2) ** 2 / 0.75**3, rel=EXACT_EFFORT)


def test_a_speed_alone_may_be_asked_for_on_the_way():
    plan = hinge(QUARTER_TURN + TIMED + "waypoints = [{ speed_deg_s = { J = 120.0 }, time_s = 0.3 }]\n")
    speed = np.radians(120.0)
    assert plan.trajectory.velocity_at([0.3])[0, 0] == pytest.approx(speed, rel=BOUNDARY)

    def cost(via: np.ndarray) -> float:
        return least_effort(np.array([0, 0.3, 1.5]), np.array([0.0, via[0], TURN]), np.array([0.0, speed, 0.0]))

    assert plan.objective == pytest.approx(float(minimize(cost, [0.5], tol=1e-12).fun), rel=EXACT_EFFORT)


# At free instants.


@pytest.mark.slow
def test_a_waypoint_at_a_free_instant_is_passed_when_it_is_cheapest():
    """Out to 160 deg and back to 100: the instant is what makes the effort least."""
    plan = hinge(QUARTER_TURN + TIMED + "waypoints = [{ at_deg = { J = 160.0 } }]\n")
    positions = np.radians([10.0, 160.0, 100.0])

    def cost(unknowns: np.ndarray) -> float:
        return least_effort(np.array([0.0, unknowns[0], 1.5]), positions, np.array([0.0, unknowns[1], 0.0]))

    best = minimize(cost, [0.8, 0.0], tol=1e-13, bounds=[(0.1, 1.4), (-10, 10)])
    assert plan.objective == pytest.approx(float(best.fun), rel=WAYPOINT_EFFORT)
    assert np.degrees(plan.trajectory.position_at([best.x[0]])[0, 0]) == pytest.approx(160, abs=WAYPOINT_DEG)


@pytest.mark.slow
def test_a_speed_just_below_the_quickest_is_braked_for_at_the_last_moment():
    """Braking takes less than an interval of the mesh: a hundredth of the way there."""
    a, half = EFFORT / HINGE_INERTIA, TURN / 2
    speed = 0.98 * np.sqrt(2 * a * half)
    waypoint = f"waypoints = [{{ at_deg = {{ J = 55.0 }}, speed_deg_s = {{ J = {np.degrees(speed)} }} }}]\n"
    plan = hinge(QUARTER_TURN + FREE + waypoint, "objective.minimize=time")
    top = np.sqrt(a * half + speed**2 / 2)
    assert plan.objective == pytest.approx(2 * (2 * top - speed) / a, rel=MINIMUM_TIME)


@pytest.mark.slow
def test_the_quickest_way_there_and_back_turns_at_full_effort():
    """By 160 deg to 100 with no stop asked for: it turns there, so both ways are from rest to rest."""
    plan = hinge(QUARTER_TURN + FREE + "waypoints = [{ at_deg = { J = 160.0 } }]\n", "objective.minimize=time")
    a = EFFORT / HINGE_INERTIA
    # Out: full drive for t1, full braking past or up to the turn, which is at the waypoint; back in like manner.
    exact = sum(2 * np.sqrt(np.radians(part) / a) for part in (150.0, 60.0))
    assert plan.objective == pytest.approx(exact, rel=MINIMUM_TIME)


# Periodic motions.


@pytest.mark.slow
def test_a_periodic_motion_between_two_poses_is_two_cubics():
    plan = hinge('kind = "periodic"\nstart_deg = { J = 10.0 }\ngoal_deg = { J = 100.0 }\n' + TIMED)
    assert plan.objective == pytest.approx(2 * 12 * HINGE_INERTIA**2 * TURN**2 / 0.75**3, rel=EXACT_EFFORT)
    assert plan.trajectory.periodic


@pytest.mark.slow
def test_a_periodic_motion_by_timed_waypoints_returns_to_its_own_state():
    plan = hinge(
        'kind = "periodic"\nduration_s = 1.0\nwaypoints = [{ at_deg = { J = 0.0 }, time_s = 0.25 },'
        " { at_deg = { J = 90.0 }, time_s = 0.75 }]\n"
    )
    motion = plan.trajectory
    np.testing.assert_allclose(np.degrees(motion.position_at([0.25, 0.75, 1.25])[:, 0]), [0, 90, 0], atol=SPEED_DEG_S)
    for state_at in (motion.position_at, motion.velocity_at):
        first, last = state_at([0.0, 1.0 - 1e-12])
        assert first == pytest.approx(last, abs=CONTINUITY)
    assert plan.objective == pytest.approx(2 * 12 * HINGE_INERTIA**2 * TURN**2 / 0.5**3, rel=EXACT_EFFORT)


@pytest.mark.slow
def test_the_shortest_period_by_waypoints_is_twice_the_quickest_way():
    plan = hinge(
        'kind = "periodic"\nwaypoints = [{ at_deg = { J = 10.0 } }, { at_deg = { J = 100.0 } }]\n' + FREE,
        "objective.minimize=time",
    )
    assert plan.objective == pytest.approx(2 * 2 * np.sqrt(HINGE_INERTIA * TURN / EFFORT), rel=MINIMUM_TIME)


# Bounds on a free duration.


@pytest.mark.slow
@pytest.mark.parametrize(("bound", "T"), [("max_duration_s = 1.2\n", 1.2), ("max_duration_s = 0.9\n", 0.9)])
def test_less_effort_takes_the_longest_duration_allowed(bound, T):
    plan = hinge(QUARTER_TURN + FREE + bound)
    assert plan.trajectory.duration_s == pytest.approx(T, rel=MINIMUM_TIME)
    assert plan.objective == pytest.approx(12 * HINGE_INERTIA**2 * TURN**2 / T**3, rel=MINIMUM_TIME)


@pytest.mark.slow
def test_least_time_is_no_shorter_than_the_shortest_allowed():
    plan = hinge(QUARTER_TURN + FREE + "min_duration_s = 1.1\n", "objective.minimize=time")
    assert plan.objective == pytest.approx(1.1, rel=MINIMUM_TIME)


# Refusals.

REFUSED = {
    "one out of order": ("motion.waypoints=[{at_deg={O=0},time_s=0.1},{at_deg={O=9},time_s=0.05}]", "must be after 0.1 s"),
    "one at the end": ("motion.waypoints=[{at_deg={O=0},time_s=0.16}]", "beyond the motion's 0.16 s"),
    "one at no time": ("motion.waypoints=[{at_deg={O=0},time_s=0}]", "positive"),
    "one with a time alone": ("motion.waypoints=[{time_s=0.1}]", "it needs one of them"),
    "a joint for a site": ("motion.waypoints=[{at={O=0}}]", "joint O's position is motion.waypoints[0].at_deg"),
    "a joint that is not there": ("motion.waypoints=[{at_deg={K=0}}]", "K"),
    "one beyond reach": ("motion.waypoints=[{at_deg={O=100}}]", "beyond reach"),
    "bounds on a fixed duration": ("motion.max_duration_s=1", "bound a free duration"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_asked_of_the_way_is_refused_in_one_line(case):
    override, said = REFUSED[case]
    assert_refused(lambda: planned("knee-reach", override), said, kind=ProblemError)


@pytest.mark.parametrize("bounds", [("2", "1"), ("1", "1")])
def test_bounds_on_a_duration_upside_down_are_refused(bounds):
    with pytest.raises(ProblemError, match="min_duration_s must be below"):
        planned("knee-sprint", f"motion.min_duration_s={bounds[0]}", f"motion.max_duration_s={bounds[1]}")


def test_a_periodic_motion_by_waypoints_takes_no_goal():
    with pytest.raises(ProblemError, match=r"takes no motion\.goal_deg"):
        planned("knee-reach", "motion.kind=periodic", "motion.waypoints=[{at_deg={O=0}}]")


@pytest.mark.slow
def test_a_waypoint_that_comes_too_soon_is_called_infeasible():
    """A quarter turn at full effort takes 0.69 s; half of it, passed at speed, 0.34 s."""
    plan = body_plan(HINGE, QUARTER_TURN + TIMED + "waypoints = [{ at_deg = { J = 55.0 }, time_s = 0.2 }]\n")
    assert plan.status == "infeasible", plan.message
    assert "motor" in plan.message
    assert "limit of 4" in plan.message
    assert "\n" not in plan.message


AT_O1 = "motion.waypoints=[{ at_deg = { O1 = -97.0 }, time_s = 0.2 }]"
P_AT_START = 47.15635695640367


def at_waypoint(plan) -> np.ndarray:
    return np.degrees(plan.trajectory.position_at(np.array([0.2]))[0])


@pytest.mark.slow
def test_a_waypoint_of_one_joint_is_passed_by_it_and_leaves_the_other_free():
    plan = optimal("five-bar-reach", AT_O1)
    O2 = at_waypoint(plan)[1]
    assert at_waypoint(plan)[0] == pytest.approx(-97.0, abs=WAYPOINT_DEG)
    assert abs(at_waypoint(optimal("five-bar-reach"))[0] + 97.0) > 0.2  # it is no accident
    held = optimal("five-bar-reach", f"motion.waypoints=[{{ at_deg = {{ O1 = -97.0, O2 = {O2 + 0.5} }}, time_s = 0.2 }}]")
    assert at_waypoint(held)[1] == pytest.approx(O2 + 0.5, abs=WAYPOINT_DEG)
    assert plan.objective < held.objective  # the other stands where that costs least
    again = optimal("five-bar-reach", f"motion.waypoints=[{{ at_deg = {{ O1 = -97.0, O2 = {O2} }}, time_s = 0.2 }}]")
    assert plan.objective == pytest.approx(again.objective, rel=1e-4)


def test_a_waypoint_of_one_joints_speed_leaves_the_rest_free():
    plan = optimal("five-bar-reach", "motion.waypoints=[{ speed_deg_s = { O2 = 20.0 }, time_s = 0.2 }]")
    assert np.degrees(plan.trajectory.velocity_at(np.array([0.2]))[0, 1]) == pytest.approx(20.0, abs=1e-6)


@pytest.mark.parametrize(
    ("waypoint", "words"),
    [
        ("{ at_deg = { O1 = -97.0, O2 = nan } }", ["joint O2 must be a number, got nan"]),
        ("{ at_deg = { O1 = -97.0, P = 60.0 } }", ["of joint P", "follows from O1, O2"]),
        ("{ at_deg = { O1 = -90.0, O2 = -90.0, P = 60.0 } }", ["does not close", "the loop has P at"]),
    ],
)
def test_what_a_waypoint_cannot_mean_is_refused(waypoint, words):
    assert_refused(lambda: problem_of("five-bar-reach", f"motion.waypoints=[{waypoint}]"), *words, kind=ProblemError)


def test_a_dependent_joint_of_a_waypoint_that_fits_is_taken():
    waypoint = f"{{ at_deg = {{ O1 = -90.0, O2 = -90.0, P = {P_AT_START} }} }}"
    assert problem_of("five-bar-reach", f"motion.waypoints=[{waypoint}]").motion.waypoints


def test_a_waypoint_of_one_joint_beyond_its_range_is_refused():
    problem = problem_of("five-bar-reach", "limits.range_deg={ O1 = [-120.0, -80.0] }", AT_O1.replace("-97", "-130"))
    with pytest.raises(ProblemError, match=r"O1 = -130 deg is beyond reach: O1 reaches from -120 to -80 deg"):
        plan_motion(problem)
