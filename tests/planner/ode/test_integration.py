"""Integration against a solution: what is unstable, and errors from restart to restart in closed form."""

import numpy as np
import pytest

from linkplan.planner.certificate.flow import scaled_defects
from linkplan.planner.ode.certificate import integrate
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.transcription.collocation import Curves
from tests.support.ode import FREE_EFFORT, NAN


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
