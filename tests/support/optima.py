"""Optimal-control problems with known optima: closed forms, values from books, or solutions by scipy."""

# ruff: noqa: ARG001, ARG005 (laws and costs of x, u, p, t need not have all of them)

from dataclasses import dataclass, field
from functools import cache

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq, fsolve

from linkplan.planner.ode.plan import OdePlan
from linkplan.planner.ode.problem import OdeProblem, StateGuess
from linkplan.planner.problem.settings import MeshSettings
from tests.support.ode import (
    FREE_EFFORT,
    FREE_STATE,
    INF,
    NAN,
    OSCILLATOR,
    bryson_denham,
    double_integrator,
    duration,
    oscillator,
    robbins,
    solved,
    squared_effort,
)
from tests.support.tolerances_planner import (
    ODE_BOUND_BY_A_STATE,
    ODE_CLOSED_FORM,
    ODE_FOUR_DIGITS,
    ODE_KINKED,
    ODE_PUBLISHED,
    ODE_SINGULAR,
)


@dataclass(frozen=True, eq=False, slots=True)
class Optimum:
    """The least objective of a problem with these fields, relative error allowed, and the time that it takes."""

    value: float
    fields: dict = field(default_factory=dict)
    within: float = ODE_CLOSED_FORM
    takes: str = "slow"


def cart(x0: list, goal: list, **more) -> dict:
    """Return the fields of x'' = u."""
    return {"rate": double_integrator, "start": x0, "goal": goal, **more}


def integrator(start: list, goal: list, **more) -> dict:
    """Return the fields of x' = u."""
    return {"rate": lambda x, u, p, t: [u[0]], "start": start, "goal": goal, **more}


LEAST_EFFORT = {"effort_limit": FREE_EFFORT, "running_cost": squared_effort}
ONE, LEAST_TIME = {"effort_limit": [[-1, 1]]}, {"final_cost": duration, "duration_s": (0.1, 50)}
QUICKEST = ONE | LEAST_TIME
# The least time of a boat of speed 1 in a current -y along x, from (3.66, -1.86) to the origin: scipy, with the heading's
# theta' = cos^2 theta, from a first heading of 1.83292904; 5.46 in Bryson & Ho, 2.7.
BOAT = 5.45786526
G, DEG = 9.8, np.pi / 180
# Arcs [s] of efforts +1, -1 and +1 that bring an oscillator to rest, and from where, built backwards.
ARCS = (1.0, np.pi, 1.0)


def before_the_arcs() -> np.ndarray:
    """Return the state (2,) from which the oscillator comes to rest after three arcs of full effort."""
    state = np.zeros(2)
    for length, effort in zip(ARCS[::-1], (1.0, -1.0, 1.0), strict=True):
        centre = np.array([effort, 0.0])
        state = centre + expm(-OSCILLATOR * length) @ (state - centre)
    return state


def cycloid() -> tuple[float, float]:
    """Return the cycloid from the origin to (2, 2): the radius of its circle, and the circle's angle at the end."""
    theta = fsolve(lambda a: (a - np.sin(a)) / (1 - np.cos(a)) - 1, 2.4, xtol=1e-15)[0]
    return 2 / (1 - np.cos(theta)), theta


def least_energy(T: float, missing: np.ndarray) -> float:
    """Return the least effort to change an oscillator's state by `missing` in T: by its Gramian."""
    c, s = np.cos(2 * T), np.sin(2 * T)
    return missing @ np.linalg.solve([[T / 2 - s / 4, (1 - c) / 4], [(1 - c) / 4, T / 2 + s / 4]], missing)


