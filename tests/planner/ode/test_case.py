"""When a solution of a differential equation is exact: its state, its objective and its limits, each within its bound."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.ode.case import OdeCase
from linkplan.planner.ode.certificate import OBJECTIVE_ERROR_FACTOR

TOLERANCE = 1e-6


def exact(**changes: float) -> bool:
    """Return the answer for a certificate without errors but for the changes."""
    errors = {"integration_error": 0.0, "objective_error": 0.0, "overrun": 0.0, "integration_restarts": 0} | changes
    limits = {"path_overrun": np.zeros((0, 2)), "path_margin": np.zeros(0), "state_margin": np.ones(1)}
    rest = {"leaves_states": False, "growth": np.zeros(2), "touching": np.zeros(2, dtype=bool), "passed": True}
    case = SimpleNamespace(asked=SimpleNamespace(tolerance=TOLERANCE, path_limit=np.zeros((0, 2))))
    return OdeCase.error_report(case, SimpleNamespace(**errors, **limits, **rest)).exact


@pytest.mark.parametrize(
    ("name", "most"), [("integration_error", TOLERANCE), ("objective_error", OBJECTIVE_ERROR_FACTOR * TOLERANCE)]
)
def test_each_error_is_held_against_its_own_bound(name, most):
    assert exact()
    assert exact(**{name: 0.99 * most})
    assert not exact(**{name: 1.01 * most})


def test_an_overrun_limit_is_not_exact():
    assert not exact(overrun=1e-2)
