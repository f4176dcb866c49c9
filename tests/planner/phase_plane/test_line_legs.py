"""Least times along the torque-speed lines of slow and quick motors, against an integration of the exact motion."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion

# A panel that a slow motor tilts: inertia about its axis, weight out of the axis, a damper.
PANEL = """
<mujoco><worldbody><body name="panel"><joint name="tilt" axis="0 1 0" range="-60 60" damping="20"/>
  <inertial mass="40" pos="0.05 0 0.02" diaginertia="8 6 12"/></body></worldbody>
<actuator><motor name="m" joint="tilt" ctrlrange="-80 80"/></actuator></mujoco>
"""
INERTIA, DAMPING, LIMIT, STALL = 6 + 40 * (0.05**2 + 0.02**2), 20.0, 80.0, 100.0
WEIGHT = 40 * 9.81
ENDS = np.radians([-45.0, 45.0])
# The share of every limit that is left for polynomials, and the oracle's own error.
LATE = 2e-8


def falls(s: float) -> float:
    """Return the torque of the weight [N.m]."""
    return WEIGHT * (0.05 * np.cos(s) + 0.02 * np.sin(s))


def exact(no_load: float) -> float:
    """Return the least time [s]: all the torque of the line, then all that brakes, joined where they are as fast."""

    def forth(_, y):
        return [y[1], (min(LIMIT, STALL * (1 - y[1] / no_load)) - DAMPING * y[1] + falls(y[0])) / INERTIA]

    def back(_, y):
        return [-y[1], -(max(-LIMIT, -STALL * (1 + y[1] / no_load)) - DAMPING * y[1] + falls(y[0])) / INERTIA]

    def arrived(_, y):
        return y[0] - ENDS[1]

    def fast(_, y):
        return y[1] - 1.5 * no_load

    def returned(_, y):
        return y[0] - ENDS[0]

    arrived.terminal = fast.terminal = returned.terminal = True
    span, settings = (0.0, 10.0 + 40.0 / no_load), {"method": "Radau", "rtol": 1e-11, "atol": 1e-14, "dense_output": True}
    first = solve_ivp(forth, span, [ENDS[0], 0.0], events=arrived, **settings)
    last = solve_ivp(back, span, [ENDS[1], 0.0], events=[fast, returned], **settings)

    def passed(s):
        if s <= ENDS[0] or s >= first.y[0, -1]:
            return 0.0 if s <= ENDS[0] else first.t[-1]
        return brentq(lambda t: first.sol(t)[0] - s, 0.0, first.t[-1], xtol=1e-15)

    def ahead(t):
        s, v = last.sol(t)
        return v - first.sol(passed(s))[1]

    t = brentq(ahead, 1e-9 * last.t[-1], last.t[-1], xtol=1e-15)
    return t + passed(last.sol(t)[0])


def tilted(no_load_deg_s: float, **changes: object) -> Plan:
    """Return the plan of the least time."""
    start, goal = np.degrees(ENDS)
    given = {"start_deg": {"tilt": start}, "goal_deg": {"tilt": goal}, "duration_s": "free", "minimize": "time"}
    motors = {"m": {"stall_effort": STALL, "no_load_speed_deg_s": no_load_deg_s}}
    return plan_motion(Problem.reach(PANEL, **given | {"motors": motors} | changes))


@pytest.mark.parametrize("no_load_deg_s", [1000.0, 30.0, 15.0, 8.0, 0.1])
def test_the_least_time_of_a_motor_is_that_of_its_exact_motion(no_load_deg_s):
    plan = tilted(no_load_deg_s)
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(exact(np.radians(no_load_deg_s)), rel=LATE)


def test_along_a_line_the_motor_gives_no_more_than_its_line_and_no_less_where_it_drives():
    plan = tilted(10.0)
    time = plan.trajectory.dense_times(20)
    used = plan.trajectory.effort_at(time)[:, 0] / STALL + plan.trajectory.velocity_at(time)[:, 0] / np.radians(10.0)
    assert used.max() <= 1 + 1e-12
    driven = (time > 0.5) & (time < 0.99 * plan.objective)
    np.testing.assert_allclose(used[driven], 1.0, rtol=LATE)


def test_a_slow_speed_limit_costs_the_way_over_it_and_the_gathering_of_speed():
    """900 s at 0.1 deg/s; to gather and lose that speed takes thousandths of a second."""
    plan = tilted(1e6, limits={"speed_deg_s": {"tilt": 0.1}})
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(900.0, rel=1e-6)
    assert plan.objective > 900.0