def regulator() -> Optimum:
    """Return a linear system with quadratic cost over a finite horizon: Riccati's equation."""
    rng = np.random.default_rng(5)
    A, B = rng.normal(size=(3, 3)), rng.normal(size=(3, 2))
    Q, R, F, x0 = np.diag([1.0, 0.5, 2.0]), np.diag([0.7, 1.3]), np.diag([3.0, 1.0, 0.2]), np.array([1.0, -2.0, 0.5])

    def riccati(t: float, flat: np.ndarray) -> np.ndarray:
        del t
        P = flat.reshape(3, 3)
        return (A.T @ P + P @ A - P @ B @ np.linalg.solve(R, B.T @ P) + Q).ravel()

    P = solve_ivp(riccati, (0, 2.0), F.ravel(), method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1].reshape(3, 3)
    fields = {
        "rate": lambda x, u, p, t: ca.DM(A) @ x + ca.DM(B) @ u, "start": x0, "goal": [NAN] * 3, "duration_s": 2.0,
        "effort_limit": FREE_EFFORT * 2, "final_cost": lambda x0, xT, T, p: ca.bilin(ca.DM(F), xT),
        "running_cost": lambda x, u, p, t: ca.bilin(ca.DM(Q), x) + ca.bilin(ca.DM(R), u),
    }  # fmt: skip
    return Optimum(x0 @ P @ x0, fields)


def layer(x: float) -> float:
    """Return the integral of y sqrt(y^4 + 1) from 0 to x, part of the cost of Rao and Mease's layer along H = 0."""
    return 0.25 * (x**2 * np.sqrt(x**4 + 1) + np.arcsinh(x**2))


def catenary() -> float:
    """Return the least int x sqrt(1 + x'^2) from x(0) = 1 to x(1) = 3 with a length of 4."""
    c = brentq(lambda c: 2 * c * np.sinh(0.5 / c) - np.sqrt(4**2 - 2**2), 0.05, 5, xtol=1e-15)
    lowest = 0.5 - c * np.arctanh(2 / 4)
    ends = np.array([-lowest, 1 - lowest]) / c
    squares = c**2 * np.diff(ends / 2 + np.sinh(2 * ends) / 4)[0]
    return squares + (1 - c * np.cosh(lowest / c)) * 4


def power_limited_cart(distance: float, P: float) -> float:
    """Return the least time of a cart: full effort up to speed P, then v^2 = P^2 + 2 P t, then full braking."""
    top = brentq(lambda v: P**2 / 2 + (v**3 - P**3) / (3 * P) + v**2 / 2 - distance, P, 3, xtol=1e-14)
    return P + (top**2 - P**2) / (2 * P) + top


def round_a_disk(x: float, y: float) -> float:
    """Return the length of the shortest way from (-x, y) to (x, y) round the unit disk: two tangents and an arc."""
    distance = np.hypot(x, y)
    arc = np.arctan2(y, -x) - np.arctan2(y, x) - 2 * np.arccos(1 / distance)
    return 2 * np.sqrt(distance**2 - 1) + arc


def cart_pole(x, u, p, t):
    """Return the rates of Kelly's cart-pole."""
    m1, m2, length, gravity = 1.0, 0.3, 0.5, 9.81
    s, c = ca.sin(x[1]), ca.cos(x[1])
    a1 = (length * m2 * s * x[3] ** 2 + u[0] + m2 * gravity * c * s) / (m1 + m2 * (1 - c**2))
    a2 = -(length * m2 * c * s * x[3] ** 2 + u[0] * c + (m1 + m2) * gravity * s) / (length * m1 + length * m2 * (1 - c**2))
    return [x[2], x[3], a1, a2]


SWING_UP = {
    "rate": cart_pole, "start": [0, 0, 0, 0], "goal": [1, np.pi, 0, 0], "effort_limit": [[-20, 20]], "duration_s": 2.0,
    "state_limit": [[-2, 2], FREE_STATE, FREE_STATE, FREE_STATE], "running_cost": squared_effort,
}  # fmt: skip
VAN_DER_POL = {
    "rate": lambda x, u, p, t: [(1 - x[1] ** 2) * x[0] - x[1] + u[0], x[0]], "start": [0, 1],
    "running_cost": lambda x, u, p, t: ca.sumsqr(x) + u[0] ** 2,
}  # fmt: skip
PUSHED_BACK = VAN_DER_POL | {"goal": [0, 0], "duration_s": 10.0, "objective_tolerance": 1e-8}


