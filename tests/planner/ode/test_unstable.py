"""Differential equations whose motions are unstable: errors from restart to restart, and judged by defects all the same."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from linkplan.planner.certificate.flow import INTEGRATION_RTOL, scaled_defects
from linkplan.planner.certificate.integration import RESTART_GROWTH
from linkplan.planner.ode.certificate import certify_ode, integrate
from linkplan.planner.ode.plan import OdePlan
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.transcription.collocation import Curves
from tests.support.ode import FREE_EFFORT, NAN, solved
from tests.support.tolerances_planner import ODE_CLOSED_FORM

# x' = POLE x + u: an error grows by e for every 1 / POLE [s].
POLE, LONG_S = 2.0, 15.0


def beside_a_pole(duration_s: float, pole: float = POLE) -> OdeProblem:
    """Return the problem of going from 1 to 1 at the least int (x^2 + u^2) / 2."""
    return OdeProblem(
        name="beside a pole",
        rate=lambda x, u, p, t: [pole * x[0] + u[0]],  # noqa: ARG005
        start=[1],
        goal=[1],
        effort_limit=FREE_EFFORT,
        duration_s=duration_s,
        running_cost=lambda x, u, p, t: (x[0] ** 2 + u[0] ** 2) / 2,  # noqa: ARG005
    )


@cache
def long() -> OdePlan:
    """Return the plan along which errors grow beyond all rounding."""
    return solved(beside_a_pole(LONG_S))


@pytest.mark.slow
def test_a_motion_that_no_integration_could_follow_is_planned_and_judged_anew_as_often_as_errors_grow():
    """x = a e^(-w t) + b e^(-w (T - t)) with w^2 = POLE^2 + 1, the costate is POLE x - x'."""
    assert np.exp(POLE * LONG_S) * np.finfo(float).eps > 1e-4
    w, T = np.sqrt(POLE**2 + 1), LONG_S
    a, b = np.linalg.solve([[1, np.exp(-w * T)], [np.exp(-w * T), 1]], [1, 1])
    slopes = [w * (-a + b * np.exp(-w * T)), w * (-a * np.exp(-w * T) + b)]
    plan = long()
    assert plan.objective == pytest.approx((slopes[1] - slopes[0]) / 2, rel=ODE_CLOSED_FORM)
    assert 1 <= plan.certificate.integration_restarts <= POLE * LONG_S / np.log(RESTART_GROWTH) + 1
    assert plan.certificate.integration_error <= plan.problem.tolerance
    assert "unstable" in plan.message


@pytest.mark.parametrize("n_intervals", [20, 2000])
@pytest.mark.parametrize(("coupling", "unstable"), [(5.0, True), (2.0, False)])
def test_whether_a_motion_is_unstable_does_not_hang_on_its_mesh(n_intervals, coupling, unstable):
    """x' = [[-3, c], [c, -3]] x grows by c - 3 in one direction; over a short time all of its entries fall."""
    problem = OdeProblem(
        name="coupled",
        rate=lambda x, u, p, t: [-3 * x[0] + coupling * x[1] + u[0], coupling * x[0] - 3 * x[1]],  # noqa: ARG005
        start=[0, 0],
        goal=[0, 0],
        effort_limit=FREE_EFFORT,
        duration_s=LONG_S,
        running_cost=lambda x, u, p, t: u[0] ** 2,  # noqa: ARG005
    )
    still = Curves(
        breaks_s=np.linspace(0.0, LONG_S, n_intervals + 1),
        state=np.zeros((4, n_intervals, 2)),
        effort=np.zeros((3, n_intervals, 1)),
    )
    assert (certify_ode(problem, still).integration_restarts > 0) == unstable


@pytest.mark.slow
def test_the_objective_of_an_unstable_motion_is_judged_along_it():
    motion = long().trajectory
    judged = certify_ode(long().problem, replace(motion, running=motion.running * (1 + 1e-2)))
    assert judged.objective_error == pytest.approx(1e-2, rel=0.1)
    assert not judged.passed


@pytest.mark.parametrize(
    ("off", "n_off", "duration_s"), [(0.0, 1, LONG_S), (1e-9, 1, LONG_S), (1e-9, 60, LONG_S), (1e-9, 1, 8.0)]
)
def test_along_a_constant_state_an_error_grows_by_the_pole_until_the_integration_is_begun_anew(off, n_off, duration_s):
    """x' = POLE x + u stays at 1 under u = -POLE. An effort off by `off` in the first `h` seconds leaves

    e(t) = off (e^(POLE h) - 1) / POLE e^(POLE (t - h)), t >= h.
    """
    problem, n = beside_a_pole(duration_s), 60
    breaks, effort = np.linspace(0.0, duration_s, n + 1), np.full((1, n, 1), -POLE)
    effort[0, :n_off, 0] += off
    still = Curves(breaks_s=breaks, state=np.ones((2, n, 1)), effort=effort)
    certificate = certify_ode(problem, still)
    most = max(RESTART_GROWTH, problem.tolerance / INTEGRATION_RTOL)
    until = breaks[np.flatnonzero(np.exp(POLE * breaks) > most)[0]]
    h = min(breaks[n_off], until)
    left = off * np.expm1(POLE * h) / POLE * np.exp(POLE * (until - h))
    assert certificate.integration_restarts == int(duration_s / until)
    assert certificate.integration_error == pytest.approx(left, rel=1e-3, abs=1e-8)
    assert certificate.integrated_objective == pytest.approx(duration_s * (1 + POLE**2) / 2, rel=1e-6 if not off else 1e-3)


