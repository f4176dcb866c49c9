"""Refinement: by default as far as a small mesh carries it, to a tolerance where one is asked for."""

import pytest

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.refinement.actions import ReadSwitches
from linkplan.planner.refinement.case import attempt, certify_iterate
from linkplan.planner.refinement.state import RefinementState
from linkplan.planner.search.solving import first_mesh
from tests.support.bodies import HINGE, PENDULUM, body_plan, body_problem
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
    asked_deg = 1e-9
    loose, strict = (planned("knee-sprint", *more) for more in ((), (f"mesh.tolerance_deg={asked_deg}",)))
    assert loose.certificate.integration_error_deg > asked_deg
    assert strict.certificate.integration_error_deg <= asked_deg
    assert (strict.scheme, strict.intervals) != (loose.scheme, loose.intervals)


@pytest.mark.slow
def test_a_tolerance_that_is_out_of_reach_is_said():
    # In a longer time the smooth path itself satisfies limits and tolerance, and least effort has legs of the phase plane.
    mesh = ["mesh.scheme=radau-1", "mesh.tolerance_deg=1e-7", "mesh.intervals=2"]
    reach = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 60.0 }\nduration_s = 0.5\n'
    plan = body_plan(PENDULUM.format(limit=20), reach, *mesh, "objective.minimize=work")
    assert plan.status == "failed"
    assert "the state integrated under the planned effort ends" in plan.message


def test_a_reading_of_switches_counts_as_a_round_and_holds_what_it_read():
    """A pure inertia's least time: full effort, one switch in the middle, full effort against it."""
    reach = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 90.0 }\nduration_s = "free"\n'
    problem = body_problem(HINGE, reach, "objective.minimize=time")
    case, guess = case_of(problem), first_guess(problem, problem.start_pose())
    first = attempt(case, guess, *first_mesh(problem, guess), "first solve")
    state = RefinementState(asked=case, case=case, iterate=certify_iterate(case, first), warm=False, rounds=5, readings=1)
    after = ReadSwitches().apply(state)
    assert (after.rounds, after.readings, after.read_in) == (6, 2, 5)
    assert after.iterate.found.fixed.efforts[:, 0].tolist() == problem.limits.effort[0, ::-1].tolist()
    assert after.iterate.passed