def f8(x, u, p, t):
    """Return the rates of Garrard and Jordan's F-8 aircraft."""
    a, b, c, w = x[0], x[1], x[2], u[0]
    return [
        -0.877 * a + c - 0.088 * a * c + 0.47 * a**2 - 0.019 * b**2 - a**2 * c + 3.846 * a**3
        - 0.215 * w + 0.28 * a**2 * w + 0.47 * a * w**2 + 0.63 * w**3,
        c,
        -4.208 * a - 0.396 * c - 0.47 * a**2 - 3.564 * a**3 - 20.967 * w + 6.265 * a**2 * w + 46 * a * w**2 + 61.4 * w**3,
    ]  # fmt: skip


def tank(x, u, p, t):
    """Return the rates of Luus's stirred tank."""
    k = (x[1] + 0.5) * ca.exp(25 * x[0] / (x[0] + 2))
    return [-(2 + u[0]) * (x[0] + 0.25) + k, 0.5 - x[1] - k]


def free_flyer(x, u, p, t):
    """Return the rates of Sakawa's free-flying robot, pairs of whose four thrusters never fire together."""
    left, right = u[0] - u[1], u[2] - u[3]
    return [x[3], x[4], x[5], (left + right) * ca.cos(x[2]), (left + right) * ca.sin(x[2]), 0.2 * (left - right)]


REACH = 5.0


def arm(x, u, p, t):
    """Return the rates of COPS's robot arm: reach, turn, tilt and their speeds."""
    inertia = ((REACH - x[0]) ** 3 + x[0] ** 3) / 3
    return [x[3], x[4], x[5], u[0] / REACH, u[1] / (inertia * ca.sin(x[2]) ** 2), u[2] / inertia]


def shuttle(x, u, p, t):
    """Return the rates of the space shuttle (Betts 2010, 6.1).

    States: height [ft], longitude, latitude [rad], speed [ft/s], flight path angle, azimuth [rad]. Efforts: angle of attack
    and bank angle [rad].
    """
    area, earth, mass = 2690.0, 20902900.0, 203000.0 / 32.174
    height, _, latitude, speed, path, azimuth = (x[i] for i in range(6))
    attack, bank = u[0] / DEG, u[1]
    pressure = 0.5 * area * 0.002378 * ca.exp(-height / 23800.0) * speed**2
    drag = (0.07854 - 0.61592e-2 * attack + 0.621408e-3 * attack**2) * pressure
    lift = (-0.20704 + 0.029244 * attack) * pressure
    radius = earth + height
    weight = 0.14076539e17 / radius**2
    return [
        speed * ca.sin(path),
        speed / radius * ca.cos(path) * ca.sin(azimuth) / ca.cos(latitude),
        speed / radius * ca.cos(path) * ca.cos(azimuth),
        -drag / mass - weight * ca.sin(path),
        lift / (mass * speed) * ca.cos(bank) + ca.cos(path) * (speed / radius - weight / speed),
        lift * ca.sin(bank) / (mass * speed * ca.cos(path))
        + speed / (radius * ca.cos(latitude)) * ca.cos(path) * ca.sin(azimuth) * ca.sin(latitude),
    ]


# Goddard's rocket in COPS's units: 1.01283 there; scipy from switch to switch has 0.0128369183 above the start, to 1e-11.
GODDARD = {
    "rate": lambda x, u, p, t: [
        x[1], (u[0] - 310.0 * x[1] ** 2 * ca.exp(-500.0 * (x[0] - 1))) / x[2] - 1 / x[0] ** 2, -u[0] / 0.5
    ],
    "start": [1, 0, 1], "goal": [NAN, NAN, 0.6], "effort_limit": [[0, 3.5]], "duration_s": (0.01, 1),
    "state_limit": [[1, INF], [0, INF], [0.6, 1]], "final_cost": lambda x0, xT, T, p: -xT[0],
}  # fmt: skip
A_B_C_D_E = a, b, c, d, e = 2.0, 0.1, 5.0, 0.5, 3.0

