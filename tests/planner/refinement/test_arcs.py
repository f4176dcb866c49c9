"""Switches and arcs that are read from a motion."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.constrained_arcs import (
    arc_ends,
    find_constrained_paths,
    off_limit_intervals,
    own_arcs,
    path_arcs,
)
from linkplan.planner.refinement.switches import (
    _pulse_in,
    _spread,
    at_bounds,
    find_bang_efforts,
    find_switch_times,
    settle_switch_times,
)
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.solving import first_mesh
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import uniform
from linkplan.planner.transcription.schemes import NAMES, scheme
from tests.support.bodies import HINGE, QUARTER_TURN, UNIT_ARM, body_plan, body_problem
from tests.support.fourbar_problems import random_case
from tests.support.motions import motion_along
from tests.support.plans import optimal
from tests.support.tolerances_planner import LEAST_TIME_ON_ARCS, ON_THE_ARC, UNIT

NAN = np.nan


@pytest.mark.slow
@pytest.mark.parametrize(("number", "is_driven"), [(92, False), (136, False), (94, True), (236, True), (365, True)])
def test_a_speed_limit_is_entered_followed_and_left_in_the_least_time(number, is_driven):
    """The phase plane's trapezia know the least time of a four-bar one of whose joints may only turn so fast.

    Two of the driven ones touch the limit where effort and its own limit let them: in an instant, not at a corner.
    """
    case = random_case(1, number)
    assert case.kind == "speed limit"
    assert (case.notes["limited"] == "O") is is_driven
    plan = plan_motion(Problem.from_tables("limited", case.tables))
    assert plan.status == "optimal", plan.message
    assert plan.trajectory.duration_s == pytest.approx(case.duration, rel=LEAST_TIME_ON_ARCS)


@pytest.mark.parametrize(("speed", "share"), [(9.0, 2.5), (9.0, 0.4), (1.2, 2.5)])
def test_an_acceleration_jumps_from_limit_to_limit_inside_an_interval_in_the_least_time(speed, share):
    """An arm of unit inertia brakes at up to 2 rad/s2 and accelerates at up to a multiple of it; its motor has 9 N.m."""
    up, down, angle = 2.0 * share, 2.0, 1.6
    fastest = min(speed, np.sqrt(2 * angle / (1 / up + 1 / down)))
    least = fastest / up + fastest / down + (angle - fastest**2 / 2 * (1 / up + 1 / down)) / fastest
    limits = np.degrees([-down, up, speed, angle])
    plan = body_plan(
        UNIT_ARM,
        f'kind = "reach"\nstart_deg = {{ J = 0.0 }}\ngoal_deg = {{ J = {limits[3]} }}\n',
        "objective.minimize=time",
        f"limits.acceleration_deg_s2.J=[{limits[0]}, {limits[1]}]",
        f"limits.speed_deg_s.J={limits[2]}",
    )
    assert plan.status == "optimal", plan.message
    assert plan.trajectory.duration_s == pytest.approx(least, rel=LEAST_TIME_ON_ARCS)


@pytest.mark.slow
def test_a_curve_that_its_coefficients_keep_off_its_limit_is_found():
    problem = Problem.from_tables("limited", random_case(1, 365).tables)
    guess = first_guess(problem, problem.start_pose())
    mesh, durations = first_mesh(problem, guess)
    case = case_of(problem)
    first = attempt(case, guess, mesh, durations, "first solve")
    settled = settle_switch_times(case, first)
    motion, solution = settled.motion, settled.solution
    off = off_limit_intervals(solution.transcribed, solution.x)
    fastest = np.abs(motion.velocity[:, :, 0])
    limit = problem.limits.speed[0, 1]
    assert off.any()
    assert np.all(fastest[:, off].max(axis=0) > limit * (1 - 1e-7))  # their coefficients are at the limit
    inside = np.abs(motion.velocity_at(np.linspace(0.0, motion.duration_s, 4000))[:, 0])
    k = np.searchsorted(motion.breaks_s, np.linspace(0.0, motion.duration_s, 4000), side="right") - 1
    assert max(inside[k == interval].max() for interval in np.flatnonzero(off)) < limit * (1 - 1e-7)  # they are not


@pytest.mark.slow
def test_a_plan_along_a_power_limit_is_at_it_on_one_arc_and_nowhere_else():
    plan = optimal("knee-sprint", "limits.power_w.act_O=[-1e6,900]")
    motion, gear = plan.trajectory, plan.problem.mechanism.actuators[0].gear
    time = motion.dense_times(20)
    power = motion.effort_at(time)[:, 0] * gear * motion.velocity_at(time)[:, 0]
    along = np.flatnonzero(power > 900.0 * (1 - ON_THE_ARC))
    assert len(along) > 20
    np.testing.assert_array_equal(np.diff(along), 1)  # one arc
    np.testing.assert_allclose(power[along], 900.0, rtol=ON_THE_ARC)
    assert power[: along[0]].max() < 900.0


def test_ends_of_arcs_are_cuts_but_for_those_near_a_cut_or_a_knot():
    arcs = np.zeros((20, 1), dtype=int)
    arcs[8:14] = 1
    breaks = np.linspace(0.0, 2.0, 21)
    boundaries = breaks[[0, -1]]
    np.testing.assert_allclose(arc_ends(arcs, breaks, np.array([]), boundaries), [0.8, 1.4])
    np.testing.assert_allclose(arc_ends(arcs, breaks, np.array([0.85]), boundaries), [1.4])
    np.testing.assert_allclose(arc_ends(arcs[8:], breaks[8:] - 0.8, np.array([]), np.array([0.0, 1.2])), [0.6])


def test_segments_hold_what_all_their_inner_intervals_follow_and_no_more_than_efforts_are_free():
    breaks = np.linspace(0.0, 1.0, 11)
    arcs = np.zeros((10, 2), dtype=int)
    arcs[2:6, 0], arcs[6:, 1] = 1, -1
    arcs[6:, 0] = 1
    bang_efforts = np.array([[NAN], [NAN], [NAN]])
    fixed = find_constrained_paths(arcs, breaks, np.array([0.0, 0.2, 0.6, 1.0]), bang_efforts)
    np.testing.assert_array_equal(fixed, [[0, 0], [1, 0], [1, 0]])  # one effort bears one path quantity
    bang_efforts[1] = 3.0
    assert not find_constrained_paths(arcs, breaks, np.array([0.0, 0.2, 0.6, 1.0]), bang_efforts)[1].any()


def with_efforts(efforts: list[float]) -> Trajectory:
    """Return a motion of one second at rest whose effort is constant over each interval."""
    flat = np.zeros((3, len(efforts), 1))
    return motion_along(np.linspace(0.0, 1.0, len(efforts) + 1), flat, effort=np.array(efforts).reshape(1, -1, 1))


UNIT_LIMIT = np.array([[-1.0, 1.0]])


def test_a_short_arc_along_a_path_limit_is_no_smeared_switch():
    motion = with_efforts([1.0, 1.0, 1.0, 1.0, 0.4, 0.2, -1.0, -1.0, -1.0, -1.0])
    on_path = np.isin(np.arange(10), [4, 5])
    assert len(find_switch_times(motion, UNIT_LIMIT)) == 1
    np.testing.assert_allclose(find_switch_times(motion, UNIT_LIMIT, on_path=on_path), [0.4, 0.6])


def test_a_pulse_shorter_than_an_interval_is_cut_out_by_its_impulse():
    motion = with_efforts([1.0, 1.0, 1.0, 0.4, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(find_switch_times(motion, UNIT_LIMIT, short=True), [0.335, 0.365])
    assert len(find_switch_times(motion, UNIT_LIMIT)) == 0


def test_a_bang_shorter_than_an_interval_next_to_a_waypoint_or_an_end_is_cut_off_by_its_impulse():
    motion = with_efforts([-0.6, 1.0, 1.0, 1.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0])
    switch_times = find_switch_times(motion, UNIT_LIMIT, np.array([0.0, 0.5, 1.0]), short=True)
    np.testing.assert_allclose(switch_times, [0.08, 0.475])


@pytest.mark.parametrize("name", NAMES)
def test_polynomials_are_taken_to_the_ends_at_which_no_node_stands(name):
    constants = scheme(name)
    ends = np.array(constants.open_ends, dtype=float)
    expected = {"radau": [0.0], "gauss": [0.0, 1.0]}.get(name.split("-")[0], [])
    np.testing.assert_array_equal(ends, expected)
    for power in range(constants.n_nodes):
        np.testing.assert_allclose(constants.at_open_ends @ constants.nodes**power, ends**power, atol=UNIT * 1e3)


LIMIT = np.array([[-5.0, 5.0]])


def motion(*coefficients: list[float], breaks: np.ndarray | None = None) -> Trajectory:
    """Return a motion at rest with the effort's coefficients (degree + 1, n) on intervals of a second."""
    effort = np.array(coefficients, dtype=float)[:, :, None]
    n = effort.shape[1]
    breaks = 10.0 + np.arange(n + 1.0) if breaks is None else breaks
    still = {"position": np.zeros((2, n, 1)), "velocity": np.zeros((1, n, 1)), "start_pose": np.zeros(1)}
    return Trajectory(breaks_s=breaks, effort=effort, periodic=False, **still)


