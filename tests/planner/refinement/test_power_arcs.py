"""Exact motions along limits on effort, speed, power, pin forces and torque-speed lines."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate import flow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.samples import closure_forces
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_plan
from tests.support.least_time import Curves, curves_of, least_time, least_time_within
from tests.support.mechanisms import FLAT_PARALLELOGRAM
from tests.support.plans import planned
from tests.support.tolerances_planner import ROUNDING, SATURATED, SATURATED_ROUGHLY, STILL

# Against the exact least time, relative.
EXACT = 1e-6
QUICK = ("objective.minimize=time", "motion.duration_s=free")


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


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0.5, 20.0])
def test_a_parallelogram_within_five_watts_is_exact(limit):
    """With 20 N.m its bangs last a 60 000th of the motion, on which the power overruns its limit between coarse nodes."""
    model = FLAT_PARALLELOGRAM.replace('<motor joint="O"/>', '<motor name="O" joint="O" ctrlrange="-20 20"/>')
    mechanism = linkplan.load_mechanism(model, home_deg={"O": 60.0, "A": -60.0, "C": 60.0})
    limits = {"effort": {"O": [-limit, limit]}, "power_w": {"O": 5.0}}
    problem = Problem.reach(mechanism, start_deg={"O": 30.0}, goal_deg={"O": 150.0}, minimize="time", limits=limits)
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


J, LIMIT = HINGE_INERTIA, 4.0
SHORTEST = 2 * np.sqrt(J * TURN / LIMIT)


def turn(duration: float | str, *overrides: str) -> Plan:
    asked = f'"{duration}"' if isinstance(duration, str) else f"{duration:.17g}"
    plan = body_plan(HINGE, QUARTER_TURN + f"duration_s = {asked}\n", *overrides)
    assert plan.status == "optimal", plan.message
    return plan


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.0001, 1.001, 1.02, 1.1])
def test_least_effort_in_little_time_is_full_effort_and_a_line_between(ratio):
    """u = clip(c (1 - 2 t / T)): for ratios near one the line is shorter than an interval of the mesh."""
    T = ratio * SHORTEST

    def missing(full: float) -> float:
        line = T / 2 - full
        return 2 * LIMIT / J * (full**2 / 2 + full * line + line**2 / 3) - TURN

    full = brentq(missing, 0.0, T / 2, xtol=1e-16)
    exact = 2 * LIMIT**2 * (full + (T / 2 - full) / 3)
    assert turn(T).objective == pytest.approx(exact, rel=SATURATED)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.05, 1.1, 1.3, 1.45])
def test_least_effort_below_a_speed_limit_is_two_lines_and_nothing_between(ratio):
    T = 1.5
    speed = ratio * TURN / T
    slope = 1.5 * (T - TURN / speed)
    plan = turn(T, f"limits.speed_deg_s.J={np.degrees(speed)}", "limits.effort.motor=[-100.0,100.0]")
    # Coefficients that enclose the speed keep it off its limit for a while next to the bends.
    assert plan.objective == pytest.approx(8 * J**2 * speed**2 / (3 * slope), rel=SATURATED_ROUGHLY)


@pytest.mark.slow
@pytest.mark.parametrize("weight", [0.05, 1.0, 5.0])
def test_time_and_work_together_push_coast_and_brake(weight):
    exact = min(
        TURN / v + v * J / LIMIT + weight * J * v**2 / 2 for v in np.linspace(0.01, np.sqrt(LIMIT * TURN / J), 200_001)
    )
    plan = turn("free", f"objective.minimize={{time=1.0,work={weight}}}")
    assert plan.objective == pytest.approx(exact, rel=SATURATED)


@pytest.mark.slow
@pytest.mark.parametrize(("stall", "no_load"), [(5.0, 6.0), (4.0, 8.0), (8.0, 10.0)])
def test_the_least_time_along_a_torque_speed_line_is_its_quadrature(stall, no_load):
    def inertia_over_effort(v: float) -> float:
        return J / min(LIMIT, stall * (1 - v / no_load))

    def covered(top: float) -> float:
        return quad(lambda v: v * inertia_over_effort(v), 0, top, limit=400, points=[corner])[0] + J * top**2 / (2 * LIMIT)

    corner = no_load * max(0.0, 1 - LIMIT / stall)
    top = brentq(lambda v: covered(v) - TURN, 1e-3, 0.999 * no_load, xtol=1e-14)
    exact = quad(inertia_over_effort, 0, top, limit=400, points=[corner], epsabs=1e-13)[0] + J * top / LIMIT
    line = (f"motors.motor.stall_effort={stall}", f"motors.motor.no_load_speed_deg_s={np.degrees(no_load)}")
    assert turn("free", "objective.minimize=time", *line).objective == pytest.approx(exact, rel=SATURATED)


@pytest.mark.parametrize("objective", ["effort", "work"])
def test_a_motion_that_stays_where_it_is_asks_for_nothing(objective):
    stays = 'kind = "reach"\nstart_deg = { J = 10.0 }\ngoal_deg = { J = 10.0 }\nduration_s = 0.5\n'
    plan = body_plan(HINGE, stays, f"objective.minimize={objective}")
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(0.0, abs=ROUNDING)
    assert np.ptp(plan.trajectory.position) < STILL


def test_an_integration_that_crawls_is_given_up_and_said(monkeypatch):
    plan = planned("knee-reach")
    assert certify(plan.problem, plan.trajectory).passed
    monkeypatch.setattr(flow, "_MAX_EVALUATIONS", 20)
    monkeypatch.setattr(flow, "_MOST_STEPS", 0)
    certificate = certify(plan.problem, plan.trajectory)
    assert not certificate.passed
    assert any("state integrated under the planned effort" in failure for failure in certificate.failures)


GEARED = """<mujoco><option gravity="0 0 0"/><worldbody>
<body><joint name="a" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/></body>
<body pos="1 0 0"><joint name="b" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/></body></worldbody>
<equality><joint joint1="a" joint2="b" polycoef="0 2 0 0 0"/></equality>
<actuator><motor name="motor" joint="b" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_a_motion_stated_in_another_joint_than_the_driven_one_is_planned_there():
    motion = 'kind = "reach"\nstart_deg = { a = 0.0 }\ngoal_deg = { a = 45.0 }\nduration_s = 1.0\n'
    plan = body_plan(GEARED, motion)
    assert plan.status == "optimal", plan.message
    assert [joint.name for joint in plan.problem.mechanism.independent_joints] == ["a"]
    assert 'mechanism.independent = ["a"]' in plan.problem.notes[0]
    with pytest.raises(ProblemError, match=r'mechanism\.independent = \["a"\] plans in the named joints'):
        body_plan(GEARED, motion, 'mechanism.independent=["b"]')
