"""The grid of the phase plane, and efforts and accelerations at its states."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.models.poses.along import sampled
from linkplan.planner.limits.actuators import PowerLimit
from linkplan.planner.limits.efforts import EffortLimit
from linkplan.planner.limits.limit import Limit
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.phase_plane.grid import PhasePlane, _around, _drag, _kept, grid_of, plane_of
from linkplan.planner.phase_plane.leg_field import AT_EFFORT, AffineBounds, LegField
from linkplan.planner.phase_plane.power_legs import Leg
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
    ends = {"start_deg": {"J": start_deg}, "goal_deg": {"J": goal_deg}}
    return Problem.reach(PENDULUM.format(joint=joint), **ends, minimize="time", **tables)


def grid(problem: Problem, n_cells: int = 200, **how) -> tuple[np.ndarray, np.ndarray]:
    places = np.array([problem.motion.start[0], problem.motion.goal[0]])
    return grid_of(problem, places, problem.start_pose(), n_cells, **how)


def plane(problem: Problem, n_cells: int = 200) -> PhasePlane:
    return plane_of(problem, *grid(problem, n_cells))


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
    fastest = np.sqrt(2 * np.minimum(*plane_of(problem, s, poses).top.values()))
    rates = np.abs(sampled(problem.mechanism.dynamics.velocity_map, poses[::2])[:, :, 0]) * fastest[:, None]
    limits = problem.limits.speed[:, 1]
    assert np.all(rates <= (1 + 1e-9) * limits)
    at_limit = np.isclose(rates, limits, rtol=1e-9).any(axis=0)
    names = [joint.name for joint in problem.mechanism.joints]
    assert at_limit[names.index("A")]


def test_a_grid_keeps_the_margin_to_singular_poses():
    free, kept = (load_problem("knee-sprint", [f"limits.singular_margin={margin}"]) for margin in (0.0, 0.1))
    ratios = [singularity_ratios(problem.mechanism, grid(problem, 100)[1]) for problem in (free, kept)]
    assert ratios[0].min() < 0.1 <= ratios[1].min()


SPEED = 2.0


# The acceleration without effort, and that of a unit of effort, on which these pin forces do not depend.
NO_ACCELERATION = np.zeros((2, 1))[:, 0]


def pin(still: tuple, by_effort: tuple, square: tuple = (0.0, 0.0), linear: tuple = (0.0, 0.0)) -> AffineBounds:
    """Return the forces of one pin with two components, in shares of its rating."""
    curves = np.array([still, square, linear, (0.0, 0.0), by_effort])
    return AffineBounds(curves=lambda _: curves, rows=(slice(0, 2),), bounds=np.array([[-np.inf, 1.0]]))


@pytest.mark.parametrize("still", [(0.6, 0.0), (0.0, 0.6), (-0.6, 0.3)])
def test_at_the_least_and_largest_effort_a_pin_bears_its_rating(still):
    by = np.array([0.5, 0.25])
    least, most, over = pin(still, tuple(by)).efforts(0.0, SPEED, *NO_ACCELERATION)
    assert over < 0
    assert least[0] < most[0]
    for effort in (least[0], most[0]):
        assert np.linalg.norm(np.array(still) + by * effort) == pytest.approx(1.0, rel=1e-12)


def test_a_pin_force_grows_with_speed_and_its_square():
    moving = pin((0.1, 0.0), (0.5, 0.0), square=(0.05, 0.0), linear=(-0.03, 0.0)).efforts(0.0, SPEED, *NO_ACCELERATION)
    still = pin((0.1 + 0.05 * SPEED**2 - 0.03 * SPEED, 0.0), (0.5, 0.0)).efforts(0.0, 0.0, *NO_ACCELERATION)
    np.testing.assert_allclose(moving, still)


def test_beyond_what_any_effort_relieves_a_pin_bears_none():
    least, most, over = pin((0.0, 1.5), (0.5, 0.0)).efforts(0.0, SPEED, *NO_ACCELERATION)
    assert over > 0
    assert least == most == pytest.approx(0.0)


def field(power: float, way: float = 1.0) -> LegField:
    """Return the field of 2 a = 1 - 0.5 v^2 - 0.25 v + 3 u, with u from -4 to 5."""
    curves = np.array([2.0, 1.0, -0.5, -0.25, 3.0])
    limits = SimpleNamespace(effort=np.array([[-4.0, 5.0]]), power=np.array([[-power, power]]))
    return LegField(curves=lambda _: curves, bounds=bounds_of(limits, EffortLimit, PowerLimit), way=way)


def bounds_of(limits: SimpleNamespace, *kinds: type[Limit]) -> tuple:
    """Return the bounds on efforts of kinds of limits."""
    every = (kind.effort_bounds(SimpleNamespace(limits=limits)) for kind in kinds)
    return tuple(one for one in every if one is not None)


@pytest.mark.parametrize(("way", "towards", "effort"), [(1, True, 5), (1, False, -4), (-1, True, -4), (-1, False, 5)])
def test_without_a_power_limit_the_effort_that_pushes_or_brakes_is_at_its_limit(way, towards, effort):
    held, efforts, a = field(np.inf, way).at(0.0, way * SPEED, towards=towards)
    assert (held[0], efforts[0]) == (np.sign(effort), effort)
    assert a == pytest.approx((1.0 - 0.5 * SPEED**2 - 0.25 * way * SPEED + 3 * effort) / 2)


@pytest.mark.parametrize(("towards", "sign"), [(True, 1), (False, -1)])
def test_where_the_effort_s_limit_exceeds_the_power_the_power_is_held(towards, sign):
    held, efforts, _ = field(12.0).at(0.0, SPEED, towards=towards)
    assert held[0] == sign * (AT_EFFORT + 1)
    assert efforts[0] * 3 * SPEED == pytest.approx(sign * 12.0)


@pytest.mark.parametrize(("still", "keeps"), [(0.0, True), (4.0, False), (-4.0, False)])
def test_a_state_is_kept_only_by_an_effort_that_the_actuator_and_the_pin_both_bear(still, keeps):
    """The pin bears efforts from -2 - 2 F to 2 - 2 F, F its force without effort, and the actuator from -4 to 5."""
    limited = replace(field(np.inf), affine=pin((still, 0.0), (0.5, 0.0)))
    at, speed = np.zeros(1), np.array([SPEED])
    limited = replace(limited, curves=lambda _: np.array([[2.0, 1.0, -0.5, -0.25, 3.0]]))
    for towards in (True, False):
        assert limited.keeps(at, speed, limited.at(at, speed, towards=towards)[1]) is keeps


def two_pins(first: tuple[float, float], second: tuple[float, float]) -> AffineBounds:
    """Return two pins that bear efforts between these: |F + u / 2| <= 1 of either, scaled to its range."""
    by = [2.0 / (high - low) for low, high in (first, second)]
    still = [-b * (low + high) / 2 for b, (low, high) in zip(by, (first, second), strict=True)]
    curves = np.array([[still[0], 0.0, still[1], 0.0], *np.zeros((3, 4)), [by[0], 0.0, by[1], 0.0]])
    rows, bounds = (slice(0, 2), slice(2, 4)), np.array([[-np.inf, 1.0]] * 2)
    return AffineBounds(curves=lambda _: curves, rows=rows, bounds=bounds)


@pytest.mark.parametrize(("first", "second", "tighter"), [((-2, 2), (-1, 1), 1), ((-1, 1), (-2, 2), 0)])
@pytest.mark.parametrize("towards", [True, False])
def test_the_tighter_of_two_pins_holds_the_effort(first, second, tighter, towards):
    of, effort = replace(field(np.inf), affine=two_pins(first, second)), 1.0 if towards else -1.0
    for limit in (1.5, 9.0):
        limited = replace(of, bounds=bounds_of(SimpleNamespace(effort=np.array([[-limit, limit]])), EffortLimit))
        held, efforts, a = limited.at(0.0, SPEED, towards=towards)
        assert (held[0], efforts[0]) == ((limited.at_force + tighter) * effort, pytest.approx(effort))
        assert a == pytest.approx((1.0 - 0.5 * SPEED**2 - 0.25 * SPEED + 3 * effort) / 2)
    assert kept(of, towards)


@pytest.mark.parametrize("towards", [True, False])
def test_no_effort_keeps_two_pins_that_contradict_each_other(towards):
    assert kept(replace(field(np.inf), affine=two_pins((-2.0, 2.0), (1.0, 3.0))), towards)
    assert not kept(replace(field(np.inf), affine=two_pins((-2.0, 2.0), (3.0, 4.5))), towards)
    assert not kept(replace(field(np.inf), affine=two_pins((3.0, 4.5), (-2.0, 2.0))), towards)


def kept(limited: LegField, towards: bool = True) -> bool:
    limited = replace(limited, curves=lambda _: np.array([[2.0, 1.0, -0.5, -0.25, 3.0]]))
    at, speed = np.zeros(1), np.array([SPEED])
    return limited.keeps(at, speed, limited.at(at, speed, towards=towards)[1])


@pytest.mark.parametrize("towards", [True, False])
def test_a_state_at_the_power_s_limit_is_kept(towards):
    loose = replace(field(12.0), affine=pin((0.0, 0.0), (1e-3, 0.0)))
    assert abs(loose.at(0.0, SPEED, towards=towards)[0][0]) == AT_EFFORT + 1
    assert kept(loose, towards)


def test_arcs_end_where_the_power_comes_to_its_limit():
    """Accelerated evenly from rest at 2 m/s2, 5 N.m spend 12 W from 0.8 rad/s on, which is 0.4 s after the leg began."""
    limited = field(12.0)
    leg = Leg(
        field=limited,
        state=lambda t: np.array([t**2, 2.0 * t]),
        steps=np.linspace(-1.0, 3.0, 9),
        towards=True,
        begin=0.1,
        end=1.3,
        later=10.0,
    )
    (bang, first), (end, last) = leg.arcs()
    assert (first, last) == ((1,), (AT_EFFORT + 1,))
    assert (bang, end) == pytest.approx((10.4, 11.3), abs=1e-12)
    assert (leg.time_at(0.25), leg.speed_at(0.25)) == pytest.approx((0.5, 1.0))
    # Four looks in each step of the integration: in the middles of its quarters.
    np.testing.assert_allclose(leg._looks()[:5], [0.15, 0.25, 0.35, 0.45, 0.5625])
    assert len(leg._looks()) == 12