@pytest.mark.parametrize(("smeared", "switches"), [(1, [11.5]), (3, [12.5]), (4, [11.0, 15.0])])
def test_up_to_three_intervals_between_two_limits_are_one_smeared_switch_and_more_an_arc(smeared, switches):
    found = find_switch_times(motion([5.0, *[0.0] * smeared, -5.0]), LIMIT)
    assert found == pytest.approx(switches)


@pytest.mark.parametrize(("first", "last"), [(5.0, -5.0), (-5.0, 5.0)])
def test_an_interval_in_which_the_effort_goes_from_one_limit_to_the_other_is_at_neither(first, last):
    found = find_switch_times(motion([first, first, last], [first, last, last]), LIMIT)
    assert found == pytest.approx([11.5])


@pytest.mark.parametrize("continuous", [False, True])
def test_efforts_without_jumps_leave_one_limit_and_come_to_the_other_at_the_ends_of_what_is_between(continuous):
    found = find_switch_times(motion([5.0, 1.0, -5.0]), LIMIT, continuous_efforts=continuous)
    assert found == pytest.approx([11.0, 12.0] if continuous else [11.6])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_arc_within_the_limits_begins_and_ends_where_the_impulse_of_its_first_and_last_interval_says(sign):
    """Along the arc the effort is 1: three tenths of its first interval are at 5, six tenths of its last at -5."""
    efforts = [5.0, 0.3 * 5 + 0.7 * 1, 1.0, 1.0, 1.0, 0.4 * 1 + 0.6 * -5, -5.0]
    found = find_switch_times(motion((sign * np.array(efforts)).tolist()), LIMIT)
    assert found == pytest.approx([11.3, 15.4])


