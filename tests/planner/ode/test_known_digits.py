"""The objective's error is estimated, and only the digits that are known are printed."""

import itertools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.ode.formulation import guesses_of, start_from, units_of
from linkplan.planner.ode.plan import OdeCase, plan_ode, plan_of
from linkplan.planner.ode.problem import OdeProblem, StateGuess
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.decision import refine
from linkplan.planner.transcription.mesh import uniform
from tests.support.ode import (
    FREE_EFFORT,
    FREE_STATE,
    INF,
    NAN,
    bryson_denham,
    robbins,
    solved,
    squared_effort,
)

DEG = np.pi / 180.0


# Robbins' problem by Lagrange's dual: where the motion touches its limit, and from when on it stays there, about.
ROBBINS_TOUCHES, ROBBINS_AT_REST = np.array([0.97666543, 4.22707264, 5.25964376]), 5.47032283


def robbins_below(touches: np.ndarray, at_rest: float) -> float:
    """Return a lower bound on Robbins' optimum: the least cost if y >= 0 counts at touches (m,) only, and 3 y before a time.

    What is left out of the cost is not negative, and fewer limits make it no larger. Before that time u''' = 3, then 0, and
    u'' jumps at touches: y is a sum of powers, and its values are linear equations.
    """
    unit = [1.0, 1.0, 2.0, 6.0, 24.0, 120.0, 720.0]

    def power(k: int, t: float, since: float) -> np.ndarray:
        return np.array([max(t - since, 0.0) ** (k + 3 - i) / unit[k + 3 - i] for i in range(4)])

    def at(t: float) -> tuple[np.ndarray, np.ndarray]:
        """Return y, y', y'' and u at a time, as a matrix of the unknowns and a vector."""
        columns = [power(0, t, 0.0), power(1, t, 0.0), power(2, t, 0.0), *(power(2, t, touch) for touch in touches)]
        return np.array(columns).T, 3 * power(3, t, 0.0) - 3 * power(3, t, at_rest) + np.array([1 - 2 * t, -2, 0, 0])

    rows = [*zip(*(part[:3] for part in at(10.0)), strict=True), *((a[0], b[0]) for a, b in map(at, touches))]
    unknowns = np.linalg.solve([row for row, _ in rows], [-value for _, value in rows])
    assert np.all(unknowns[3:] < 0)  # limits push y upwards: they are inequalities
    share, weight = np.polynomial.legendre.leggauss(8)
    cost, ends = 0.0, np.concatenate([[0.0], touches, [at_rest, 10.0]])
    for left, right in itertools.pairwise(ends):
        for t, w in zip(left + (right - left) * (share + 1) / 2, (right - left) / 2 * weight, strict=True):
            matrix, vector = at(t)
            y, _, _, u = matrix @ unknowns + vector
            cost += w * (3 * y * (t < at_rest) + u**2 / 2)
    return cost


@pytest.mark.long
def test_robbins_optimum_is_as_near_as_the_plan_says():
    optimum = robbins_below(ROBBINS_TOUCHES, ROBBINS_AT_REST)
    plan = plan_ode(robbins(1e-6))
    assert abs(plan.objective - optimum) <= plan.objective_error + 1e-8 * optimum
    assert plan.objective == pytest.approx(optimum, rel=1e-6)
    assert plan.objective_error <= 1e-5 * optimum


# The straight line between the boundary values.


def shuttle() -> OdeProblem:
    """Return the reentry of the space shuttle with the largest cross range (Betts 2010, 6.1); published: 34.1412 deg.

    States: height [ft], longitude, latitude [rad], speed [ft/s], flight path angle, azimuth [rad]. Efforts: angle of attack
    and bank angle [rad].
    """
    area, earth, mass = 2690.0, 20902900.0, 203000.0 / 32.174

    def rate(x, u, p, t):  # noqa: ARG001
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

    return OdeProblem(
        name="space shuttle",
        rate=rate,
        start=[260000, 0, 0, 25600, -1 * DEG, 90 * DEG],
        goal=[80000, NAN, NAN, 2500, -5 * DEG, NAN],
        effort_limit=[[-90 * DEG, 90 * DEG], [-89 * DEG, 1 * DEG]],
        state_limit=[[0, INF], FREE_STATE, [-89 * DEG, 89 * DEG], [1, INF], [-89 * DEG, 89 * DEG], FREE_STATE],
        duration_s=(500, 5000),
        final_cost=lambda x0, xT, T, p: -xT[2] / DEG,  # noqa: ARG005
    )


@pytest.mark.long
def test_a_shuttle_comes_down_as_published_from_a_guess_of_its_turn():
    asked = shuttle()
    last = [80000, 30 * DEG, 30 * DEG, 2500, -5 * DEG, 0]
    turn = StateGuess(state=[asked.start[:, 0], last], effort=[[-75 * DEG, 0], [-75 * DEG, 0]], duration_s=2000)
    plan = solved(replace(asked, guesses=[turn]))
    assert plan.objective == pytest.approx(-34.1412, abs=5e-5)
    assert plan.objective_error < 1e-6 * abs(plan.objective)


def test_the_straight_line_is_a_start_beside_guesses_that_lead_nowhere():
    problem = OdeProblem(
        name="1 / x",
        rate=lambda x, u, p, t: [u[0] / x[0]],  # noqa: ARG005
        start=[1],
        goal=[2],
        effort_limit=FREE_EFFORT,
        duration_s=1.0,
        running_cost=squared_effort,
        guesses=[StateGuess(state=[[0.0], [0.0]])],  # there the rate is not finite
    )
    assert plan_ode(problem).objective == pytest.approx(1.5**2, rel=1e-6)  # (x^2 / 2)' = u


# Plans that fail.


def test_a_plan_whose_objective_is_known_on_one_mesh_only_says_that_its_error_is_not_known():
    problem = bryson_denham(0.1, None)
    guess = guesses_of(problem)[0]
    case = OdeCase(problem, units_of(problem, guess))
    found = attempt(case, start_from(guess, case.units), uniform(40), np.array([1.0]), "first solve")
    plan = plan_of(problem, replace(refine(case, found), objective_error=INF))
    assert plan.status == "optimal"
    assert plan.objective_error is None
    assert plan.message.startswith("optimum 4.44 in 1 s; the error of the objective is not known")
