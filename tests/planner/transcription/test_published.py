"""Published optimal-control problems without a mechanism: the transcription and the solver against their known optima."""

# ruff: noqa: ARG001, ARG005 (laws and costs of x, u, t need not have all of them)

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from linkplan.planner.transcription.bernstein import PiecewisePolynomial
from linkplan.planner.transcription.collocation import Curves
from tests.support.first_order import FREE_EFFORT, FREE_STATE, INF, NAN, FirstOrder
from tests.support.tolerances_planner import ODE_CLOSED_FORM, ODE_FOUR_DIGITS, ODE_STATE


def double_integrator(x, u, t):
    """Return x'' = u as a system of first order."""
    return [x[1], u[0]]


def squared_effort(x, u, t):
    """Return the running cost of least effort."""
    return u[0] ** 2


def duration(x0, xT, T):
    """Return the final cost of least time."""
    return T


def oscillator(x, u, t):
    """Return the rates of x'' = -x + u."""
    return [x[1], -x[0] + u[0]]


def least_energy(T: float, missing: np.ndarray) -> float:
    """Return the least effort to change an oscillator's state by `missing` in T: by its Gramian."""
    c, s = np.cos(2 * T), np.sin(2 * T)
    return missing @ np.linalg.solve([[T / 2 - s / 4, (1 - c) / 4], [(1 - c) / 4, T / 2 + s / 4]], missing)


def cart_pole(x, u, t):
    """Return the rates of Kelly's cart-pole."""
    m1, m2, length, gravity = 1.0, 0.3, 0.5, 9.81
    s, c = ca.sin(x[1]), ca.cos(x[1])
    a1 = (length * m2 * s * x[3] ** 2 + u[0] + m2 * gravity * c * s) / (m1 + m2 * (1 - c**2))
    a2 = -(length * m2 * c * s * x[3] ** 2 + u[0] * c + (m1 + m2) * gravity * s) / (length * m1 + length * m2 * (1 - c**2))
    return [x[2], x[3], a1, a2]


def bioreactor(x, u, t):
    """Return the rates of Lee and Ramirez's fed-batch reactor, with the parameters of Tholudur and Ramirez (1997).

    States: volume, cells, nutrient, protein, inducer, shock and recovery. Efforts: the rates of nutrient and inducer.
    """
    volume, cells, nutrient, protein, inducer, shock, recovery = (x[i] for i in range(7))
    dilution, uptake = (u[0] + u[1]) / volume, nutrient / (14.35 + nutrient + nutrient**2 / 111.5)
    growth = uptake * (shock + recovery * 0.22 / (0.22 + inducer))
    production = 0.233 * uptake * (0.0005 + inducer) / (0.022 + inducer)
    response = 0.09 * inducer / (0.034 + inducer)
    return [
        u[0] + u[1],
        growth * cells - dilution * cells,
        100 * u[0] / volume - dilution * nutrient - growth * cells / 0.51,
        production * cells - dilution * protein,
        4 * u[1] / volume - dilution * inducer,
        -response * shock,
        response * (1 - recovery),
    ]


def tank(x, u, t):
    """Return the rates of Luus's stirred tank."""
    k = (x[1] + 0.5) * ca.exp(25 * x[0] / (x[0] + 2))
    return [-(2 + u[0]) * (x[0] + 0.25) + k, 0.5 - x[1] - k]


def bryson_denham(limit: float) -> FirstOrder:
    """Return Bryson and Denham's problem; its optimum is 4 / (9 l) for a limit l below 1/6."""
    return FirstOrder(
        rate=double_integrator, start=[0, 1], goal=[0, -1], effort_limit=FREE_EFFORT, duration_s=1.0,
        state_limit=[[-INF, limit], FREE_STATE], running_cost=lambda x, u, t: u[0] ** 2 / 2,
    )  # fmt: skip


SWING_UP = {
    "rate": cart_pole, "start": [0, 0, 0, 0], "goal": [1, np.pi, 0, 0], "effort_limit": [[-20, 20]], "duration_s": 2.0,
    "state_limit": [[-2, 2], FREE_STATE, FREE_STATE, FREE_STATE], "running_cost": squared_effort,
}  # fmt: skip
# The bioreactor by Runge and Kutta's rule and multiple shooting with rates constant over 100 and 400 cells, extrapolated.
LEE_RAMIREZ = 6.1516037

GRAVITY = 9.8

