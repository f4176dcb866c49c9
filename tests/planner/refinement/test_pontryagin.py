"""Arcs that are held are asked whether they should be: the multipliers of right ones have the signs of their limits."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.planning import plan_motion
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.constrained_arcs import FixedArcs
from linkplan.planner.refinement.pontryagin import arcs_against_their_limits
from linkplan.planner.refinement.switch_search import mesh_with_switches
from linkplan.planner.search import attempts
from tests.support.bodies import HINGE, QUARTER_TURN, body_plan, body_problem

NAN = np.nan


def held(efforts: list[float], switches: list[float]):
    """Return a solution of the hinge's quarter turn in least time whose efforts are held at limits between switches."""
    free = QUARTER_TURN + 'duration_s = "free"\n'
    quick = body_plan(HINGE, free, "objective.minimize=time")
    problem = body_problem(HINGE, free, "objective.minimize=time")
    case, T = case_of(problem), quick.trajectory.duration_s
    mesh, durations = mesh_with_switches(np.array([0.0, T]), np.array(switches) * T, 20)
    fixed = FixedArcs(efforts=np.array(efforts)[:, None], paths=np.zeros((len(efforts), 0), dtype=int))
    found = attempt(
        case, case.start_from(quick.trajectory), mesh, durations, "held", [], lambda _: None, warm=True, fixed=fixed
    )
    assert found is not None
    return found.solution


def test_the_bangs_of_a_least_time_are_at_the_right_limits():
    assert len(arcs_against_their_limits(held([4.0, -4.0], [0.5]))) == 0
    assert len(arcs_against_their_limits(held([4.0, NAN], [0.4]))) == 0


def test_a_push_the_wrong_way_in_between_is_found():
    solution = held([4.0, -4.0, 4.0, -4.0], [0.41, 0.46, 0.56])
    against = arcs_against_their_limits(solution)
    assert len(against) > 0
    durations = solution.x[solution.transcribed.program.layout.durations()] * solution.transcribed.units.time_s
    ends = np.cumsum(durations)
    assert np.all((against > ends[0]) & (against < ends[2]))


@pytest.mark.slow
def test_an_answer_says_nothing_where_all_is_right():
    plan = body_plan(HINGE, QUARTER_TURN + 'duration_s = "free"\n', "objective.minimize=time")
    assert "Pontryagin" not in plan.message


@pytest.mark.slow
def test_a_plan_with_an_arc_that_would_rather_leave_its_limit_is_feasible_and_no_optimum(monkeypatch):
    monkeypatch.setattr(attempts, "arcs_against_their_limits", lambda _: np.array([0.1]))
    plan = plan_motion(body_problem(HINGE, QUARTER_TURN + 'duration_s = "free"\n', "objective.minimize=time"))
    assert plan.certificate.passed
    assert (plan.status, plan.passed, plan.require()) == ("feasible", True, plan)
    assert "Pontryagin" in plan.message
    assert "optimal motion" not in plan.message
