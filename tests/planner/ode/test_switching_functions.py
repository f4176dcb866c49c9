"""Costates, switching functions and what they ask for, each against its closed form, and which solutions are replaced."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.switches import (
    Switching,
    _bang_efforts,
    _promised,
    _switch_times,
    has_arcs,
    switching_of,
)
from linkplan.planner.ode.trajectory import OdeTrajectory
from tests.support.ode import double_integrator

BREAKS = np.array([10.0, 10.5, 12.0])


def moving(efforts: list[list[float]], breaks_s: np.ndarray = BREAKS) -> OdeTrajectory:
    """Return a motion of two states at rest with efforts by their coefficients (degree + 1, n)."""
    return OdeTrajectory(
        breaks_s=breaks_s, state=np.ones((2, len(breaks_s) - 1, 2)), effort=np.array(efforts, dtype=float)[:, :, None], n_x=2
    )  # fmt: skip


def problem_of(running_cost, limit=(-2.0, 5.0)) -> OdeProblem:
    return OdeProblem(
        name="double integrator", rate=double_integrator, start=[0, 0], goal=[1, 0], effort_limit=[limit],
        duration_s=2.0, running_cost=running_cost,
    )  # fmt: skip


def solution_of(costates: np.ndarray, objective: float = 1.0, units=(1.0, 1.0, 1.0)) -> SimpleNamespace:
    """Return a solution with costates (n, 2) at the intervals' ends; `units` are of the objective and the states."""
    scaled = -np.asarray(costates) * np.array(units[1:]) / units[0]
    interval = SimpleNamespace(n_rows=3, own_kinds=("continuity", "continuity", "speed"))
    program = SimpleNamespace(interval=interval, layout=SimpleNamespace(n_intervals=len(scaled)))
    transcribed = SimpleNamespace(program=program, units=SimpleNamespace(objective=units[0], state=np.array(units[1:])))
    return SimpleNamespace(
        multipliers=np.column_stack([scaled, np.full(len(scaled), 9.0)]).ravel(),
        transcribed=transcribed,
        objective=objective,
    )


def test_costates_go_backwards_by_the_slopes_of_the_hamiltonian():
    """x'' = u and L = t x + u^2: the costate of x is l - t^2 / 2, that of v a cubic, and 2 u of each interval is added."""
    problem = problem_of(lambda x, u, p, t: t * x[0] + u[0] ** 2)  # noqa: ARG005
    last = np.array([[3.0, -1.0], [-2.0, 0.5]])
    found = switching_of(problem, moving([[3.0, -1.0]]), solution_of(last, units=(2.0, 0.5, 4.0)))
    for k, effort in enumerate((3.0, -1.0)):
        t, end = found.time_s[k], BREAKS[k + 1]
        assert (t[0], t[-1]) == (BREAKS[k], end)
        of_x = np.polynomial.Polynomial([last[k, 0] + end**2 / 2, 0.0, -0.5])
        of_v = last[k, 1] - (of_x.integ()(t) - of_x.integ()(end))
        assert found.value[k, :, 0] == pytest.approx(of_v + 2 * effort, rel=1e-7, abs=1e-6)


def by_time(time: np.ndarray, *functions) -> Switching:
    return Switching(time_s=time, value=np.stack([function(time) for function in functions], axis=2))


def test_a_switching_function_next_to_zero_asks_for_nothing():
    time = np.linspace(0.0, 2.0, 5)[None]
    faint = Switching(time_s=time, value=np.array([1.0, 1.0, -1e-8, 1.0, 1.0])[None, :, None])
    assert len(_switch_times(faint)) == 0
    clear = Switching(time_s=time, value=np.array([1.0, 1.0, -1e-4, 1.0, 1.0])[None, :, None])
    assert len(_switch_times(clear)) == 2


@pytest.mark.parametrize(
    ("switches_at", "kept"),
    [
        ([10.3], [10.3]),
        ([10.0 + 1e-8], []),
        ([11.0 - 1e-8], []),
        ([10.0 + 1e-6], [10.0 + 1e-6]),
        ([11.0 - 1e-6], [11.0 - 1e-6]),
        ([10.3, 10.3 + 1e-8], [10.3]),
        ([10.3, 10.3 + 1e-6], [10.3, 10.3 + 1e-6]),
        ([10.7, 10.3], [10.3, 10.7]),
    ],
)
def test_switches_closer_than_a_ten_millionth_of_the_duration_are_one_or_none(switches_at, kept):
    """The motion lasts a second, from 10 s on."""
    time = np.array([[10.0, 10.5, 11.0]])
    found = _switch_times(by_time(time, *[lambda t, at=at: t - at for at in switches_at]))
    assert found == pytest.approx(kept, rel=1e-12)


@pytest.mark.parametrize(("near", "kept"), [(2e-8, 0), (2e-6, 1)])
def test_a_switch_next_to_an_end_of_the_motion_is_none(near, kept):
    """Of functions that are clearly not zero at any instant."""
    time = np.array([[10.0, 10.0 + near, 11.0 - near, 11.0]])
    at_the_start, at_the_end = np.array([[-1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, -1.0]])
    for values in (at_the_start, at_the_end):
        assert len(_switch_times(Switching(time_s=time, value=values[None, :, None]))) == kept


@pytest.mark.parametrize(
    ("value", "gain"), [(1.0, 1.0 * (2.0 * 0.5 + 1.0 * 1.5)), (-2.0, 2.0 * (5.0 * 0.5 + 6.0 * 1.5)), (0.0, 0.0)]
)
def test_efforts_at_the_limits_that_switching_functions_ask_for_promise_their_distance_times_the_function(value, gain):
    """Efforts of 0 and then -1 between limits of -2 and 5, for 0.5 s and 1.5 s."""
    time = BREAKS[:-1, None] + np.diff(BREAKS)[:, None] * np.linspace(0.0, 1.0, 9)
    switching = by_time(time, lambda t: 0 * t + value)
    assert _promised(moving([[0.0, -1.0]]), switching, np.array([[-2.0, 5.0]])) == pytest.approx(gain, abs=1e-12)


def test_efforts_are_held_where_the_middle_of_a_segment_asks_for_them():
    time = np.linspace(10.0, 12.0, 9)[None]
    held = _bang_efforts(by_time(time, lambda t: t - 11.0), np.array([10.0, 11.0, 12.0]), np.array([[-2.0, 5.0]]))
    assert held.tolist() == [[5.0], [-2.0]]


@pytest.mark.parametrize(("n", "arcs"), [(3, False), (4, True)])
def test_efforts_that_go_from_limit_to_limit_within_each_of_four_intervals_are_an_arc(n, arcs):
    slopes = np.array([[-5.0] * n, [5.0] * n])
    at_limit = np.full((2, 7 - n), 5.0)
    motion = moving(np.hstack([at_limit, slopes]).tolist(), np.arange(8.0))
    assert has_arcs(motion, np.array([[-5.0, 5.0]])) is arcs


# Which solutions replace others.
