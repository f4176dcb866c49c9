"""Refinement: by default as far as a small mesh carries it, to a tolerance where one is asked for."""

import pytest

from tests.support.data import KNEE_TABLE
from tests.support.plans import optimal, planned
from tests.support.tolerances_planner import REFINED_DEG, REFINED_TIME


@pytest.mark.slow
def test_least_times_are_exact_to_a_billionth_and_their_state_to_a_millionth_of_a_degree():
    for name, key in (("knee-sprint", "shank_s"), ("knee-sprint-bare", "unloaded_s")):
        plan = optimal(name)
        exact = KNEE_TABLE["min_time_rest_to_rest"][key]
        assert plan.objective == pytest.approx(exact, rel=REFINED_TIME)
        assert plan.certificate.integration_error_deg < REFINED_DEG
        assert plan.intervals <= 100


@pytest.mark.slow
def test_a_tolerance_on_the_integrated_state_is_kept():
    asked_deg = 1e-8
    loose, strict = (planned("knee-sprint-bare", *more) for more in ((), (f"mesh.tolerance_deg={asked_deg}",)))
    assert loose.certificate.integration_error_deg > asked_deg
    assert strict.certificate.integration_error_deg <= asked_deg
    assert (strict.scheme, strict.intervals) != (loose.scheme, loose.intervals)


@pytest.mark.slow
def test_a_tolerance_that_is_out_of_reach_is_said():
    plan = planned("knee-reach", "mesh.scheme=radau-1", "mesh.tolerance_deg=1e-7", "mesh.intervals=4")
    assert plan.status == "failed"
    assert "the state integrated under the planned effort ends" in plan.message