def test_bang_efforts_are_those_between_the_switches_of_each_segment():
    found = find_bang_efforts(motion([5.0, 2.0, -5.0]), np.array([[-5.0, 5.0]]), np.array([11.0, 12.0]))
    np.testing.assert_array_equal(found, [[5.0], [np.nan], [-5.0]])
    free = find_bang_efforts(motion([5.0, 2.0, -5.0]), np.array([[-np.inf, 5.0]]), np.array([11.0, 12.0]))
    assert np.isnan(free).all()


@pytest.mark.parametrize(
    ("switches", "kept"),
    [
        ([[10.005]], []),  # within a tenth of half the smallest interval from the beginning
        ([[10.02]], [10.02]),
        ([[10.995]], []),
        ([[10.98]], [10.98]),
        ([[10.3], [10.38]], [10.3]),  # within half the smallest interval of another one
        ([[10.3], [10.45]], [10.3, 10.45]),
        ([[10.45], [10.3]], [10.3, 10.45]),
        ([[10.3, 10.35]], [10.3, 10.35]),  # the two of a pulse
        ([[10.005, 10.3]], []),
    ],
)
def test_switches_next_to_each_other_or_to_a_boundary_are_one(switches, kept):
    breaks, boundaries = np.array([10.0, 10.2, 11.0]), np.array([10.0, 11.0])
    assert _spread(switches, breaks, boundaries, 0.1) == pytest.approx(kept)


@pytest.mark.parametrize(
    ("means", "pulse"),
    [
        ([0.0, 5.0], [0.25, 0.75]),
        ([-5.0, 0.0], [0.0833333333, 1.5833333333]),
        ([-7.0, 5.0], [0.0, 1.2]),
        ([5.0, -7.0], [0.8, 2.0]),
    ],
)
def test_a_pulse_lasts_as_long_as_its_impulse_and_stays_within_its_intervals(means, pulse):
    """From 5 to -5 and back, in two intervals of a second; efforts may be beyond a limit by what the solver leaves."""
    found = _pulse_in(np.arange(3.0), np.array([means]), (5.0, -5.0))
    assert found == pytest.approx(pulse)


# Power of the hinge's motor [W].
LOW, HIGH = -2.0, 4.0
POWER = f"limits.power_w.motor=[{LOW}, {HIGH}]"


def program_of(*overrides: str) -> Transcribed:
    """Return the program of a hinge's quarter turn on four intervals."""
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 4.0\n", *overrides)
    return case_of(problem).transcribe(first_guess(problem, problem.start_pose()), uniform(4), np.array([4.0]))


def unknowns(transcribed: Transcribed, speed, power=0.0, slope=(0.0, 0.0, 0.0, 0.0)) -> np.ndarray:
    """Return unknowns with a speed (5,) at the breaks, an acceleration from -slope to slope and a power [W] (4,)."""
    layout, x = transcribed.program.layout, np.array(transcribed.start)
    x[layout.states()[:, 1]] = speed
    x[layout.acceleration()[:, :, 0]] = np.outer(slope, 2 * np.array(transcribed.scheme.nodes) - 1)
    units = transcribed.units
    x[layout.effort()[:, :, 0]] = (power / (units.effort[0] * units.state[1] * np.array(speed)[:-1]))[:, None]
    return x


