"""Refinement: exact least times, tolerances, marked intervals, loosened limits."""

import json
from pathlib import Path

import numpy as np
import pytest

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.actions import Halve, ReadSwitches, Tighten
from linkplan.planner.refinement.case import attempt, certify_iterate
from linkplan.planner.refinement.marking import marked_for
from linkplan.planner.refinement.state import RefinementState
from linkplan.planner.search import finer_meshes
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.solving import first_mesh
from linkplan.planner.transcription.mesh import uniform
from tests.support.bodies import HINGE, PENDULUM, QUARTER_TURN, body_plan, body_problem
from tests.support.data import KNEE_TABLE
from tests.support.plans import optimal, planned
from tests.support.refinement_states import iterate
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


@pytest.mark.parametrize(("action", "intervals"), [(Halve(marked=np.array([True, False, True, False])), 6), (Tighten(), 4)])
def test_each_solve_of_a_refinement_counts_as_a_round(action, intervals):
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n")
    case = case_of(problem)
    first = attempt(case, first_guess(problem, problem.start_pose()), uniform(4), np.ones(1), "first solve")
    state = RefinementState(asked=case, case=case, iterate=certify_iterate(case, first), warm=False, rounds=5)
    after = action.apply(state)
    assert (after.rounds, after.iterate.n_intervals, after.ended) == (6, intervals, False)


# Six intervals: dynamics are not kept on the third, and the integrated state strays from there on.
GROWTH = np.array([0.0, 0.0, 5.0, 20.0, 20.0, 20.0])


@pytest.mark.parametrize(
    ("residual_share", "halved"),
    [
        ([0, 0, 17.0, 0, 0, 0], [2]),
        ([0, 0, 17.0, 0.1, 0, 0.1], [2, 3, 5]),  # others err themselves
        ([0, 0, 0.5, 0, 0, 0], [2, 3, 4, 5]),  # dynamics are kept: every growing error counts
    ],
)
def test_where_dynamics_are_not_kept_what_merely_carries_the_error_is_not_halved(residual_share, halved):
    at = iterate(residual_share=np.maximum(residual_share, 1e-13), growth=GROWTH, n=6)
    assert np.flatnonzero(marked_for(at, 1.0)).tolist() == halved


def test_where_a_growing_error_has_no_number_every_interval_is_halved():
    assert marked_for(iterate(growth=1e306, n=6), 1e4).all()


# A five-bar of ten tonnes with two motors, whose pin is not to rise above the higher of its ends by more than 23 mm. Drawn
# at random; rounded, its limit is touched at a node and nothing is tightened.
CRANE = Path(__file__).parents[2] / "data" / "crane-under-a-height.json"
# Its least effort [N2 m2 s] by a collocation of closed forms on 200 intervals of degree 4, all lengths free, that keeps the
# height at its nodes; limits that stayed tightened cost 4.6e-3.
BEST, NEAR = 8.391653e11, 1e-4
# How far from the limit the best motion may stay [m], of 25 m; it stayed 0.7 mm.
TOUCHED_M = 1e-4


def crane() -> Problem:
    tables = json.loads(CRANE.read_text(encoding="utf-8"))
    height = tables["limits"]["site"]["tip"]["z"]
    height[0] = -np.inf
    return Problem.from_tables("crane", tables)


@pytest.fixture(scope="module")
def plan() -> Plan:
    return plan_motion(crane()).require()


@pytest.mark.slow
def test_a_height_that_is_tightened_between_the_nodes_costs_no_more_than_it_must(plan):
    assert any("the same motion on a finer mesh" in step.what for step in plan.history)
    assert plan.objective == pytest.approx(BEST, rel=NEAR)


@pytest.mark.slow
def test_the_best_motion_under_a_height_touches_it(plan):
    (height,) = [margin for margin in plan.certificate.margins if margin.what == "site"]
    assert height.left < TOUCHED_M


def test_a_height_that_no_correction_satisfies_is_tightened_for_the_next_solve(monkeypatch):
    """Solved again with the height as asked, the motion would exceed it by as much every time."""
    monkeypatch.setattr(finer_meshes, "nearest_on", lambda *_, **__: None)
    plan = plan_motion(crane())
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(BEST, rel=1e-3)