OPTIMA = {
    # Time in the dynamics, the cost and the path.
    "lever that grows with time": Optimum(2 * 3 * 2 / 1.5**3, LEAST_EFFORT | {
        "rate": lambda x, u, p, t: [t * u[0]], "start": [0], "goal": [2], "duration_s": 1.5}, takes="little"),
    "discounted effort": Optimum(1 / (1 - np.exp(-1)), integrator([0], [1], duration_s=1.0, effort_limit=FREE_EFFORT,
        running_cost=lambda x, u, p, t: ca.exp(t) * u[0] ** 2), takes="little"),
    "x' = t from 0 to 2 takes 2 s": Optimum(2.0, {"rate": lambda x, u, p, t: [t + 0 * u[0]], "start": [0], "goal": [2],
        "running_cost": squared_effort} | QUICKEST),
    "effort below a limit that falls": Optimum(-1.5, integrator([0], [NAN], effort_limit=[[-10, 10]], duration_s=1.0,
        path=lambda x, u, p, t: u[0] + t, path_limit=[[-INF, 2]], final_cost=lambda x0, xT, T, p: -xT[0]), ODE_PUBLISHED),
    # Ends, returns, free states and durations.
    "T + 9 / T between free ends": Optimum(6.0, integrator([NAN], [NAN]) | LEAST_TIME | LEAST_EFFORT | {
        "ends": lambda x0, xT, T, p: xT[0] - x0[0], "ends_limit": [[3, 3]]}),
    "x0^2 + (4 - 2 x0)^2 of a sum of ends": Optimum((8 / 5) ** 2 + (4 / 5) ** 2, integrator([NAN], [NAN]) | LEAST_EFFORT | {
        "ends": lambda x0, xT, T, p: [xT[0] + x0[0], xT[0] - x0[0]], "ends_limit": [[4, INF], [-INF, 1]],
        "final_cost": lambda x0, xT, T, p: x0[0] ** 2, "duration_s": 1.0}, takes="little"),
    "Fourier's balance of a periodic follower": Optimum(np.pi / 3 * 0.45 / 1.45, integrator([NAN], [NAN], returns=[0],
        effort_limit=FREE_EFFORT, duration_s=2 * np.pi / 3, parameters=[3.0, 0.05],
        running_cost=lambda x, u, p, t: (x[0] - ca.sin(p[0] * t)) ** 2 + p[1] * u[0] ** 2)),
    "start up to 0.4 and speed 0.5": Optimum(4 * 0.25 - 12 * 0.5 * 0.6 + 12 * 0.36,
        cart([[0, 0.4], [0, 0.5]], [1, 0], duration_s=1.0) | LEAST_EFFORT),
    "12 / T^3 at the longest T": Optimum(12 / 2.0**3, cart([0, 0], [1, 0], duration_s=(0.5, 2.0)) | LEAST_EFFORT),
    "T + 48 w / T^3": Optimum(4 / 3 * (36 * 0.1 * 4) ** 0.25, cart([0, 0], [2, 0], effort_limit=FREE_EFFORT,
        duration_s=(0.1, 100), parameters=[0.1], running_cost=lambda x, u, p, t: p[0] * u[0] ** 2, final_cost=duration)),
    "parameters everywhere": Optimum((b * d**2 + c) * e / (a * d), {
        "rate": lambda x, u, p, t: [p[0] * u[0]], "start": [0], "goal": [NAN], "effort_limit": [[-9, 9]],
        "duration_s": (0.1, 50), "parameters": A_B_C_D_E, "running_cost": lambda x, u, p, t: p[1] * u[0] ** 2,
        "final_cost": lambda x0, xT, T, p: p[2] * T, "path": lambda x, u, p, t: u[0] - p[3], "path_limit": [[-INF, 0]],
        "ends": lambda x0, xT, T, p: xT[0] - x0[0] - p[4], "ends_limit": [[0, 0]]}, ODE_BOUND_BY_A_STATE),
    # Linear systems with quadratic cost.
    "Gramian of an oscillator": Optimum(least_energy(2 * np.pi, np.array([0.5, 3.0])),
        {"rate": oscillator, "start": [0.5, -1], "goal": [1, 2], "duration_s": 2 * np.pi} | LEAST_EFFORT),
    "Riccati's regulator": regulator(),
    "least effort": Optimum(12 * 2**2 / 1.5**3, cart([0, 0], [2, 0], duration_s=1.5) | LEAST_EFFORT, takes="little"),
    "Kirk's example 5.1.1": Optimum(16.7507234, {"rate": lambda x, u, p, t: [x[1], -x[1] + u[0]], "start": [0, 0],
        "goal": [5, 2], "effort_limit": FREE_EFFORT, "duration_s": 2.0, "running_cost": lambda x, u, p, t: u[0] ** 2 / 2},
        ODE_PUBLISHED, takes="little"),
    "two efforts tied on the path": Optimum(12 * 5 / 9, {"rate": lambda x, u, p, t: [x[1], u[0] + u[1]], "start": [0, 0],
        "goal": [1, 0], "effort_limit": FREE_EFFORT * 2, "duration_s": 1.0, "path": lambda x, u, p, t: u[0] - 2 * u[1],
        "path_limit": [[0, 0]], "running_cost": lambda x, u, p, t: u[0] ** 2 + u[1] ** 2}, takes="little"),
    # Least time, with switches and arcs on limits.
    "least time 1": Optimum(2.0, cart([0, 0], [1, 0]) | QUICKEST),
    "least time 2": Optimum(2 * np.sqrt(2 / 7), cart([0, 0], [-2, 0]) | LEAST_TIME | {"effort_limit": [[-7, 7]]}),
    "cart": Optimum(2 * np.sqrt(2), cart([0, 0], [2, 0], objective_tolerance=1e-7) | QUICKEST),
    "cart of limited speed": Optimum(2 / 0.8 + 0.8, cart([0, 0], [2, 0], state_limit=[FREE_STATE, [-INF, 0.8]]) | QUICKEST),
    "cart of limited power": Optimum(power_limited_cart(2, 0.5), cart([0, 0], [2, 0], path=lambda x, u, p, t: u[0] * x[1],
        path_limit=[[-INF, 0.5]], objective_tolerance=1e-7) | QUICKEST),
    "oscillator to rest": Optimum(sum(ARCS), {"rate": oscillator, "start": before_the_arcs(), "goal": [0, 0],
        "guesses": [StateGuess(state=[before_the_arcs(), [0, 0]], duration_s=sum(ARCS) + 1)]} | QUICKEST),
    "investment": Optimum(-np.exp(2), {"rate": lambda x, u, p, t: [u[0] * x[0]], "start": [1], "goal": [NAN],
        "effort_limit": [[0, 1]], "duration_s": 3.0, "running_cost": lambda x, u, p, t: -(1 - u[0]) * x[0]}),
    **{f"Bryson and Denham below {limit:.2g}": Optimum(value, {"problem": bryson_denham(limit, within)}, within or 1e-6)
        for limit, value, within in ((0.3, 2.0, 1e-7), (0.2, 2 + 6 * (1 - 4 * 0.2) ** 2, 1e-7), (1 / 9, 4.0, 1e-7),
                                     (0.125, 4 / (9 * 0.125), None), (0.04, 4 / (9 * 0.04), None))},
    # Angles: what acts through sine and cosine alone may leap by whole turns from node to node.
    "Zermelo's boat": Optimum(BOAT, {"rate": lambda x, u, p, t: [ca.cos(u[0]) - x[1], ca.sin(u[0])], "start": [3.66, -1.86],
        "goal": [0, 0], "effort_limit": FREE_EFFORT} | LEAST_TIME),
    "Bryson and Ho's orbit": Optimum(-1.52525, {"rate": lambda x, u, p, t: [
        x[1], x[2] ** 2 / x[0] - 1 / x[0] ** 2 + 0.1405 * ca.sin(u[0]) / (1 - 0.07487 * t),
        -x[1] * x[2] / x[0] + 0.1405 * ca.cos(u[0]) / (1 - 0.07487 * t)],
        "start": [1, 0, 1], "goal": [NAN, 0, NAN], "effort_limit": FREE_EFFORT, "duration_s": 3.32,
        "ends": lambda x0, xT, T, p: xT[2] - 1 / ca.sqrt(xT[0]), "ends_limit": [[0, 0]],
        "final_cost": lambda x0, xT, T, p: -xT[0]}, ODE_FOUR_DIGITS),
    "linear tangent law of COPS": Optimum(0.554571, {"rate": lambda x, u, p, t: [
        x[2], x[3], 100 * ca.cos(u[0]), 100 * ca.sin(u[0])], "start": [0, 0, 0, 0], "goal": [NAN, 5, 45, 0],
        "effort_limit": [[-np.pi / 2, np.pi / 2]], "duration_s": (0.01, 10), "final_cost": duration}, ODE_FOUR_DIGITS),
    "brachistochrone": Optimum(0.8247591431566, {
        "rate": lambda x, u, p, t: [x[2] * ca.sin(u[0]), x[2] * ca.cos(u[0]), G * ca.cos(u[0])],
        "start": [0, 0, 0], "goal": [2, 2, NAN], "effort_limit": [[0, np.pi]]} | LEAST_TIME),
    # Ways that bend, local optima, long and stiff motions.
    "cart-pole": Optimum(58.8077, SWING_UP, ODE_FOUR_DIGITS),
    "cart-pole, from a guess": Optimum(57.9449, SWING_UP | {"guesses": [
        StateGuess(state=[[0, 0, 0, 0], [0, -np.pi / 3, 0, 0], [1, np.pi, 0, 0]])]}, ODE_FOUR_DIGITS),
    "chain of COPS": Optimum(catenary(), {"rate": lambda x, u, p, t: [u[0], ca.sqrt(1 + u[0] ** 2)], "start": [1, 0],
        "goal": [3, 4], "effort_limit": FREE_EFFORT, "duration_s": 1.0,
        "running_cost": lambda x, u, p, t: x[0] * ca.sqrt(1 + u[0] ** 2),
        "guesses": [StateGuess(state=[[1, 0], [3, 4]], effort=[[-4], [5]])]}),
    "F-8 aircraft": Optimum(3.78086, {"rate": f8, "start": [0.4655, 0, 0], "goal": [0, 0, 0],
        "effort_limit": [[-0.05236, 0.05236]],
        "guesses": [StateGuess(state=[[0.4655, 0, 0], [0, 0, 0]], duration_s=3.0)]} | LEAST_TIME, ODE_FOUR_DIGITS),
    "round a disk": Optimum(round_a_disk(2, 0.3), {"rate": lambda x, u, p, t: [ca.cos(u[0]), ca.sin(u[0])],
        "start": [-2, 0.3], "goal": [2, 0.3], "effort_limit": FREE_EFFORT, "path_limit": [[1, INF]],
        "path": lambda x, u, p, t: x[0] ** 2 + x[1] ** 2} | LEAST_TIME, ODE_KINKED),
    **{f"hypersensitive over {T:g} s": Optimum(layer(1) - 1 / 4 + layer(1.5) + 1.5**4 / 4, {
        "rate": lambda x, u, p, t: [-(x[0] ** 3) + u[0]], "start": [1], "goal": [1.5], "effort_limit": FREE_EFFORT,
        "duration_s": T, "running_cost": lambda x, u, p, t: (x[0] ** 2 + u[0] ** 2) / 2}) for T in (25.0, 1e3)},
    "Luus's stirred tank": Optimum(0.133095, {"rate": tank, "start": [0.09, 0.09], "goal": [NAN, NAN],
        "effort_limit": FREE_EFFORT, "duration_s": 0.78,
        "running_cost": lambda x, u, p, t: x[0] ** 2 + x[1] ** 2 + 0.1 * u[0] ** 2}, 1.5e-5, takes="little"),
    "free-flying robot": Optimum(7.9101546, {"rate": free_flyer, "start": [-10, -10, np.pi / 2, 0, 0, 0], "goal": [0] * 6,
        "effort_limit": [[0, 1]] * 4, "path": lambda x, u, p, t: [u[0] + u[1], u[2] + u[3]], "path_limit": [[-INF, 1]] * 2,
        "duration_s": 12.0, "running_cost": lambda x, u, p, t: ca.sum1(u)}, ODE_FOUR_DIGITS, takes="long"),
    # COPS's arm by scipy at five switch times, 9.14093620 in Betts; Robbins' problem by Lagrange's dual; Betts's shuttle.
    "arm": Optimum(9.1409117459143, {"rate": arm, "start": [4.5, 0, np.pi / 4, 0, 0, 0], "effort_limit": [[-1, 1]] * 3,
        "goal": [4.5, 2 * np.pi / 3, np.pi / 4, 0, 0, 0], "duration_s": (1, 100), "final_cost": duration,
        "state_limit": [[0, REACH], [-np.pi, np.pi], [0, np.pi], FREE_STATE, FREE_STATE, FREE_STATE],
        "objective_tolerance": 1e-9}),
    "Robbins": Optimum(19.431781917568, {"problem": robbins(1e-6)}, 1e-6, takes="long"),
    "space shuttle": Optimum(-34.1412, {"rate": shuttle, "start": [260000, 0, 0, 25600, -1 * DEG, 90 * DEG],
        "goal": [80000, NAN, NAN, 2500, -5 * DEG, NAN], "effort_limit": [[-90 * DEG, 90 * DEG], [-89 * DEG, 1 * DEG]],
        "state_limit": [[0, INF], FREE_STATE, [-89 * DEG, 89 * DEG], [1, INF], [-89 * DEG, 89 * DEG], FREE_STATE],
        "duration_s": (500, 5000), "final_cost": lambda x0, xT, T, p: -xT[2] / DEG, "guesses": [StateGuess(duration_s=2000,
            state=[[260000, 0, 0, 25600, -1 * DEG, 90 * DEG], [80000, 30 * DEG, 30 * DEG, 2500, -5 * DEG, 0]],
            effort=[[-75 * DEG, 0], [-75 * DEG, 0]])]}, ODE_FOUR_DIGITS, takes="long"),
    # By solve_bvp on Pontryagin's conditions; below a wave by Hermite and Simpson's rule.
    "van der Pol, free": Optimum(2.8731458, PUSHED_BACK | {"effort_limit": FREE_EFFORT}, ODE_FOUR_DIGITS),
    "van der Pol, bound": Optimum(2.8733063, PUSHED_BACK | {"effort_limit": [[-0.75, 1.0]]}, ODE_FOUR_DIGITS),
    "van der Pol, bound above": Optimum(2.9968097, PUSHED_BACK | {"effort_limit": [[-INF, 0.8]]}, ODE_FOUR_DIGITS),
    "van der Pol above a wave": Optimum(2.871975, VAN_DER_POL | ONE | {"goal": [NAN, NAN], "duration_s": 6.0,
        "path": lambda x, u, p, t: x[0] + 0.3 * ca.sin(t), "path_limit": [[-0.3, INF]],
        "mesh": MeshSettings(intervals=25)}, ODE_FOUR_DIGITS),
    # Singular arcs: Jacobson's u = -1 and then u = x with x' = -x tanh(5 - t), by scipy's quadrature.
    "Jacobson's singular problem": Optimum(0.3769919302879446, cart([0, 1], [NAN, NAN], duration_s=5.0,
        running_cost=lambda x, u, p, t: (x[0] ** 2 + x[1] ** 2) / 2) | ONE, ODE_PUBLISHED),
    "Aly and Chan's singular problem": Optimum(0.0, cart([0, 1], [NAN, NAN], duration_s=np.pi / 2,
        mesh=MeshSettings(intervals=10), running_cost=lambda x, u, p, t: (x[1] ** 2 - x[0] ** 2) / 2) | ONE, ODE_SINGULAR),
    "catalysts of COPS": Optimum(-0.0480556, {"rate": lambda x, u, p, t: [
        u[0] * (10 * x[1] - x[0]), u[0] * (x[0] - 10 * x[1]) - (1 - u[0]) * x[1]], "start": [1, 0], "goal": [NAN, NAN],
        "effort_limit": [[0, 1]], "duration_s": 1.0, "final_cost": lambda x0, xT, T, p: xT[0] + xT[1] - 1}, ODE_FOUR_DIGITS),
    "Goddard's rocket": Optimum(-1.0128369183, GODDARD | {
        "guesses": [StateGuess(state=[[1, 0.05, 1], [1.01, 0.05, 0.6]], duration_s=0.2)]}, 1e-7),
    "Goddard's rocket without a guess": Optimum(-1.0128369183, GODDARD, 1e-8, takes="long"),
}  # fmt: skip


@cache
def optimum(name: str) -> OdePlan:
    """Return the plan of a problem of the table, solved once."""
    fields = OPTIMA[name].fields
    return solved(fields.get("problem") or OdeProblem(name=name, **fields))
