"""What a refinement knows of the objective's change from mesh to mesh."""

from dataclasses import replace

import pytest

from linkplan.planner.refinement.state import observed
from tests.support.refinement_states import iterate, state


@pytest.mark.parametrize(
    ("rounds", "error", "falls"), [(3, 0.4e-3, True), (3, 0.6e-3, False), (3, 2e-3, False), (1, 2e-3, True)]
)
def test_an_error_falls_if_a_finer_mesh_leaves_at_most_half_of_it(rounds, error, falls):
    """The first mesh, whose error is 1e-3, is too coarse to compare with."""
    before, at = state(iterate(), rounds=rounds), iterate()
    at = replace(at, report=replace(at.report, integration_error_deg=error))
    assert observed(before, at).error_falls == falls


@pytest.mark.parametrize(("objective", "better"), [(0.9, True), (1.1, False)])
def test_of_motions_within_the_limits_as_asked_the_best_is_kept(objective, better):
    before = state(iterate(), loosenings_without_gain=1)
    before, at = replace(before, loosened=before.iterate), iterate(objective=objective)
    after = observed(before, at)
    assert (after.best is at) == better
    assert after.loosenings_without_gain == (0 if better else 1)
