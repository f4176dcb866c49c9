"""Least times along limits on power and pin forces: exact against the phase plane, however short the bangs at rest are."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.samples import closure_forces
from linkplan.planner.planning import RUNGS, plan_motion
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.refinement.constrained_arcs import FixedArcs, held_throughout
from linkplan.planner.search.starts import along_power
from tests.support.least_time import Curves, curves_of, least_time, least_time_within
from tests.support.mechanisms import FLAT_PARALLELOGRAM

# Against the exact least time, relative.
EXACT = 1e-6
# The ladder without the rung that knows the arcs beforehand.
ALONE = tuple(rung for rung in RUNGS if rung.climb is not along_power)
QUICK = ("objective.minimize=time", "motion.duration_s=free")
LIMIT = np.array([[-2.0, 2.0]])
NAN = np.nan
PARALLELOGRAM = """[mechanism]
model = "parallelogram.xml"
home_deg = { O = 60.0, A = -60.0, C = 60.0 }
[motion]
kind = "reach"
start_deg = { O = 30.0 }
goal_deg = { O = 150.0 }
duration_s = "free"
[objective]
minimize = "time"
[limits]
effort = { O = [-0.5, 0.5] }
power_w = { O = 5.0 }
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        # It climbs at a tenth of a radian a second for ten seconds, and forgets in a thousandth of one how it came there.
        ("slider-crank-turn", (*QUICK, "limits.power_w.act_O=0.01")),
        ("slider-crank-turn", (*QUICK, "limits.power_w.act_O=0.1")),
        ("slider-crank-turn", (*QUICK, "limits.power_w.act_O=1")),  # the bang at rest is a 4000th of the motion
        ("slider-crank-turn", (*QUICK, "limits.power_w.act_O=3")),
        ("slider-crank-turn", (*QUICK, "limits.power_w.act_O=10")),
        ("slider-crank-turn", (*QUICK, "limits.power_w.act_O=100")),
        ("knee-sprint", ("limits.power_w.act_O=1",)),  # a 300 000th
        ("knee-sprint", ("limits.power_w.act_O=10",)),
        ("knee-sprint", ("limits.power_w.act_O=400",)),
        ("knee-sprint", ("limits.power_w.act_O=[-50,400]",)),
    ],
)
def test_a_least_time_along_a_power_limit_is_exact(name, settings):
    problem = load_problem(name, settings)
    plan = plan_motion(problem)
    assert plan.status == "optimal", plan.message
    assert plan.trajectory.duration_s == pytest.approx(least_time(problem), rel=EXACT)


@pytest.fixture
def parallelogram(tmp_path):
    """Return the function from settings to the problem of a parallelogram within five watts."""
    model = FLAT_PARALLELOGRAM.replace('<motor joint="O"/>', '<motor name="O" joint="O" ctrlrange="-20 20"/>')
    (tmp_path / "parallelogram.xml").write_text(model, encoding="utf-8")
    (tmp_path / "problem.toml").write_text(PARALLELOGRAM, encoding="utf-8")
    return lambda *settings: load_problem(tmp_path / "problem.toml", settings)


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "rungs"), [(0.5, RUNGS), (20.0, ALONE)])
def test_a_parallelogram_within_five_watts_is_exact(parallelogram, limit, rungs):
    """With 20 N.m its bangs last a 60 000th of the motion, on which the power overruns its limit between coarse nodes."""
    problem = parallelogram(f"limits.effort.O=[{-limit}, {limit}]")
    plan = plan_motion(problem, rungs=rungs)
    assert plan.status == "optimal", plan.message
    assert plan.trajectory.duration_s == pytest.approx(least_time(problem), rel=EXACT)


@pytest.mark.slow
def test_arcs_along_a_power_limit_are_read_from_a_solution_too():
    problem = load_problem("slider-crank-turn", (*QUICK, "limits.power_w.act_O=3"))
    plan = plan_motion(problem, rungs=ALONE)
    assert plan.status == "optimal", plan.message
    assert plan.trajectory.duration_s == pytest.approx(least_time(problem), rel=EXACT)


