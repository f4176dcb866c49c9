"""A sample of the random four-bar problems of `random_fourbars`: the phase plane decides what every answer must be."""

from functools import cache

import pytest

from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.bench.random_fourbars import judge
from tests.support.fourbar_problems import KINDS, Case, random_case

SEED = 1
# Of the first 140 problems: every kind, with and without an answer, straight and with turns, next to singular poses, with
# full turns, and the shortest and longest durations.
SAMPLE = (0, 2, 3, 5, 9, 15, 21, 31, 43, 44, 48, 63, 103, 111, 124)
# Intervals of the finest mesh that an unstable motion may be sought on.
FINEST = 300


@cache
def case_of(number: int) -> Case:
    """Return a problem of the sample, drawn once."""
    return random_case(SEED, number)


@pytest.mark.slow
def test_the_sample_has_every_kind_and_problems_of_both_answers():
    cases = [case_of(number) for number in SAMPLE]
    assert {case.kind for case in cases} == set(KINDS)
    assert {case.feasible for case in cases} == {True, False}


@pytest.mark.slow
@pytest.mark.parametrize("number", SAMPLE)
def test_a_random_problem_is_answered_as_the_phase_plane_says(number):
    case = case_of(number)
    plan = plan_motion(Problem.from_tables(f"{case.kind} {number}", case.tables))
    assert judge(case, plan) == "right", f"{case.kind}, {case.notes}: {plan.message}"


@pytest.mark.slow
def test_an_unstable_motion_is_not_sought_on_ever_finer_meshes():
    """Number 6 of seed 0: each mesh showed another motion, up to 3,128 intervals of degree 9, before the one that passes."""
    case = random_case(0, 6)
    plan = plan_motion(Problem.from_tables(case.kind, case.tables))
    assert judge(case, plan) == "right", plan.message
    assert max(step.intervals for step in plan.history) <= FINEST


@pytest.mark.slow
def test_what_was_answered_a_little_late_is_answered_as_the_phase_plane_says():
    """Number 37 of seed 7: a least time begun from a coarse mesh's."""
    case = random_case(7, 37)
    plan = plan_motion(Problem.from_tables(case.kind, case.tables))
    assert judge(case, plan) == "right", plan.message


@pytest.mark.slow
def test_refinement_goes_on_where_each_round_closes_in_on_a_limit():
    """Number 54 of seed 7 in least time: it failed with its speed limit overrun by a twenty-millionth after all rounds."""
    case = random_case(7, 54)
    tables = case.tables | {"motion": case.tables["motion"] | {"duration_s": "free"}, "objective": {"minimize": "time"}}
    plan = plan_motion(Problem.from_tables(case.kind, tables))
    assert plan.status == "optimal", plan.message
    assert plan.trajectory.duration_s == pytest.approx(case.shortest, rel=1e-6)
