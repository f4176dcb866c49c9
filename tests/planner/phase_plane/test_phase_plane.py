"""Starts from the phase plane: near the exact least time, over swings where no straight motion is open; no false refusal."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.phase_plane.bang_bang_motions import least_time_guess
from linkplan.planner.phase_plane.grid import grid_of, plane_of
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.presolve import no_way_to_stop
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_problem, cart
from tests.support.fourbar_problems import random_case
from tests.support.tolerances_planner import MINIMUM_TIME, ROUNDING, SAME_FIGURE

SPRING = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="x" type="slide" axis="1 0 0" stiffness="1"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
<actuator><motor name="u" joint="x" ctrlrange="-1 1"/></actuator></mujoco>"""
# The grid's own error, of the least time.
GRID = 2e-3
# The same of a motion whose legs cross in a cell and whose turn is no place of the grid.
FINE_GRID = 1e-3
# The same of one whose turn is at the nearest of sixty places.
TURNS = 3e-2


def spring(start_m: float, **motion) -> Problem:
    return Problem.reach(SPRING, start_m={"x": start_m}, goal_m={"x": 0.0}, minimize="time", **motion)


@pytest.mark.slow
@pytest.mark.parametrize("half_swings", [1, 5])
def test_a_weak_push_on_a_spring_takes_half_a_period_for_every_two_metres(half_swings):
    """Each half swing about +-1 m takes pi and brings the end 2 m nearer."""
    problem = spring(2.0 * half_swings)
    guess = least_time_guess(problem, problem.start_pose())
    assert guess is not None
    assert guess.duration_s >= np.pi * half_swings * (1 - GRID)
    plan = plan_motion(problem)
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(np.pi * half_swings, rel=MINIMUM_TIME)


def test_the_guess_on_a_spring_swings_where_the_push_is_too_weak():
    """The state (s, v) moves on circles: about -1 m under -1 N, half of one about 1 m under 1 N, about -1 m again."""
    start = 3.5
    problem = spring(start)
    guess = least_time_guess(problem, problem.start_pose())
    assert guess.swings == 2
    r = start + 1.0  # the radius of the first turn; that of the last one is 1
    least = np.pi + np.arccos((r**2 + 15) / (8 * r)) + np.arccos((17 - r**2) / 8)
    assert guess.duration_s == pytest.approx(least, rel=TURNS)
    times = np.linspace(0.0, guess.duration_s, 101)
    s, v = guess.position(times)[:, 0], guess.velocity(times)[:, 0]
    assert (s[0], v[0], s[-1], v[-1]) == pytest.approx((3.5, 0.0, 0.0, 0.0), abs=1e-9)
    # A push of 1 N adds at most its work to v^2 / 2 + s^2 / 2.
    added = np.abs(np.diff(0.5 * v**2 + 0.5 * s**2))
    assert np.all(added <= np.abs(np.diff(s)) + 1e-3)


@pytest.mark.parametrize("way", [+1, -1])
@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("share", [np.inf, 0.5])
def test_a_leg_without_dampers_is_the_one_that_steps_from_cell_to_cell(way, backwards, share):
    """The work alone gives its energy; where speeds are limited to a share of the largest the least energy is kept on."""
    problem = load_problem("knee-sprint")
    pose = problem.start_pose()
    plane = plane_of(problem, *grid_of(problem, np.array([problem.motion.start[0]]), pose, 200))
    assert plane.undamped
    free = plane.leg(100, 0.0, way, way, backwards=backwards)
    below = np.full(len(plane.s), np.inf)
    if np.isfinite(share):
        top = np.full(len(plane.s), share * free.max())
        plane = replace(plane, top={+1: top, -1: top})
        below[90:95], below[106:111] = 0.1 * free.max(), 0.1 * free.max()
    next_to_none = replace(plane, drag=np.full(len(plane.s), 1e-300))
    assert not next_to_none.undamped
    quick, stepped = (p.leg(100, 0.0, way, way, backwards=backwards, below=below) for p in (plane, next_to_none))
    assert len(quick) == len(stepped) > 2
    assert np.isinf(share) or not np.allclose(quick, free[: len(quick)])
    np.testing.assert_allclose(quick, stepped, rtol=ROUNDING * len(quick))


