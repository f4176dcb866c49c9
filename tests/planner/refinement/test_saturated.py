"""Objectives whose optimum bends where a limit begins to bind: a pure inertia's closed forms. And motions that stay."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from linkplan.models.errors import ProblemError
from linkplan.planner.certificate import flow, integration
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.plan.plan import Plan
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_plan
from tests.support.plans import planned
from tests.support.tolerances_planner import ROUNDING, SATURATED, SATURATED_ROUGHLY, STILL

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
    monkeypatch.setattr(integration, "STIFF_EVALUATIONS", 20)
    monkeypatch.setattr(integration, "strides", lambda *_: np.empty((0, 2, 4)))  # even steps that are all too long
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
    with pytest.raises(ProblemError, match=r'is independent; mechanism\.independent = \["a"\] plans in what is named'):
        body_plan(GEARED, motion, 'mechanism.independent=["b"]')