def test_an_interval_is_an_arc_where_all_of_its_coefficients_are_at_one_limit():
    transcribed = program_of("limits.speed_deg_s.J=[-20.0, 40.0]")
    ((low, high),) = transcribed.formulation.own["speed"]
    x = unknowns(transcribed, [high, high, low, 0.1, 0.1], slope=[0.0, 1.0, 0.0, 0.0])
    assert own_arcs(transcribed, x, ("speed",)).ravel().tolist() == [1, 0, -1, 0]
    assert own_arcs(transcribed, x, ("motor",)).shape == (4, 0)


def test_an_interval_is_an_arc_of_a_path_limit_where_all_of_its_nodes_are_at_one_limit():
    transcribed = program_of(POWER)
    x = unknowns(transcribed, np.ones(5), np.array([HIGH, HIGH, LOW, 0.0]), slope=[0.0, 1.0, 0.0, 0.0])
    assert path_arcs(transcribed, x).ravel().tolist() == [1, 0, -1, 0]


def test_the_positive_power_of_least_work_is_on_no_arc_where_it_is_the_power():
    transcribed = program_of("objective.minimize=work")
    assert "work" in transcribed.program.interval.node_kinds
    x = unknowns(transcribed, np.ones(5), np.array([HIGH, HIGH, LOW, 0.0]))
    assert not path_arcs(transcribed, x).any()


def test_arcs_along_a_limit_on_the_size_of_a_jerk_end_where_it_reverses_and_are_not_held():
    """A limit on power is treated as one on a jerk. The accelerations' slopes are too small to change the power."""
    transcribed = program_of(POWER)
    rows = replace(transcribed.formulation.rows, jerk_path=(0,))
    transcribed = replace(transcribed, formulation=replace(transcribed.formulation, rows=rows))
    x = unknowns(transcribed, np.ones(5), np.array([HIGH, 0.0, HIGH, HIGH]), slope=np.array([1, 1, 1, -1]) * 1e-9)
    assert own_arcs(transcribed, x, ("jerk",)).ravel().tolist() == [1, 0, 1, -1]
    assert own_arcs(transcribed, x, ("speed",)).size == 0
    assert not path_arcs(transcribed, x).any()


def test_a_path_equation_is_no_arc():
    transcribed = program_of(POWER)
    fixed = replace(transcribed.formulation, path=transcribed.formulation.path[..., 1:].repeat(2, axis=-1))
    x = unknowns(transcribed, np.ones(5), np.full(4, HIGH))
    assert path_arcs(transcribed, x).any()
    assert not path_arcs(replace(transcribed, formulation=fixed), x).any()


@pytest.mark.parametrize(
    ("switch", "boundary", "ends"),
    [
        (3.0, 9.0, [1.0]),  # intervals of 0.1 s and 0.4 s meet there
        (1.9, 9.0, []),  # within 2.5 of the longer ones
        (2.1, 9.0, [1.0]),
        (3.0, 1.0, []),
        (3.0, 1.04, []),  # within half of the shorter one
        (3.0, 1.1, [1.0]),
    ],
)
def test_an_arc_ends_where_no_switch_and_no_phase_boundary_is_near(switch, boundary, ends):
    breaks = np.array([0.8, 0.9, 1.0, 1.4, 1.8])
    arcs = np.array([[0], [0], [1], [1]])
    assert arc_ends(arcs, breaks, np.array([switch]), np.array([boundary])).tolist() == ends


@pytest.mark.parametrize(
    ("breaks", "arcs"),
    [
        # Intervals next to the ends of the segment from 1 to 2 do not count, nor those that reach out of it.
        (np.linspace(0.0, 3.0, 31), [0] * 11 + [1] * 8 + [0] * 11),
        ([0.0, 0.8, 1.3, 1.6, 2.4, 3.0], [0, 0, 1, 0, 0]),
    ],
)
def test_a_segment_follows_a_limit_if_all_intervals_well_within_it_do(breaks, arcs):
    free = np.full((3, 1), np.nan)
    held = find_constrained_paths(np.array(arcs)[:, None], np.array(breaks), np.arange(4.0), free)
    assert held.tolist() == [[0], [1], [0]]


@pytest.mark.parametrize(("duration", "at_bound"), [(1.0, True), (3.0, False), (9.0, True)])
def test_a_duration_as_short_or_as_long_as_it_may_be_is_at_its_bound(duration, at_bound):
    transcribed = program_of()
    place = transcribed.program.layout.durations()
    lower, upper, x = (np.array(values) for values in (transcribed.lower, transcribed.upper, transcribed.start))
    lower[place], upper[place], x[place] = 1.0, 9.0, duration
    transcribed = replace(transcribed, lower=lower, upper=upper)
    result = {"objective": 0.0, "converged": True, "status": "", "iterations": 0, "build_s": 0.0, "solve_s": 0.0}
    assert at_bounds(Solution(transcribed=transcribed, x=x, **result)) is at_bound
