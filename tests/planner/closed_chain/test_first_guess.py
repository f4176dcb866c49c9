"""First guesses: the path, its instants and durations, units of efforts, and the start of the nodes."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.planner.closed_chain.guess import (
    _shortest_duration,
    _smooth_path,
    boundary_times,
    first_guess,
    swinging_guesses,
)
from linkplan.planner.closed_chain.prescribed import rounded_down
from linkplan.planner.closed_chain.transcribe import choose_scales, own_objective, transcribe
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.refinement.constrained_arcs import interval_rows
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import uniform
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, body_problem
from tests.support.motions import motion_along
from tests.support.refinement_states import guessed
from tests.support.tolerances_planner import ROWS


@pytest.mark.parametrize(("start", "via", "goal"), [(-60.0, -20.0, 30.0), (60.0, 20.0, -30.0), (0.0, 50.0, 10.0)])
def test_the_path_passes_a_waypoint_at_the_mean_speed_unless_it_turns_there(start, via, goal):
    motion = (
        f'kind = "reach"\nstart_deg = {{ J = {start} }}\ngoal_deg = {{ J = {goal} }}\nduration_s = 1.5\n'
        f"waypoints = [{{ at_deg = {{ J = {via} }}, time_s = 0.5 }}]\n"
    )
    problem = body_problem(HINGE, motion)
    guess, time = first_guess(problem, problem.start_pose()), np.array([0.0, 0.5, 1.5])
    turns = (via - start) * (goal - via) < 0
    at_waypoint = 0.0 if turns else np.radians(goal - start) / 1.5
    np.testing.assert_allclose(guess.position(time)[:, 0], np.radians([start, via, goal]), atol=1e-12)
    np.testing.assert_allclose(guess.velocity(time)[:, 0], [0.0, at_waypoint, 0.0], atol=1e-9)


def test_swings_go_half_the_way_away_from_the_goal_or_half_the_way_past_it():
    """From -10 to 30 deg: back to -30 deg at four tenths of the time, or on to 50 deg at six tenths."""
    motion = 'kind = "reach"\nstart_deg = { J = -10.0 }\ngoal_deg = { J = 30.0 }\nduration_s = 2.0\n'
    back, past = swinging_guesses(body_problem(HINGE, motion), np.radians([-10.0]))
    for guess, at, turn in ((back, 0.8, -30.0), (past, 1.2, 50.0)):
        assert guess.duration_s == 2.0
        assert np.degrees(guess.position(np.array([0.0, at, 2.0]))[:, 0]) == pytest.approx([-10.0, turn, 30.0])
        assert guess.velocity(np.array([0.0, at, 2.0])) == pytest.approx(np.zeros((3, 1)), abs=1e-9)


@pytest.mark.parametrize("turns", [1, -2])
def test_a_turn_with_a_goal_passes_it_half_way_and_ends_whole_turns_beyond_its_start(turns):
    motion = (
        'kind = "periodic"\nstart_deg = { J = 20.0 }\ngoal_deg = { J = 70.0 }\nduration_s = 2.0\n'
        f"turns = {{ J = {turns} }}\n"
    )
    problem = body_problem(HINGE, motion)
    guess, time = first_guess(problem, problem.start_pose()), np.array([0.0, 1.0, 2.0])
    assert np.degrees(guess.position(time)[:, 0]) == pytest.approx([20.0, 70.0, 20.0 + 360.0 * turns])
    assert np.degrees(guess.velocity(time)[:, 0]) == pytest.approx(np.full(3, 180.0 * turns))


# A damped rod on a pivot, with a motor that pulls harder one way.
DAMPED = """<mujoco><option gravity="0 0 -{gravity}"/><worldbody><body name="rod">
<joint name="J" axis="0 1 0" damping="0.8"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-{low} {high}"/></actuator></mujoco>"""


def passing(*waypoints: str, start: float = 0.0, goal: float = 100.0, duration: str = '"free"') -> Problem:
    motion = (
        f'kind = "reach"\nstart_deg = {{ J = {start} }}\ngoal_deg = {{ J = {goal} }}\nduration_s = {duration}\n'
        f"waypoints = [{', '.join(waypoints)}]\n"
    )
    return body_problem(HINGE, motion, "objective.minimize=time" if "free" in duration else "objective.minimize=effort")


def test_free_waypoints_are_passed_at_times_in_proportion_to_the_way():
    problem = passing("{ at_deg = { J = 25.0 } }", "{ at_deg = { J = 75.0 } }")
    assert boundary_times(problem, 2.0) == pytest.approx([0.0, 0.5, 1.5, 2.0])


