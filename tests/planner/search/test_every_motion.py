"""Forces that every motion has at a pose, against the formula of a point mass on a massless rod."""

import numpy as np
import pytest

from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.presolve import plain_contradiction

MASS, LENGTH, ANGLE = 2.0, 0.5, np.radians(50.0)


def swing(least: float, pin_force: float, **limits) -> Problem:
    """Return a swing of a point mass from 50 deg above the horizontal by a motor of `least` to 30 N.m."""
    model = f"""<mujoco><compiler angle="radian"/><worldbody><body><joint name="O" axis="0 -1 0"/>
      <inertial pos="{LENGTH} 0 0" mass="{MASS}" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody>
      <actuator><motor name="m" joint="O" ctrlrange="{least} 30" ctrllimited="true"/></actuator></mujoco>"""
    return Problem.reach(
        model, start_deg={"O": 50.0}, goal_deg={"O": 10.0}, duration_s=0.5, solver={"compile": "never"},
        limits={"pin_force": {"O": pin_force}} | limits,
    )  # fmt: skip


@pytest.mark.parametrize("limits", [{}, {"power_w": {"m": 40.0}, "speed_deg_s": {"O": 400.0}}])
@pytest.mark.parametrize("least", [-30.0, 2.0])
def test_a_pin_force_below_that_of_every_acceleration_at_rest_is_infeasible_before_any_solve(least, limits):
    """Along the rod the pin carries m g sin; across it nothing of a falling mass, and u / l of a torque."""
    needed = np.hypot(MASS * 9.81 * np.sin(ANGLE), max(least, 0.0) / LENGTH)
    assert plain_contradiction(swing(least, 1.001 * needed, **limits)) is None
    plan = plan_motion(swing(least, 0.999 * needed, **limits))
    assert (plan.status, plan.verdict.known_by, len(plan.history)) == ("infeasible", "every motion", 0)
    (over,) = plan.verdict.overruns
    assert (over.limit, over.name) == ("pin_force", "O")
    assert over.value == pytest.approx(needed, rel=1e-6)
    assert "at rest at the start" in plan.message


def test_between_start_and_goal_speed_may_carry_a_weight_that_no_acceleration_carries():
    """On the way over the top from one side to the other, a pin with less than the weight holds by m v^2 / l."""
    model = swing(-30.0, 100.0)
    over_top = model.replace(start_deg={"O": 20.0}, goal_deg={"O": 160.0}, limits={"pin_force": {"O": 15.0}})
    assert MASS * 9.81 * np.sin(np.radians(20.0)) < 15.0 < MASS * 9.81
    assert plain_contradiction(over_top) is None
