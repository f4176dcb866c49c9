"""When a solution of a differential equation is exact: its state, its objective and its limits, each within its bound."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.ode.case import OdeCase
from linkplan.planner.ode.certificate import OBJECTIVE_ERROR_FACTOR
from linkplan.planner.ode.formulation import straight_guess, units_of
from linkplan.planner.ode.problem import OdeProblem
from tests.support.ode import FREE_EFFORT, FREE_STATE, double_integrator, squared_effort

TOLERANCE = 1e-6


def report(path_limit: object = (), **changes):
    """Return the report on a certificate without errors but for the changes."""
    errors = {"integration_error": 0.0, "objective_error": 0.0, "overrun": 0.0, "integration_restarts": 0}
    limits = {"path_overrun": np.zeros((0, 2)), "path_margin": np.zeros(0), "state_margin": np.ones(1)}
    rest = {"leaves_states": False, "growth": np.zeros(2), "touching": np.zeros(2, dtype=bool), "passed": True}
    case = SimpleNamespace(asked=SimpleNamespace(tolerance=TOLERANCE, path_limit=np.reshape(path_limit, (-1, 2))))
    return OdeCase.error_report(case, SimpleNamespace(**errors | limits | rest | changes))


def exact(**changes: float) -> bool:
    """Return the answer for a certificate without errors but for the changes."""
    return report(**changes).exact


@pytest.mark.parametrize(
    ("name", "most"), [("integration_error", TOLERANCE), ("objective_error", OBJECTIVE_ERROR_FACTOR * TOLERANCE)]
)
def test_each_error_is_held_against_its_own_bound(name, most):
    assert exact()
    assert exact(**{name: 0.99 * most})
    assert not exact(**{name: 1.01 * most})


def test_an_overrun_limit_is_not_exact():
    assert not exact(overrun=1e-2)


def test_an_overrun_is_a_share_of_a_limit_s_larger_bound_and_the_largest_of_all_quantities():
    overrun = np.array([[0.2, 0.0, 0.1], [0.0, 0.3, 0.9]])
    found = report([[-1.0, 4.0], [-np.inf, 3.0]], path_overrun=overrun, growth=np.zeros(3))
    assert found.overrun == pytest.approx([0.05, 0.1, 0.3])


@pytest.mark.parametrize(
    ("path", "state", "overruns"),
    [([], [1.0], False), ([1.0, -1e-6], [1.0], True), ([0.5], [2.0, -1e-6], True), ([-5e-9], [-5e-9], False)],
)
def test_limits_are_overrun_by_more_than_rounding_if_one_margin_is(path, state, overruns):
    assert report(path_margin=np.array(path), state_margin=np.array(state)).overruns == overruns


@pytest.mark.parametrize(
    ("restarts", "error", "unstable", "unseen"),
    [(0, 0.0, False, False), (2, 0.5, True, False), (2, 2.0, True, True), (0, 2.0, False, False)],
)
def test_an_unstable_motion_whose_integration_ends_further_away_than_its_size_is_not_resolved(
    restarts, error, unstable, unseen
):
    found = report(integration_restarts=restarts, integration_error=error)
    assert (found.unstable, found.unseen) == (unstable, unseen)


# Tightened limits.


def tightened(state_margin: list[float], path_overrun: np.ndarray, path_limit: list) -> OdeCase:
    """Return the case after a motion of three intervals from 1 s to 3 s."""
    problem = OdeProblem(
        name="two", rate=double_integrator, start=[0, 0], goal=[1, 0], effort_limit=FREE_EFFORT, duration_s=2.0,
        state_limit=[[-1.0, 2.0], FREE_STATE], running_cost=squared_effort,
        path=lambda x, u, p, t: [x[0] + k for k in range(len(path_limit))], path_limit=path_limit,  # noqa: ARG005
    )  # fmt: skip
    units = units_of(problem, straight_guess(problem))
    motion = SimpleNamespace(breaks_s=np.array([1.0, 1.5, 2.5, 3.0]), duration_s=2.0)
    certificate = SimpleNamespace(path_overrun=path_overrun, state_margin=np.array(state_margin))
    return OdeCase(problem, problem, units).tightened(certificate, motion)


def test_the_limits_of_a_state_move_inwards_by_a_little_more_than_they_were_overrun():
    limit = tightened([-0.1, np.inf], np.zeros((0, 3)), []).problem.state_limit
    assert -1.0 + 0.1 < limit[0, 0] < -1.0 + 0.12
    assert 2.0 - 0.12 < limit[0, 1] < 2.0 - 0.1
    assert limit[1].tolist() == FREE_STATE
    assert tightened([0.1, np.inf], np.zeros((0, 3)), []).problem.state_limit[0].tolist() == [-1.0, 2.0]


@pytest.mark.parametrize(
    ("limit", "size", "upper"), [([-1.0, 4.0], 4.0, True), ([-2.0, np.inf], 2.0, False), ([-3.0, 0.0], 3.0, False)]
)
def test_a_path_limit_is_tightened_where_and_by_more_than_it_was_overrun_as_a_share_of_itself(limit, size, upper):
    case = tightened([1.0, np.inf], np.array([[0.0, 0.2, 0.0], [0.0, 0.0, 0.0]]), [limit, limit])
    (one,) = case.tightenings  # the second quantity kept its limits
    assert (one.item, one.upper) == (0, upper)
    assert one.breaks == pytest.approx([0.0, 0.25, 0.75, 1.0])
    assert one.share[[0, 2]].tolist() == [0.0, 0.0]
    assert 0.2 / size < one.share[1] < 1.5 * 0.2 / size