def test_a_waypoint_next_to_another_has_a_twentieth_of_the_time_of_the_longest_way():
    problem = passing("{ at_deg = { J = 0.0 } }")
    assert boundary_times(problem, 2.1) == pytest.approx([0.0, 0.1, 2.1])


def test_a_motion_ends_a_quarter_later_than_its_last_given_time_if_its_duration_is_guessed_shorter():
    problem = passing("{ at_deg = { J = 50.0 }, time_s = 0.8 }")
    assert boundary_times(problem, 0.5) == pytest.approx([0.0, 0.8, 1.0])
    assert boundary_times(problem, 1.5) == pytest.approx([0.0, 0.8, 1.5])


def test_each_waypoint_is_passed_at_the_mean_speed_around_it_or_the_one_asked_for():
    asked = "{ at_deg = { J = 60.0 }, time_s = 1.0, speed_deg_s = { J = 12.0 } }"
    first, last = "{ at_deg = { J = 20.0 }, time_s = 0.5 }", "{ at_deg = { J = 70.0 }, time_s = 1.5 }"
    problem = passing(first, asked, last, duration="2.5")
    guess = first_guess(problem, problem.start_pose())
    speeds = np.degrees(guess.velocity(np.array([0.0, 0.5, 1.0, 1.5, 2.5])))[:, 0]
    assert speeds == pytest.approx([0.0, 60.0 / 1.0, 12.0, 40.0 / 1.5, 0.0], abs=1e-6)


@pytest.mark.parametrize(
    ("start_speed", "gravity", "low", "high"),
    [(0.0, 9.81, 9.0, 9.0), (0.0, 9.81, 7.0, 12.0), (40.0, 0.0, 9.0, 9.0), (-60.0, 0.0, 8.0, 10.0)],
)
def test_the_shortest_duration_of_the_smooth_path_needs_exactly_the_effort_that_there_is(start_speed, gravity, low, high):
    motion = (
        'kind = "reach"\nstart_deg = { J = -20.0 }\ngoal_deg = { J = 50.0 }\nduration_s = "free"\n'
        f"start_speed_deg_s = {{ J = {start_speed} }}\n"
    )
    problem = body_problem(DAMPED.format(gravity=gravity, low=low, high=high), motion, "objective.minimize=time")
    duration = _shortest_duration(problem, problem.start_pose())
    assert 0.1 < duration < 2.0
    path = _smooth_path(problem, duration)
    time = np.linspace(0.0, duration, 121)
    poses = follow(problem.mechanism, path(time), problem.start_pose())
    effort, _ = needed_effort(problem.mechanism, poses, path.derivative()(time), path.derivative(2)(time))
    assert max(effort.max() - high, -low - effort.min()) == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("turns", [2, -1])
@pytest.mark.parametrize("waypoints", ["", "waypoints = [{ at_deg = { J = 40.0 } }]"])
def test_a_periodic_motion_goes_on_by_its_turns(turns, waypoints):
    motion = f'kind = "periodic"\nduration_s = 2.0\nturns = {{ J = {turns} }}\nstart_deg = {{ J = 10.0 }}\n{waypoints}\n'
    problem = body_problem(HINGE, motion)
    guess = first_guess(problem, problem.start_pose())
    assert np.degrees(guess.position(np.array([0.0, 2.0]))[:, 0]) == pytest.approx([10.0, 10.0 + 360.0 * turns])


# Units.


@pytest.mark.parametrize(
    ("limits", "minimised", "expected"),
    [
        ("-4 4", "effort", 10 / np.sqrt(3) * HINGE_INERTIA * np.pi / 2),  # the quintic's largest effort
        ("-4 4", "time", 4.0),
        ("-1 2", "effort", 2.0),
        ("-3 4", "time", 4.0),
    ],
)
def test_the_unit_of_an_effort_is_its_limit_or_what_a_slow_motion_needs(limits, minimised, expected):
    duration = '"free"' if minimised == "time" else "1.0"
    motion = QUARTER_TURN + f"duration_s = {duration}\n"
    problem = body_problem(HINGE.replace("-4 4", limits), motion, f"objective.minimize={minimised}")
    guess = first_guess(problem, problem.start_pose())
    scales = choose_scales(problem, guess)
    assert scales.effort == pytest.approx([expected], rel=2e-3)
    assert scales.residual == pytest.approx(scales.effort)
    assert scales.time_s == guess.duration_s