def growing(rate, duration_s: float = 2.0, n_x: int = 1, **given) -> OdeProblem:
    """Return x' = rate(t) x for the first state; a second one rests."""
    return OdeProblem(
        name="growing", rate=lambda x, u, p, t: [rate(t) * x[0], 0.0][:n_x], start=[NAN] * n_x, goal=[NAN] * n_x,  # noqa: ARG005
        effort_limit=FREE_EFFORT, duration_s=duration_s, final_cost=lambda x0, xT, T, p: xT[0], **given,  # noqa: ARG005
    )  # fmt: skip


def straight(ends: list[float], breaks_s: np.ndarray, n_x: int = 1) -> Curves:
    """Return a motion that goes straight from one value to the next; a second state rests at 1."""
    state = np.array([ends[:-1], ends[1:]])[:, :, None]
    state = np.concatenate([state, np.ones_like(state)], axis=2)[:, :, :n_x]
    return Curves(breaks_s=breaks_s, state=state, effort=np.zeros((1, len(ends) - 1, 1)))


def restarts(problem: OdeProblem) -> int:
    """Return the number of restarts of an integration over two seconds."""
    still = straight([1.0, 1.0, 1.0], np.array([0.0, 1.0, 2.0]))
    return integrate(problem, still, np.ones(1), np.linspace(0.0, 1.0, 5)).restarts


@pytest.mark.parametrize(
    ("growth", "tolerance", "unstable"), [(1e3, 1e-10, False), (1e5, 1e-8, True), (1e5, 1e-6, False), (1e7, 1e-6, True)]
)
def test_a_motion_is_unstable_where_errors_grow_ten_thousandfold_or_beyond_what_the_tolerance_allows(
    growth, tolerance, unstable
):
    problem = growing(lambda t: 0 * t + np.log(growth) / 2.0, tolerance=tolerance)
    assert (restarts(problem) > 0) == unstable


@pytest.mark.parametrize(("slope", "unstable"), [(6.0, True), (-6.0, False)])
def test_what_grows_late_is_unstable_and_what_fades_is_not(slope, unstable):
    """x' = slope t x: at most e^12 over two seconds."""
    problem = growing(lambda t: slope * t)
    assert (restarts(problem) > 0) == unstable


def test_errors_that_grow_beyond_rounding_are_carried_on_from_restart_to_restart():
    """x' = a x: an interval multiplies an error by e^(a h) = e^5, and the integration is restarted after every two."""
    ends, h, size = [1.0, 2.0, -1.0, 3.0, 0.5], 0.5, np.array([2.0, 1.0])
    problem = growing(lambda t: 10.0 + 0 * t, n_x=2)
    found = integrate(problem, straight(ends, h * np.arange(5.0), 2), size, np.linspace(0.0, 1.0, 5))
    factor = np.exp(10.0 * h)
    made = np.array([(factor * ends[k] - ends[k + 1]) / size[0] for k in range(4)])
    errors = np.array([made[0], factor * made[0] + made[1], made[2], factor * made[2] + made[3]])
    assert found.restarts == 2
    assert found.errors[:, 0] == pytest.approx(np.abs(errors), rel=1e-5)
    assert found.errors[:, 1] == pytest.approx(np.zeros(4), abs=1e-12)
    assert found.states[:, -1, 0] == pytest.approx(ends[1:] + errors * size[0], rel=1e-5)  # from where it has come to
    shares = np.abs(made) * np.abs(errors).max() / np.abs(made).sum()
    assert scaled_defects(found.defects, found.errors)[:, 0] == pytest.approx(shares, rel=1e-5)


# A motion as functions of time, from a beginning that is not zero.

MOTION = Curves(
    breaks_s=np.array([1.0, 2.0, 4.0]), state=np.array([[[0.0], [2.0]], [[2.0], [-4.0]]]),
    effort=np.array([2.0, -3.0])[None, :, None],
)  # fmt: skip


def test_a_motion_lasts_from_its_first_break_to_its_last():
    assert MOTION.duration_s == 3.0


def test_rates_are_the_slopes_of_states():
    at = np.array([1.5, 2.0, 3.0])
    assert MOTION.state_at(at)[:, 0] == pytest.approx([1.0, 2.0, -1.0])
    assert MOTION.rate_at(at)[:, 0] == pytest.approx([2.0, -3.0, -3.0])


def test_dense_times_are_on_both_sides_of_each_break():
    time = MOTION.dense_times(4)
    assert time == pytest.approx([1.0, 1.25, 1.5, 1.75, 2.0, 2.0, 2.5, 3.0, 3.5, 4.0], abs=1e-9)
    assert MOTION.effort_at(time)[:, 0].tolist() == [2.0] * 5 + [-3.0] * 5