@pytest.mark.parametrize("name", ["knee-sprint", "knee-sprint-bare"])
def test_a_straight_least_time_is_met_to_the_grid(name):
    problem = load_problem(name)
    guess = least_time_guess(problem, problem.start_pose())
    assert guess is not None
    assert guess.duration_s == pytest.approx(plan_motion(problem).objective, rel=GRID)


@pytest.mark.parametrize(
    ("number", "swings", "near"),
    [*((n, None, FINE_GRID) for n in (247, 474, 758)), (598, 2, TURNS), *((n, None, GRID) for n in (65, 94, 136, 217))],
)
def test_a_random_least_time_is_met_to_the_grid(number, swings, near):
    """Next to a singular pose or a rest that torque barely leaves; too fast to stop at the goal; along a speed limit."""
    case = random_case(1, number)
    problem = Problem.from_tables("random", case.tables)
    guess = least_time_guess(problem, problem.start_pose())
    assert guess is not None
    assert swings is None or guess.swings == swings
    assert near != GRID or guess.switch_times_s is None  # its efforts along the limit are none of the two
    assert guess.duration_s == pytest.approx(case.duration if near != FINE_GRID else case.shortest, rel=near)


@pytest.mark.slow
@pytest.mark.parametrize("number", [13, 672])
def test_a_motion_that_turns_back_at_a_waypoint_takes_the_least_time_of_its_two_parts(number):
    """Left to a smooth path through the waypoint, a solver answers with one that is 5 % (13) or 46 % (672) slower."""
    case = random_case(1, number)
    problem = Problem.from_tables("by way of a turn", case.tables)
    guess = least_time_guess(problem, problem.start_pose())
    assert guess is not None
    assert guess.duration_s == pytest.approx(case.duration, rel=GRID)
    assert guess.position(guess.boundaries_s)[:, 0] == pytest.approx(
        [problem.motion.start[0], problem.motion.waypoints[0].position[0], problem.motion.goal[0]]
    )
    plan = plan_motion(problem)
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(case.duration, rel=MINIMUM_TIME)


def test_waypoints_on_the_way_are_passed_in_turn_and_change_nothing():
    problem = spring(1.9)
    way = replace(problem.motion, waypoints=tuple(Waypoint(position=[x]) for x in (1.5, 0.3)))
    guess = least_time_guess(problem, problem.start_pose())
    passed = least_time_guess(problem.varied(motion=way), problem.start_pose())
    assert guess is not None
    assert passed is not None
    assert passed.duration_s == pytest.approx(guess.duration_s, rel=GRID)
    assert passed.position(passed.boundaries_s)[:, 0] == pytest.approx([1.9, 1.5, 0.3, 0.0])


def test_a_speed_asked_at_a_waypoint_is_the_guesss_there():
    problem = spring(2.0)
    asked = replace(problem.motion, waypoints=(Waypoint(position=[1.0], speed=[-0.5]),))
    guess = least_time_guess(problem.varied(motion=asked), problem.start_pose())
    assert guess is not None
    assert guess.velocity(guess.boundaries_s)[:, 0] == pytest.approx([0.0, -0.5, 0.0], abs=SAME_FIGURE)


@pytest.mark.slow
def test_a_motion_that_there_is_no_time_for_is_not_tried_from_other_starts():
    plan = plan_motion(spring(10.0, max_duration_s=10.0))
    assert plan.status == "infeasible"
    assert not [step for step in plan.history if step.what.startswith("start from")]