def turn_with(**origin) -> Transcribed:
    """Return the program of a turn with units of 3 s, 2 N.m and of 5 for the objective."""
    program = guessed(10).found.solution.transcribed
    scales = replace(program.origin.scales, effort=np.array([2.0]), time_s=3.0)
    formulation = replace(program.formulation, units=replace(program.units, objective=5.0))
    return replace(program, origin=replace(program.origin, scales=scales, **origin), formulation=formulation)


def with_effort(breaks_s: list[float], effort: np.ndarray) -> Trajectory:
    """Return a motion at rest with the coefficients of its efforts (degree + 1, n, n_u)."""
    still = np.zeros((2, effort.shape[1], 1))
    return motion_along(np.array(breaks_s), still, effort=effort)


@pytest.mark.parametrize(
    ("coefficients", "breaks", "integral"),
    [
        ([[0.0, 4.0], [4.0, 0.0]], [0.0, 1.0, 3.0], 2.0**2 * 1.0 + 1.0**2 * 2.0),
        ([[0.0], [0.0], [4.0]], [0.0, 1.0], 16.0 / 3.0),  # 2 tau^2 of the unit
        ([[0.0], [0.0], [0.0], [2.0]], [0.0, 2.0], 9.0 / 5.0 / 2.0),  # tau^3 of the unit
        ([[3.0, 1.0]], [0.0, 1.0, 3.0], 0.0),
    ],
)
def test_the_own_objective_is_without_the_smoothing_of_efforts(coefficients, breaks, integral):
    """smoothing x unit of the objective x unit of time x int (u' / U)^2 dt."""
    program = turn_with(smoothing=0.1, tie_weights=np.zeros(1))
    motion = with_effort(breaks, np.array(coefficients)[:, :, None])
    assert own_objective(program, 7.0, motion) == pytest.approx(7.0 - 0.1 * 5.0 * 3.0 * integral)


def test_the_own_objective_is_without_what_breaks_ties():
    """Weights x int u^2 dt of each actuator: of tau^2, and of 2."""
    effort = np.stack([[[0.0], [0.0], [1.0]], [[2.0], [2.0], [2.0]]], axis=2)
    program = turn_with(smoothing=0.0, tie_weights=np.array([0.5, 0.25]))
    found = own_objective(program, 7.0, with_effort([0.0, 3.0], effort))
    assert found == pytest.approx(7.0 - 0.5 * 3.0 / 5.0 - 0.25 * 4.0 * 3.0)


@pytest.mark.parametrize(("value", "rounded"), [(12.34567, 12.34), (0.01239999, 0.01239), (98765.0, 98760.0), (5.0, 5.0)])
def test_a_bound_is_rounded_down_to_four_digits(value, rounded):
    assert rounded_down(value) == pytest.approx(rounded, rel=1e-12)
    assert rounded_down(value) <= value


WORK = "objective.minimize=work"


@pytest.mark.parametrize(
    ("name", "overrides", "n_unknowns"),
    [
        ("five-bar-reach", [], 0),
        ("gripper-close", ["limits.power_w.pull=40"], 1),  # the cable's leverage
        ("five-bar-reach", ["limits.closure_force.E2=300"], 3),  # the components of a pin's force
        ("knee-reach", [WORK], 1),  # the positive power
        ("knee-sprint", [WORK, "limits.closure_force.B=3000"], 4),
        ("knee-reach", ["limits.jerk_deg_s3.A=1e6"], 1),  # the jerk of a dependent joint
    ],
)
def test_the_equations_of_a_node_hold_where_a_guess_starts_it(name, overrides, n_unknowns):
    problem = load_problem(name, overrides)
    guess = replace(first_guess(problem, problem.start_pose()), share_of_effort=1.0)
    program = transcribe(problem, guess, uniform(50), np.array([guess.duration_s]), enclosed=True)
    interval, mesh = program.program.interval, program.program.mesh
    assert program.program.layout.n_z == len(problem.mechanism.dependent) + n_unknowns
    n, n_rows = interval.n_nodes, interval.n_equations + interval.n_path
    of_nodes = interval_rows(program, program.start)[:, interval.n_own : interval.n_own + n * n_rows]
    rows = of_nodes.reshape(mesh.n_intervals, n, n_rows)[:, :, : interval.n_equations]
    kinds = np.array(interval.node_kinds[: interval.n_equations])
    assert np.abs(rows[:, :, ~np.isin(kinds, ["closure", "dynamics"])]).max(initial=0.0) < ROWS
    assert np.abs(rows[:, :, kinds == "closure"]).max() < ROWS
