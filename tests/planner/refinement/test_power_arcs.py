"""Least times along limits on power and pin forces: exact against the phase plane, however short the bangs at rest are."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.samples import closure_forces
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion
from tests.support.least_time import Curves, curves_of, least_time, least_time_within
from tests.support.mechanisms import FLAT_PARALLELOGRAM

# Against the exact least time, relative.
EXACT = 1e-6
QUICK = ("objective.minimize=time", "motion.duration_s=free")
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
        # It climbs for a second at a constant power, and forgets in a hundredth of one how it came there.
        ("slider-crank-turn", (*QUICK, "limits.power_w.act_O=0.1")),
        ("slider-crank-turn", (*QUICK, "limits.power_w.act_O=1")),  # the bang at rest is a 4000th of the motion
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
@pytest.mark.parametrize("limit", [0.5, 20.0])
def test_a_parallelogram_within_five_watts_is_exact(parallelogram, limit):
    """With 20 N.m its bangs last a 60 000th of the motion, on which the power overruns its limit between coarse nodes."""
    problem = parallelogram(f"limits.effort.O=[{-limit}, {limit}]")
    plan = plan_motion(problem)
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