def test_the_efforts_of_a_least_time_guess_change_at_its_switch_time_and_not_a_cell_off():
    """A pure inertia turns under full effort for half of the least time 2 sqrt(inertia turn / effort), then against it."""
    problem = body_problem(HINGE, QUARTER_TURN + 'duration_s = "free"\n', "objective.minimize=time")
    guess = least_time_guess(problem, problem.start_pose())
    least = 2 * np.sqrt(HINGE_INERTIA * TURN / 4.0)
    assert guess.duration_s == pytest.approx(least, rel=MINIMUM_TIME)
    (switch,) = guess.switch_times_s
    assert switch == pytest.approx(least / 2, rel=1e-2)  # of the grid
    at = switch + 1e-6 * least * np.array([-1.0, 1.0])
    assert guess.effort(np.array([0.0, *at, 0.999 * least]))[:, 0].tolist() == [4.0, 4.0, -4.0, -4.0]


ACCELERATION, SPEED = 3.0, 0.3
STOP = SPEED**2 / (2 * ACCELERATION)


def reach(start: float, goal: float, *, low: float = -2.0, high: float = 2.0, minimize: str = "time", **motion):
    ends = {"start_m": {"x": start}, "goal_m": {"x": goal}}
    return Problem.reach(cart(rail=f"{low} {high}"), **ends | motion, minimize=minimize)


@pytest.mark.parametrize("end", ["start", "goal"])
def test_a_start_or_goal_passed_away_from_the_other_takes_the_way_that_full_effort_takes(end):
    """It turns where full effort stops it, or takes a run up."""
    problem = reach(0.0, -1.0, **{f"{end}_speed_m_s": {"x": SPEED}})
    least = SPEED / ACCELERATION + 2 * np.sqrt((1.0 + STOP) / ACCELERATION)
    guess = least_time_guess(problem, problem.start_pose())
    assert guess is not None
    assert guess.duration_s == pytest.approx(least, rel=1e-3 if end == "start" else 2e-3)
    assert plan_motion(problem).objective == pytest.approx(least, rel=1e-6)


@pytest.mark.parametrize("beyond", [0.0, 0.25, 1.0])
def test_a_start_as_fast_as_it_may_be_brakes_into_the_goal_and_a_faster_one_comes_back_from_beyond(beyond):
    speed = 2.0
    stop = speed**2 / (2 * ACCELERATION)
    problem = reach(0.0, stop - beyond, start_speed_m_s={"x": speed})
    guess = least_time_guess(problem, problem.start_pose())
    assert guess is not None
    assert guess.duration_s == pytest.approx(speed / ACCELERATION + 2 * np.sqrt(beyond / ACCELERATION), rel=2e-3)
    assert guess.velocity(np.zeros(1))[0, 0] == pytest.approx(speed, rel=1e-3)


@pytest.mark.parametrize(("minimize", "duration"), [("time", "free"), ("effort", 2.0)])
def test_a_range_that_ends_before_the_stop_is_infeasible_and_the_sentence_names_it(minimize, duration):
    asked = {"minimize": minimize, "duration_s": duration, "start_speed_m_s": {"x": SPEED}}
    plan = plan_motion(reach(0.0, -1.0, high=0.97 * STOP, **asked))
    assert plan.status == "infeasible"
    assert "no effort within its limits stops the 0.3 m/s of joint x at the start" in plan.message
    assert plan.trajectory is None


def test_a_range_that_ends_just_behind_the_stop_is_not_refused():
    assert no_way_to_stop(reach(0.0, -1.0, high=1.001 * STOP, start_speed_m_s={"x": SPEED})) is None


def test_a_goal_speed_that_the_range_leaves_no_run_up_for_is_infeasible():
    plan = plan_motion(reach(0.5, -1.0, low=-1.0 - 0.97 * STOP, goal_speed_m_s={"x": SPEED}))
    assert plan.status == "infeasible"
    assert "gathers the 0.3 m/s of joint x at the goal" in plan.message


def test_a_goal_that_may_be_passed_at_speed_needs_no_stop_behind_it():
    quick = {"start_speed_m_s": {"x": SPEED}, "goal_speed_m_s": {"x": SPEED}}
    assert no_way_to_stop(reach(0.0, 0.5, high=0.5 + 0.5 * STOP, **quick)) is None