def pin_force_range(problem: Problem, curves: Curves):
    """Return the function (place, speed) -> efforts at which the knee's pin carries no more than its limit.

    The force is affine in effort and in the speed's square and itself: its own square is quadratic in the effort.
    """
    (closure,) = problem.limits.limited_closures
    place = np.linspace(problem.motion.start[0], problem.motion.goal[0], 2001)
    q = follow(problem.mechanism, place[:, None], problem.start_pose())
    terms = [(i, j) for i in range(3) for j in range(5) if 2 * i + j <= 4]
    at = [(u, v) for u in (-100.0, 0.0, 100.0) for v in (-60.0, -30.0, 0.0, 30.0, 60.0)]

    def square(u: float, v: float) -> np.ndarray:
        U, V = np.full((len(q), 1), u), np.full((len(q), 1), v)
        free = curves.still(place) + curves.square(place) * v**2 + curves.linear(place) * v
        a = ((free + curves.effort(place) * u) / curves.inertia(place))[:, None]
        return closure_forces(problem, q, V, a, U)[:, closure] ** 2

    matrix = [[(u / 100) ** i * (v / 60) ** j for i, j in terms] for u, v in at]
    fitted = np.linalg.lstsq(np.array(matrix), np.array([square(u, v) for u, v in at]), rcond=None)[0]
    parts = [CubicSpline(place, values) for values in fitted]

    def within(s: float, v: float) -> tuple[float, float]:
        k = np.zeros(3)
        for (i, j), part in zip(terms, parts, strict=True):
            k[i] += float(part(s)) * (v / 60) ** j
        root = np.sqrt(max(k[1] ** 2 - 4 * k[2] * (k[0] - problem.limits.closure_force[closure] ** 2), 0.0))
        low, high = problem.limits.effort[0]
        return max(low, 100 * (-k[1] - root) / (2 * k[2])), min(high, 100 * (-k[1] + root) / (2 * k[2]))

    return within


@pytest.mark.slow
@pytest.mark.parametrize("force_n", [2.5, 1.5])
def test_a_least_time_along_a_pins_force_is_exact(force_n):
    problem = load_problem("knee-sprint", [f"limits.closure_force.B={force_n}"])
    plan = plan_motion(problem)
    assert plan.status == "optimal", plan.message
    start, goal = float(problem.motion.start[0]), float(problem.motion.goal[0])
    curves = curves_of(problem, start, goal)
    exact = least_time_within(curves, start, goal, pin_force_range(problem, curves))
    assert plan.trajectory.duration_s == pytest.approx(exact, rel=EXACT)


class Seen:
    """A motion of 1 s whose effort is P / w behind a bang at either end: half a second's acceleration, and its mirror."""

    def effort_at(self, time: np.ndarray) -> np.ndarray:
        before = np.minimum(time, 1.0 - time)
        meet = 0.01
        rising = np.where(before < meet, 2.0, 2.0 / np.sqrt(np.maximum(2.0 * before / meet - 1.0, 1.0)))
        return np.where(time < 0.5, rising, -rising)[:, None]


def held(efforts: list[float], paths: list[int]) -> FixedArcs:
    return FixedArcs(efforts=np.array(efforts)[:, None], paths=np.array(paths)[:, None])


def test_arcs_along_a_power_from_rest_and_to_rest_have_bangs_at_their_ends():
    powers = np.array([[-10.0, 10.0]])
    switch_times, fixed = held_throughout(Seen(), LIMIT, np.array([0.0, 0.5, 1.0]), held([NAN, NAN], [1, -1]), powers)
    np.testing.assert_allclose(switch_times, [0.01, 0.5, 0.99], atol=1e-9)
    np.testing.assert_array_equal(fixed.efforts.ravel(), [2.0, NAN, NAN, -2.0])
    np.testing.assert_array_equal(fixed.paths.ravel(), [0, 1, -1, 0])
    assert fixed.everything


def test_what_lies_between_two_arcs_along_a_power_is_their_switch():
    powers, ends = np.array([[-10.0, 10.0]]), np.array([0.0, 0.01, 0.48, 0.52, 0.99, 1.0])
    switch_times, fixed = held_throughout(Seen(), LIMIT, ends, held([2.0, NAN, NAN, NAN, -2.0], [0, 1, 0, -1, 0]), powers)
    np.testing.assert_allclose(switch_times, [0.01, 0.5, 0.99], atol=1e-9)
    assert fixed.everything


def test_a_brake_beyond_the_powers_other_limit_is_an_arc_along_that():
    powers, ends = np.array([[-10.0, 10.0]]), np.array([0.0, 0.01, 0.5, 1.0])
    _, fixed = held_throughout(Seen(), LIMIT, ends, held([2.0, NAN, -2.0], [0, 1, 0]), powers)
    np.testing.assert_array_equal(fixed.paths.ravel(), [0, 1, -1, 0])
    # Without a limit on the power that it takes back, it brakes with all that it has.
    _, fixed = held_throughout(Seen(), LIMIT, ends, held([2.0, NAN, NAN], [0, 1, 0]), np.array([[-np.inf, 10.0]]))
    np.testing.assert_array_equal(fixed.paths.ravel(), [0, 1, 0])


def test_arcs_that_are_all_held_are_left_as_they_are():
    ends = np.array([0.0, 0.5, 1.0])
    assert held_throughout(Seen(), LIMIT, ends, held([2.0, -2.0], [0, 0]), np.array([[NAN, NAN]])) is None
    assert held_throughout(Seen(), np.tile(LIMIT, (2, 1)), ends, held([2.0, NAN], [0, 1]), np.array([[-1.0, 1.0]])) is None