# The optimum, the problem, intervals with scheme and shape of efforts, and the relative error that they leave.
PUBLISHED = {
    "least effort": (12 * 2**2 / 1.5**3, FirstOrder(rate=double_integrator, start=[0, 0], goal=[2, 0],
        effort_limit=FREE_EFFORT, duration_s=1.5, running_cost=squared_effort), (4,), ODE_CLOSED_FORM),
    "lever that grows with time": (2 * 3 * 2 / 1.5**3, FirstOrder(rate=lambda x, u, t: [t * u[0]], start=[0], goal=[2],
        effort_limit=FREE_EFFORT, duration_s=1.5, running_cost=squared_effort), (4,), ODE_CLOSED_FORM),
    "Kirk's example 5.1.1": (16.7507234, FirstOrder(rate=lambda x, u, t: [x[1], -x[1] + u[0]], start=[0, 0], goal=[5, 2],
        effort_limit=FREE_EFFORT, duration_s=2.0, running_cost=lambda x, u, t: u[0] ** 2 / 2), (20,), ODE_FOUR_DIGITS),
    "Gramian of an oscillator": (least_energy(2 * np.pi, np.array([0.5, 3.0])), FirstOrder(rate=oscillator,
        start=[0.5, -1], goal=[1, 2], effort_limit=FREE_EFFORT, duration_s=2 * np.pi, running_cost=squared_effort),
        (40, "radau-5"), ODE_CLOSED_FORM),
    "two efforts tied on the path": (12 * 5 / 9, FirstOrder(rate=lambda x, u, t: [x[1], u[0] + u[1]], start=[0, 0],
        goal=[1, 0], effort_limit=FREE_EFFORT * 2, duration_s=1.0, path=lambda x, u, t: [u[0] - 2 * u[1]],
        path_limit=[[0, 0]], running_cost=lambda x, u, t: u[0] ** 2 + u[1] ** 2), (4,), ODE_CLOSED_FORM),
    "x0^2 + (4 - 2 x0)^2 of a sum of ends": ((8 / 5) ** 2 + (4 / 5) ** 2, FirstOrder(rate=lambda x, u, t: [u[0]],
        start=[NAN], goal=[NAN], effort_limit=FREE_EFFORT, duration_s=1.0, running_cost=squared_effort,
        final_cost=lambda x0, xT, T: x0[0] ** 2, ends=lambda x0, xT: [xT[0] + x0[0], xT[0] - x0[0]],
        ends_limit=[[4, INF], [-INF, 1]]), (4,), 1e-7),
    "Fourier's balance of a periodic follower": (np.pi / 3 * 0.45 / 1.45, FirstOrder(rate=lambda x, u, t: [u[0]],
        start=[NAN], goal=[NAN], returns=(0,), effort_limit=FREE_EFFORT, duration_s=2 * np.pi / 3,
        running_cost=lambda x, u, t: (x[0] - ca.sin(3 * t)) ** 2 + 0.05 * u[0] ** 2), (40,), ODE_CLOSED_FORM),
    "T + 9 / T between free ends": (6.0, FirstOrder(rate=lambda x, u, t: [u[0]], start=[NAN], goal=[NAN],
        effort_limit=FREE_EFFORT, duration_s=(0.1, 1.0, 50.0), running_cost=squared_effort, final_cost=duration,
        ends=lambda x0, xT: [xT[0] - x0[0]], ends_limit=[[3, 3]]), (4,), ODE_CLOSED_FORM),
    "brachistochrone": (0.8247591431566, FirstOrder(
        rate=lambda x, u, t: [x[2] * ca.sin(u[0]), x[2] * ca.cos(u[0]), GRAVITY * ca.cos(u[0])], start=[0, 0, 0],
        goal=[2, 2, NAN], effort_limit=[[0, np.pi]], duration_s=(0.1, 1.0, 50.0), final_cost=duration,
        way=[[0, 0, 0], [2, 2, 6]], effort=0.8), (20,), 1e-7),
    "Bryson and Denham below 1/9": (4.0, bryson_denham(1 / 9), (60,), ODE_FOUR_DIGITS),
    "Luus's stirred tank": (0.133095, FirstOrder(rate=tank, start=[0.09, 0.09], goal=[NAN, NAN], effort_limit=FREE_EFFORT,
        duration_s=0.78, running_cost=lambda x, u, t: x[0] ** 2 + x[1] ** 2 + 0.1 * u[0] ** 2), (20,), 1.5e-5),
    "cart-pole": (58.8077, FirstOrder(**SWING_UP), (60,), ODE_FOUR_DIGITS),
    "cart-pole, from a guess": (57.9449, FirstOrder(**SWING_UP,
        way=[[0, 0, 0, 0], [0, -np.pi / 3, 0, 0], [1, np.pi, 0, 0]]), (60,), ODE_FOUR_DIGITS),
    "bioreactor": (-LEE_RAMIREZ, FirstOrder(rate=bioreactor, start=[1, 0.1, 40, 0, 0, 1, 0], goal=[NAN] * 7,
        effort_limit=[[0, 1], [0, 1]], duration_s=10.0, final_cost=lambda x0, xT, T: -xT[0] * xT[3],
        unit=[1, 1, 40, 1, 1, 1, 1], effort=[0.1, 0.1]), (50, "radau-3", "constant"), 1.5e-5),
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "bioreactor")) for name in PUBLISHED]
)
def test_the_optimum_is_the_published_one(name):
    value, problem, how, within = PUBLISHED[name]
    assert problem.solved(*how)[0].objective == pytest.approx(value, rel=within)


def effort_at(motion: Curves, time_s: float | np.ndarray) -> np.ndarray:
    """Return the efforts (n, n_u) at times (n,)."""
    return PiecewisePolynomial(motion.effort, motion.breaks_s)(np.atleast_1d(time_s))


def test_a_motion_follows_its_equation_between_the_nodes():
    _, motion = FirstOrder(**SWING_UP).solved(60, "radau-5")
    right = ca.Function("rate", [x := ca.SX.sym("x", 4), u := ca.SX.sym("u")], [ca.vertcat(*cart_pole(x, u, 0))])
    run = solve_ivp(
        lambda t, y: np.array(right(y, effort_at(motion, t)[0])).ravel(), (0, 2), np.zeros(4), rtol=1e-9, atol=1e-9
    )
    np.testing.assert_allclose(run.y[:, -1], [1, np.pi, 0, 0], atol=ODE_STATE * 100)


def test_a_lever_that_grows_with_time_is_pushed_in_proportion_to_it():
    _, motion = PUBLISHED["lever that grows with time"][1].solved(4)
    time = np.linspace(0.0, 1.5, 50)
    np.testing.assert_allclose(effort_at(motion, time)[:, 0], 3 * 2 / 1.5**3 * time, atol=ODE_STATE)
