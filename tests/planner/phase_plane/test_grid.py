"""The phase plane's grid: what lies around a place, and energies along it against the closed forms of single bodies."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.poses.along import sampled
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.phase_plane.grid import PhasePlane, _around, _drag, _kept, grid_of, plane_of
from linkplan.planner.problem.problem import Problem, load_problem
from tests.support.even_plane import even_plane

# A rod of 1 kg on a hinge, its centre 0.5 m below: m g l = 4.905 N.m and an inertia of 0.26 kg m2.
PENDULUM = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="rod"><joint name="J" axis="0 1 0" {joint}/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-6 8"/></actuator></mujoco>"""
WEIGHT, INERTIA, DAMPING, FRICTION = 4.905, 0.26, 0.3, 0.7
# Simpson's rule over steps of a hundredth of a radian, of the weight.
QUADRATURE = 1e-9


def pendulum(joint: str = "", start_deg: float = -30.0, goal_deg: float = 60.0, **tables) -> Problem:
    motion = {"kind": "reach", "start_deg": {"J": start_deg}, "goal_deg": {"J": goal_deg}, "duration_s": "free"}
    given = {"mechanism": {"model": PENDULUM.format(joint=joint)}, "motion": motion, "objective": {"minimize": "time"}}
    return Problem.from_tables("pendulum", given | tables)


def grid(problem: Problem, n_cells: int = 200, **how) -> tuple[np.ndarray, np.ndarray]:
    places = np.array([problem.motion.start[0], problem.motion.goal[0]])
    return grid_of(problem, places, problem.start_pose(), n_cells, **how)


def plane(problem: Problem, n_cells: int = 200) -> PhasePlane:
    return plane_of(problem, *grid(problem, n_cells), problem.limits.effort)


@pytest.mark.parametrize(
    ("place", "forbidden", "left"),
    [(3.0, [2], (2.0, 4.0)), (1.0, [6], (0.0, 2.0)), (2.0, [1, 7], (1.0, 3.0)), (2.0, [], (0.0, 4.0))],
    ids=["below", "above", "on both sides, between places", "nowhere"],
)
def test_a_grid_is_cut_next_to_the_first_pose_that_is_not_allowed(place, forbidden, left):
    s, poses = np.linspace(0.0, 4.0, 5), np.linspace(0.0, 4.0, 9)[:, None]
    within = np.ones(9, dtype=bool)
    within[forbidden] = False
    kept, at = _around(place, s, poses, within)
    assert (kept[0], kept[-1]) == left
    assert np.array_equal(at[::2, 0], kept)


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("step", [+1, -1])
@pytest.mark.parametrize("push", [+1, -1])
def test_along_a_leg_the_energy_changes_by_the_work_of_force_and_dry_friction(step, push, backwards):
    """M (w - w_0) = (F - R sign v) (s - s_0), until nothing is left: F of 3 N, R of 1 N, 2 kg."""
    leg = even_plane(force=3.0, rub=1.0).leg(200, 1.995, step, push, backwards=backwards)
    moves = -step if backwards else step
    gain = step * (3.0 * push - moves * 1.0) / 2.0  # per metre of the leg
    expected = 1.995 + gain * 0.01 * np.arange(201)
    np.testing.assert_allclose(leg, expected[expected > 0], rtol=1e-10)


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("step", [+1, -1])
def test_a_damper_takes_speed_in_proportion_to_the_way(step, backwards):
    """M v dv/ds = -c v: the speed falls by c / M for each metre, here 1.5 N.s/m over 2 kg."""
    leg = even_plane(drag=1.5).leg(200, 2.0, step, +1, backwards=backwards)
    speed = 2.0 + (1.0 if backwards else -1.0) * 1.5 / 2.0 * 0.01 * np.arange(201)
    np.testing.assert_allclose(np.sqrt(2 * leg), speed, rtol=1e-4)


@pytest.mark.parametrize(("force", "moves"), [(1.01, True), (0.99, False)])
@pytest.mark.parametrize("step", [+1, -1])
def test_rest_is_left_only_where_the_push_exceeds_dry_friction(step, force, moves):
    assert len(even_plane(force=force, rub=1.0).leg(200, 0.0, step, step)) == (201 if moves else 1)
    # A leg that brakes to rest exists whatever friction adds.
    assert len(even_plane(force=force, rub=1.0).leg(200, 0.0, step, step, backwards=True)) == 201


@pytest.mark.parametrize("rub", [0.0, 1.0])
def test_a_leg_keeps_below_what_is_largest_at_each_place_and_ends_where_nothing_may_pass(rub):
    plane = even_plane(force=3.0, rub=rub)
    gain = (3.0 - rub) / 2.0 * 0.01
    most = np.full(401, np.inf)
    most[210] = 0.05
    limited = replace(plane, top={+1: most, -1: np.zeros(401)})
    leg = limited.leg(200, 0.0, +1, +1)
    assert leg[9:12] == pytest.approx([9 * gain, 0.05, 0.05 + gain])
    assert plane.leg(200, 0.0, +1, +1, below=most)[9:12] == pytest.approx([9 * gain, 0.05, 0.05 + gain])
    most[220] = 0.0
    assert len(limited.leg(200, 0.0, +1, +1)) == 20
    assert len(limited.leg(200, 0.0, -1, -1)) == 1


