"""When efforts constant over intervals may mend a motion that overruns limits between its nodes."""

from types import SimpleNamespace

import pytest

from linkplan.planner.search.attempts import constant_efforts_would_do
from tests.support.plans import problem_of

OVERRUN = SimpleNamespace(certificate=SimpleNamespace(margins=[SimpleNamespace(kept=True), SimpleNamespace(kept=False)]))


@pytest.mark.parametrize(
    ("settings", "would_do"),
    [
        (["limits.power_w.act_O=600"], True),
        (["limits.power_w.act_O=600", "limits.effort_rate.act_O=1e5"], False),  # it has no rate: a refusal in mid-search
        (["objective.minimize=effort_rate"], False),
        (["mesh.effort=linear"], False),
    ],
)
def test_only_polynomial_efforts_that_may_jump_are_made_constant(settings, would_do):
    assert constant_efforts_would_do(problem_of("knee-reach", *settings), OVERRUN) is would_do
