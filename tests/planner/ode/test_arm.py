"""The minimum-time robot arm of COPS, against the same arm driven by scipy at five switch times."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from linkplan.planner.ode.plan import OdePlan
from tests.support.ode import FREE_STATE, duration, solved
from tests.support.tolerances_planner import ODE_CLOSED_FORM, ODE_STATE, ODE_SWITCH

REACH = 5.0


def arm_inertia(r):
    return ((REACH - r) ** 3 + r**3) / 3


def arm(x, u, p, t):  # noqa: ARG001
    inertia = arm_inertia(x[0])
    return [x[3], x[4], x[5], u[0] / REACH, u[1] / (inertia * ca.sin(x[2]) ** 2), u[2] / inertia]


ARM_START = np.array([4.5, 0, np.pi / 4, 0, 0, 0])
ARM_GOAL = np.array([4.5, 2 * np.pi / 3, np.pi / 4, 0, 0, 0])


@cache
def quickest_arm() -> OdePlan:
    return solved(
        rate=arm,
        start=ARM_START,
        goal=ARM_GOAL,
        effort_limit=[[-1, 1]] * 3,
        state_limit=[[0, REACH], [-np.pi, np.pi], [0, np.pi], FREE_STATE, FREE_STATE, FREE_STATE],
        duration_s=(1, 100),
        final_cost=duration,
        objective_tolerance=1e-9,
    )


def arm_after(unknowns: ArrayLike) -> np.ndarray:
    """Return where the arm is missed (6,) [m, rad] when it is driven with given switch times and duration, by scipy alone.

    Switches of the reach, the turn and the tilt, two, one and two, every actuator at a limit throughout.
    """
    *switches, T = np.asarray(unknowns)
    effort, state, time = np.array([-1.0, 1.0, -1.0]), ARM_START, 0.0

    def rate(t: float, x: np.ndarray, u: np.ndarray) -> list[float]:
        del t
        inertia = arm_inertia(x[0])
        return [*x[3:], u[0] / REACH, u[1] / (inertia * np.sin(x[2]) ** 2), u[2] / inertia]

    for until, which in [*sorted(zip(switches, (0, 0, 1, 2, 2), strict=True)), (T, None)]:
        state = solve_ivp(rate, (time, until), state, args=(effort,), method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        time = until
        if which is not None:
            effort = effort * np.where(np.arange(3) == which, -1, 1)
    return state - ARM_GOAL


@cache
def bang_bang_arm() -> np.ndarray:
    T = 9.0
    found, _, success, message = fsolve(
        arm_after, [T / 4, 3 * T / 4, T / 2, 0.3 * T, 0.7 * T, T], xtol=1e-13, full_output=True
    )
    assert success == 1, message
    return found


@pytest.mark.slow
def test_the_arm_s_least_time_is_that_of_its_five_switches():
    """Published: 9.14138 (COPS, a finite mesh), 9.14093620 (Betts); this motion is shorter, and scipy drives it."""
    found = bang_bang_arm()
    assert np.abs(arm_after(found)).max() < ODE_STATE
    assert found[-1] < 9.14093620 < 9.14138
    assert quickest_arm().objective == pytest.approx(found[-1], rel=ODE_CLOSED_FORM)


@pytest.mark.slow
def test_the_arm_s_switches_are_found_where_scipy_has_them():
    motion = quickest_arm().trajectory
    time = motion.dense_times(4)
    efforts = motion.effort_at(time)
    assert np.abs(np.abs(efforts) - 1).max() < ODE_STATE
    at, which = np.nonzero(np.diff(np.sign(efforts), axis=0))
    found = [sorted(time[at][which == j]) for j in range(3)]
    exact = bang_bang_arm()
    np.testing.assert_allclose(np.concatenate(found), exact[[0, 1, 2, 3, 4]], atol=ODE_SWITCH)
