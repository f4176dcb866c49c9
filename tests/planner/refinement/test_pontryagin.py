"""Multipliers at limits: bang arcs of the wrong sign are found and released."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.plan.plan import Plan
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.constrained_arcs import arcs_against_their_limits, limits_bind, released
from linkplan.planner.refinement.decision import refine
from linkplan.planner.refinement.state import Refined
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.transcription.mesh import uniform
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_plan, body_problem
from tests.support.held_arcs import held, held_case


def test_the_bangs_of_a_least_time_are_at_the_right_limits():
    assert len(arcs_against_their_limits(held([4.0, -4.0], [0.5]).solution)) == 0
    assert len(arcs_against_their_limits(held([4.0, np.nan], [0.4]).solution)) == 0


def test_a_push_the_wrong_way_in_between_is_found():
    solution = held([4.0, -4.0, 4.0, -4.0], [0.41, 0.46, 0.56]).solution
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
    monkeypatch.setattr(Refined, "arcs_with_wrong_sign", property(lambda _: np.array([0.1])))
    plan = plan_motion(body_problem(HINGE, QUARTER_TURN + 'duration_s = "free"\n', "objective.minimize=time"))
    assert plan.certificate.passed
    assert (plan.status, plan.passed, plan.require()) == ("feasible", True, plan)
    assert "Pontryagin" in plan.message
    assert "-optimal motion" not in plan.message


def turned(*overrides: str) -> Plan:
    """Return the least effort of a quarter turn in a second: its speed is a parabola, 135 deg/s at the most."""
    plan = body_plan(HINGE, QUARTER_TURN + "duration_s = 1.0\n", *overrides)
    assert plan.status == "optimal", plan.message
    return plan


PEAK = 6 * HINGE_INERTIA * TURN  # of the least effort, at both ends


@pytest.mark.parametrize(
    ("limit", "binds"),
    [
        ("speed_deg_s.J=136.0", False),
        ("speed_deg_s.J=134.0", True),
        (f"effort.motor=[{-1.01 * PEAK}, {1.01 * PEAK}]", False),
        (f"effort.motor=[{-0.99 * PEAK}, {1.01 * PEAK}]", True),
    ],
)
def test_a_limit_binds_where_the_motion_without_it_is_beyond(limit, binds):
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n", f"limits.{limit}")
    case = case_of(problem)
    start = case.start_from(turned().trajectory)
    found = attempt(case, start, uniform(20), np.ones(1), "once")
    assert limits_bind(found.solution) == binds


def test_a_speed_limit_that_does_not_bind_costs_no_further_solve():
    """Without a kink the integration error tells all; where the limit binds, the objective is watched from mesh to mesh."""
    free, loose = turned(), turned("limits.speed_deg_s.J=200")
    assert len(loose.history) == len(free.history)
    assert loose.objective == pytest.approx(free.objective, rel=1e-9)
    assert len(turned("limits.speed_deg_s.J=120").history) > len(free.history)


WRONG = ([4.0, -4.0, 4.0, -4.0], [0.41, 0.46, 0.56])


def test_only_what_is_held_wrongly_is_let_go():
    solution = held(*WRONG).solution
    ends, fixed = released(solution)
    assert np.all(np.diff(ends) > 0)
    assert np.isnan(fixed.efforts).any()
    assert np.all(np.isnan(fixed.efforts) | np.isin(fixed.efforts, (4.0, -4.0)))
    assert (fixed.efforts[0, 0], fixed.efforts[-1, 0]) == (4.0, -4.0)


def test_right_arcs_are_left_as_they_are():
    assert released(held([4.0, -4.0], [0.5]).solution) is None


def test_an_answer_with_wrong_arcs_becomes_the_right_one():
    case, found = held_case(), held(*WRONG)
    least = 2 * np.sqrt(HINGE_INERTIA * TURN / 4.0)
    assert case.certify(found.motion).passed
    assert found.motion.duration_s > 1.005 * least
    right = refine(case, found)
    assert len(right.arcs_with_wrong_sign) == 0
    assert len(arcs_against_their_limits(found.solution)) > 0
    assert right.motion.duration_s == pytest.approx(least, rel=1e-8)
