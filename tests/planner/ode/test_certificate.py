"""The certificate of a given motion of a differential equation, in closed form."""

import numpy as np
import pytest

from linkplan.planner.ode.certificate import certify_ode
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.switches import has_arcs
from linkplan.planner.ode.trajectory import OdeTrajectory
from tests.support.ode import FREE_EFFORT, NAN, squared_effort

SPEED, DURATION_S, INTERVALS = 3.0, 2.0, 4


def judged(running: np.ndarray | None = None, **given):
    """Return the certificate of x = SPEED t with x' = u, int u^2 and the final cost 5 x(T) - x(0) + T^2."""
    problem = OdeProblem(
        name="straight",
        rate=lambda x, u, p, t: [u[0]],  # noqa: ARG005
        effort_limit=FREE_EFFORT,
        duration_s=DURATION_S,
        running_cost=squared_effort,
        final_cost=lambda x0, xT, T, p: 5 * xT[0] - x0[0] + T**2,  # noqa: ARG005
        **{"start": [0], "goal": [NAN]} | given,
    )
    breaks = np.linspace(0.0, DURATION_S, INTERVALS + 1)
    motion = OdeTrajectory(
        breaks_s=breaks,
        state=SPEED * np.array([breaks[:-1], breaks[1:]])[:, :, None],
        effort=np.full((1, INTERVALS, 1), SPEED),
        n_x=1,
        running=running,
    )
    return certify_ode(problem, motion)


OF_INTERVAL = SPEED**2 * DURATION_S / INTERVALS
FINAL = 5 * SPEED * DURATION_S + DURATION_S**2


@pytest.mark.parametrize("running", [None, np.full(INTERVALS, OF_INTERVAL)], ids=["unknown", "known"])
def test_the_objective_is_the_running_cost_and_the_final_cost(running):
    certificate = judged(running)
    assert certificate.passed, certificate.failures
    assert certificate.integrated_objective == pytest.approx(INTERVALS * OF_INTERVAL + FINAL, rel=1e-12)


def test_the_error_of_the_running_cost_is_a_share_of_the_whole_objective():
    excess = 0.1
    certificate = judged(np.full(INTERVALS, OF_INTERVAL * (1 + excess)))
    running = INTERVALS * OF_INTERVAL
    assert certificate.objective_error == pytest.approx(excess * running / ((1 + excess) * running + FINAL), rel=1e-9)
    assert any("objective" in failure for failure in certificate.failures)


@pytest.mark.parametrize(("limit", "margin"), [([-1.0, 10.0], 1.0), ([-5.0, 8.0], 2.0), ([0.0, 5.5], -0.5)])
def test_the_margin_of_a_state_is_its_least_distance_to_its_limits(limit, margin):
    certificate = judged(state_limit=[limit])
    assert certificate.state_margin[0] == pytest.approx(margin, abs=1e-9)
    assert certificate.passed == (margin > 0)


@pytest.mark.parametrize(("limit", "margin"), [([-1.0, 10.0], 1.0), ([-5.0, 8.0], 2.0), ([0.0, 5.5], -0.5)])
def test_the_margin_of_a_path_quantity_is_its_least_distance_to_its_limits(limit, margin):
    certificate = judged(path=lambda x, u, p, t: x[0], path_limit=[limit])  # noqa: ARG005
    assert certificate.path_margin[0] == pytest.approx(margin, abs=1e-9)
    assert any("path quantity 0 leaves its limits" in failure for failure in certificate.failures) == (margin < 0)


@pytest.mark.parametrize(("share", "leaves"), [(5e-9, False), (1e-7, True)])
def test_a_state_that_is_integrated_without_error_may_leave_its_limits_by_rounding_alone(share, leaves):
    certificate = judged(state_limit=[[-1.0, SPEED * DURATION_S * (1 - share)]])
    assert certificate.integration_error < 1e-10
    assert certificate.leaves_states == leaves


@pytest.mark.parametrize(
    ("limits", "excess"),
    [([[-1.0, 10.0]], 0.0), ([[-5.0, 2.5]], 0.5), ([[3.25, 9.0]], 0.25), ([[-1.0, 10.0], [0.5, 1.0]], 0.5)],
)
def test_an_effort_is_refused_by_the_most_that_one_exceeds_its_limits(limits, excess):
    """The second effort, where there is one, rests at zero."""
    problem = OdeProblem(
        name="straight",
        rate=lambda x, u, p, t: [u[0]],  # noqa: ARG005
        start=[0],
        goal=[NAN],
        effort_limit=limits,
        duration_s=DURATION_S,
        final_cost=lambda x0, xT, T, p: xT[0],  # noqa: ARG005
    )
    state = np.array([[0.0], [SPEED * DURATION_S]])[:, :, None]
    effort = np.array([SPEED, 0.0])[: len(limits)].reshape(1, 1, -1)
    certificate = certify_ode(
        problem, OdeTrajectory(breaks_s=np.array([0.0, DURATION_S]), state=state, effort=effort, n_x=1)
    )
    assert certificate.effort_excess == pytest.approx(excess)
    assert any("an effort exceeds its limit" in failure for failure in certificate.failures) == (excess > 0)


@pytest.mark.parametrize(
    ("asked", "missed"),
    [
        ({"start": [1.5]}, 1.5 / (SPEED * DURATION_S)),
        ({"goal": [SPEED * DURATION_S + 1.5]}, 1.5 / (SPEED * DURATION_S)),
        ({"start": [NAN], "returns": [0]}, 1.0),
        ({"ends": lambda x0, xT, T, p: [xT[0] - x0[0]], "ends_limit": [[-1.0, 5.5]]}, 0.5 / (SPEED * DURATION_S)),  # noqa: ARG005
    ],
    ids=["start", "goal", "return", "ends"],
)
def test_a_boundary_condition_that_is_missed_is_said_with_the_share_of_its_size(asked, missed):
    certificate = judged(**asked)
    assert certificate.boundary_error == pytest.approx(missed, rel=1e-12)
    assert any("are missed by" in failure for failure in certificate.failures)


@pytest.mark.parametrize(
    ("efforts", "arcs"), [([5, 5, 0, 0, 0, 0, -5], True), ([5, 5, 5, 0, 0, 0, -5], False), ([5] * 7, False)]
)
def test_more_than_three_intervals_within_the_limits_are_an_arc(efforts, arcs):
    motion = OdeTrajectory(
        breaks_s=np.arange(8.0), state=np.zeros((2, 7, 1)), effort=np.array(efforts, dtype=float)[None, :, None], n_x=1
    )
    assert has_arcs(motion, np.array([[-5.0, 5.0]])) is arcs