def test_a_plane_over_a_pendulum_has_its_work_forces_friction_and_speeds():
    problem = pendulum(f'damping="{DAMPING}" frictionloss="{FRICTION}"', limits={"speed_deg_s": {"J": [-200.0, 300.0]}})
    found = plane(problem)
    s = found.s
    np.testing.assert_allclose(found.inertia, INERTIA)
    np.testing.assert_allclose(found.drag, -DAMPING, rtol=1e-6)
    np.testing.assert_allclose(found.rub, FRICTION)
    for way, effort in ((+1, 8.0), (-1, -6.0)):
        np.testing.assert_allclose(found.force[way], effort - WEIGHT * np.sin(s), atol=1e-9)
        work = effort * (s - s[0]) + WEIGHT * (np.cos(s) - np.cos(s[0]))
        np.testing.assert_allclose(found.work[way], work, atol=QUADRATURE * WEIGHT)
        np.testing.assert_array_equal(found.effort[way], effort)
        # Full effort exceeds the weight everywhere: it can always brake, and only the speed itself is limited.
        np.testing.assert_allclose(found.top[way], 0.5 * np.radians(200.0) ** 2)


@pytest.mark.parametrize(
    ("both", "rub", "drag"), [(-0.4, 0.0, -0.4), (-2.5, 2.0, -0.5), (-2.0 - 1e-7, 2.0, 0.0), (-1.9, 2.0, 0.0)]
)
def test_a_damper_is_what_dry_friction_leaves_of_the_force_at_a_speed(both, rub, drag):
    assert _drag(np.array([both]), np.array([rub])) == pytest.approx(drag)


@pytest.mark.parametrize(("way", "expected"), [(+1, [4, 3, 2, 1, 9, 9]), (-1, [9, 9, 9, 1, 2, 3])])
def test_before_a_slow_place_a_motion_brakes_in_time(way, expected):
    """2 kg at w of at most 9, but for 1 at the fourth place; from place to place braking takes 2 J."""
    fastest, work = np.array([9.0, 9, 9, 1, 9, 9]), -way * 2.0 * np.arange(6)
    np.testing.assert_allclose(_kept(fastest, np.full(6, 2.0), work, way), expected)
    unlimited = np.full(6, np.inf)
    np.testing.assert_array_equal(_kept(unlimited, np.full(6, 2.0), work, way), unlimited)


@pytest.mark.parametrize(("goal_deg", "beyond"), [(60.0, 2 * np.pi), (330.0, 1.5 * np.radians(360.0))])
def test_a_crank_that_turns_fully_may_go_a_turn_or_one_and_a_half_ways_beyond_its_ends(goal_deg, beyond):
    s, _ = grid(pendulum(goal_deg=goal_deg))
    low, high = np.radians([-30.0, goal_deg])
    assert [s[0], s[-1]] == pytest.approx([low - beyond, high + beyond], abs=2e-3 * (high - low + 2 * beyond))


def test_a_place_out_of_the_range_has_no_grid():
    problem = pendulum('range="-40 100"')
    for goal_deg, known in ((99.0, True), (101.0, False)):
        places = np.radians([-30.0, goal_deg])
        assert (grid_of(problem, places, problem.start_pose(), 50) is not None) is known


def test_a_grid_ends_at_the_narrower_of_reach_and_limits():
    s, _ = grid(pendulum('range="-40 100"', limits={"range_deg": {"J": [-35.0, 80.0]}}))
    assert np.degrees([s[0], s[-1]]) == pytest.approx([-35.0 + 0.115, 80.0 - 0.115], abs=1e-3)
    problem = load_problem("knee-sprint")
    s, poses = grid(problem, 100)
    joint = problem.mechanism.independent[0]
    low, high = problem.limits.position[joint]
    assert low <= s[0] < s[-1] <= high
    np.testing.assert_allclose(poses[::2, joint], s, atol=1e-12)


def test_the_largest_speed_is_that_of_the_joint_that_reaches_its_limit_first():
    problem = load_problem("knee-sprint", ["limits.speed_deg_s.O=300", "limits.speed_deg_s.A=100"])
    s, poses = grid(problem, 50)
    fastest = np.sqrt(2 * np.minimum(*plane_of(problem, s, poses, problem.limits.effort).top.values()))
    rates = np.abs(sampled(problem.mechanism.dynamics.velocity_map, poses[::2])[:, :, 0]) * fastest[:, None]
    limits = problem.limits.speed[:, 1]
    assert np.all(rates <= (1 + 1e-9) * limits)
    at_limit = np.isclose(rates, limits, rtol=1e-9).any(axis=0)
    names = [joint.name for joint in problem.mechanism.joints]
    assert at_limit[names.index("A")]


def test_a_grid_keeps_the_margin_to_singular_poses():
    free, kept = (load_problem("knee-sprint", [f"limits.singular_margin={margin}"]) for margin in (0.0, 0.1))
    ratios = [singularity_ratios(problem, grid(problem, 100)[1]) for problem in (free, kept)]
    assert ratios[0].min() < 0.1 <= ratios[1].min()
