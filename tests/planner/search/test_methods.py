"""The methods of a search: in order, each where its condition holds and within its budget."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.deadline import Deadline, OutOfTimeError, processor_time_s
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.plan.verdict import failed
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.decision import refine
from linkplan.planner.refinement.history import recording
from linkplan.planner.search import attempts, least_limit
from linkplan.planner.search.methods import FULL_BUDGET, Budget, Search, SearchMethod, run_search
from linkplan.planner.search.planning import DIAGNOSES, SEARCH_METHODS, plan_motion, search_for
from linkplan.planner.search.replan import Replanner
from linkplan.planner.search.solving import first_mesh
from linkplan.planner.search.starts import from_first_starts
from linkplan.planner.solvers.solve import OF_TIME, OUT_OF_TIME
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_problem

# Less torque than any reach of the knee with the shank in this time needs.
TOO_WEAK = ["limits.effort={ act_O = [-20.0, 20.0] }"]


def timed_search(problem, methods=SEARCH_METHODS, seconds: float = 600.0, clock=processor_time_s) -> Search:
    deadline = Deadline(clock=clock).within(seconds)
    timed = problem.varied(solver=problem.solver.replace(deadline=deadline))
    return search_for(timed, methods)


def noting(name: str, called: list[str], plan=None, **conditions) -> SearchMethod:
    def note(search, budget):
        called.append(name)
        return plan(search, budget) if callable(plan) else plan

    return SearchMethod(name=name, run=note, budget=Budget(), **conditions)


def test_a_rung_is_one_function_and_one_row():
    called = []
    plan = plan_motion(load_problem("knee-reach"), methods=(noting("mine", called, from_first_starts), *SEARCH_METHODS))
    assert called == ["mine"]
    assert plan.status == "optimal"
    assert [step.what for step in plan.history] == ["first solve"]  # no other method was climbed after it


def test_progress_after_a_plan_that_passes_ends_in_its_objective():
    told = []
    again = SearchMethod(name="again", run=from_first_starts, budget=Budget())
    plan = plan_motion(load_problem("knee-reach"), told.append, methods=(again, again))
    assert "best certified" not in told[0]
    assert float(told[1].rpartition("; best certified ")[2]) == pytest.approx(plan.objective, rel=1e-5)


def test_methods_are_tried_in_order_and_only_where_their_conditions_hold():
    called = []
    methods = [noting("first", called), noting("never", called, tried=lambda search: search.solved), noting("last", called)]
    assert run_search(timed_search(load_problem("knee-reach"), methods)) is None
    assert called == ["first", "last"]


def test_a_verdict_ends_the_search():
    called = []
    problem = load_problem("knee-reach")
    verdict = replace(plan_motion(problem), verdict=failed("that is that"))

    def judge(search, budget):
        del budget
        search.verdicts.append(verdict)

    plan = run_search(timed_search(problem, [noting("judge", called, judge), noting("after it", called)]))
    assert called == ["judge"]
    assert plan.message == verdict.message


def run_beyond_its_time(problem, plan=None):
    """Return the plan, the search, and the methods called, of which the first takes 11 s of 10 and returns `plan`."""
    called, now = [], [100.0]

    def slow(search, budget):
        del search, budget
        now[0] += 11.0
        return plan

    methods = [noting("slow", called, slow), noting("after it", called)]
    search = timed_search(problem, methods, seconds=10.0, clock=lambda: now[0])
    return run_search(search), search, called


def test_the_time_is_that_of_the_whole_plan():
    plan, search, called = run_beyond_its_time(load_problem("knee-reach"))
    assert plan is None
    assert called == ["slow"]
    assert search.stopped == OUT_OF_TIME


def test_a_best_plan_that_the_time_cut_short_is_returned_and_says_so():
    problem = load_problem("knee-reach")
    plan, _, _ = run_beyond_its_time(problem, plan_motion(problem))
    assert plan.status == "optimal"
    assert plan.message.endswith("; the best found within its 600 s (solver.max_time_s)")


def test_no_program_is_built_after_the_deadline():
    search = timed_search(load_problem("knee-reach"), seconds=-1.0)
    mesh, durations = first_mesh(search.problem, search.smooth)
    late = search.within(Budget())
    with recording() as steps:
        assert attempt(case_of(late), search.smooth, mesh, durations, "late") is None
    assert steps == []


def test_a_certificate_ends_with_the_plans_time_and_says_so():
    plan = plan_motion(load_problem("knee-reach"))
    assert plan.certificate.passed
    past = plan.problem.solver.replace(deadline=Deadline().within(-0.5 * plan.problem.solver.max_time_s))
    judged = certify(plan.problem.varied(solver=past), plan.trajectory)
    assert not judged.passed
    assert any("ran out of the plan's time, 600 s (solver.max_time_s)" in said for said in judged.failures)


@pytest.mark.parametrize(("share", "left"), [(1.0, 8.0), (0.25, 2.0)])
def test_a_budget_shortens_the_time_and_the_iterations_of_its_solves(share, left):
    search = timed_search(load_problem("knee-reach"), seconds=8.0, clock=lambda: 50.0)
    within = search.within(Budget(iterations=7, share_of_time=share)).solver
    assert within.deadline.at_s == pytest.approx(50.0 + left)
    assert within.max_iterations == 7
    fewer = search.problem.varied(solver=search.problem.solver.replace(max_iterations=3))
    assert replace(search, problem=fewer).within(Budget(iterations=7)).solver.max_iterations == 3


def test_diagnoses_never_return_a_motion():
    search = search_for(load_problem("knee-reach", TOO_WEAK))
    plans = [plan for diagnosis in DIAGNOSES if (plan := diagnosis(search)) is not None]
    assert len(plans) >= 2  # the efforts, and the last word
    assert all(plan.trajectory is None and plan.status != "optimal" for plan in plans)


@pytest.mark.parametrize(("change", "status"), [(5e-5, "optimal"), (5e-4, "optimal"), (0.04, "optimal"), (0.06, "feasible")])
def test_an_objective_that_moves_by_a_ten_thousandth_is_said_and_by_a_twentieth_not_optimal(monkeypatch, change, status):
    found = refine
    monkeypatch.setattr(attempts, "refine", lambda *given, **how: replace(found(*given, **how), moved=change))
    plan = plan_motion(load_problem("knee-reach"))
    assert plan.status == status
    assert (f"its objective still changed by {100 * change:.1g} %" in plan.message) is (change > 1e-4)


MANY = ["solver.starts=1000"]
LEGS = ["limits.power_w={ act_O = [-300.0, 300.0] }"]
# Looks at the clock after which there is no time: in the first loops, in starts, in solves, in diagnosis.
LOOKS = (1, 10, 100, 1600)


class Clock:
    """A clock that goes on by a second each time that it is read."""

    reads = 0

    def __call__(self) -> float:
        self.reads += 1
        return float(self.reads)


def timed(problem, looks: float):
    """Return a problem that has time for so many looks at its clock, and the clock."""
    clock = Clock()
    return problem.varied(solver=problem.solver.replace(max_time_s=looks, deadline=Deadline(clock=clock))), clock


def test_a_path_is_not_followed_beyond_its_deadline():
    mechanism = load_problem("knee-reach").mechanism
    path = np.radians(np.linspace(-49.0, 56.0, 50))[:, None]
    assert len(follow(mechanism, path)) == 50
    with pytest.raises(OutOfTimeError):
        follow(mechanism, path, deadline=Deadline().within(-1.0))


@pytest.mark.parametrize("looks", LOOKS)
@pytest.mark.parametrize(
    ("name", "overrides"),
    [("knee-sprint", []), ("knee-reach", TOO_WEAK), ("knee-sprint", LEGS), ("knee-reach", MANY), ("knee-sine", [])],
    ids=["least time", "too weak", "along a power limit", "many starts", "prescribed"],
)
def test_wherever_the_time_ends_there_is_a_plan_that_says_so(name, overrides, looks):
    problem, clock = timed(load_problem(name, overrides), looks)
    plan = plan_motion(problem)
    assert plan.status in ("optimal", "feasible", "infeasible", "failed")
    assert plan.problem is problem
    if plan.status == "failed":
        assert OF_TIME in plan.message
    # What is left of the plan then is no loop: some looks on the way out.
    assert clock.reads < 3 * looks + 300


def test_a_certified_motion_is_kept_when_a_later_method_runs_out_of_time():
    found = plan_motion(load_problem("knee-reach"))

    def late(*_):
        raise OutOfTimeError("late")

    methods = [
        SearchMethod(name="finds", run=lambda *_: found, budget=FULL_BUDGET),
        SearchMethod(name="late", run=late, budget=FULL_BUDGET),
    ]
    plan = plan_motion(load_problem("knee-reach"), methods=methods)
    assert plan.status == "optimal"
    assert plan.trajectory is found.trajectory


def test_starts_that_were_solved_are_judged_when_the_time_for_further_ones_is_over():
    problem, _ = timed(load_problem("knee-reach", MANY), 1000)
    plan = plan_motion(problem)
    assert plan.passed
    assert 1 <= plan.details["starts_solved"] < 100
    assert OF_TIME in plan.message


def test_a_planner_gives_a_warm_solve_and_a_plan_from_the_beginning_one_budget():
    planner, problem = Replanner(), load_problem("knee-reach")
    planner.plan(problem).require()
    late, clock = timed(problem, 1)
    late = late.varied(motion=replace(late.motion, goal=np.radians([40.0])))
    assert not planner.plan(late).passed
    assert clock.reads < 30
    assert planner.plan(problem).passed


def test_the_least_factor_of_a_pure_inertia_is_exact_once_its_switch_is_known():
    """A quarter turn in T seconds needs 4 I b / T^2 N.m, of the 4 that it has; known from another start it is no other."""
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 0.5\n")
    guess = first_guess(problem, problem.start_pose())
    mesh, durations = first_mesh(problem, guess)
    found = least_limit.least_limit(problem, guess, mesh, durations)
    assert found.factor == pytest.approx(4 * HINGE_INERTIA * TURN / 0.5**2 / 4.0, rel=1e-7)
    assert found.first == pytest.approx(found.factor, rel=1e-2)
    assert found.durations.sum() == pytest.approx(0.5)
    for factor, same in ((1 + 0.9e-7, True), (1 - 0.9e-7, True), (1 + 1.2e-7, False), (1 - 1.2e-7, False)):
        again = least_limit.least_limit(problem, guess, mesh, durations, known=factor * found.first)
        assert (again is None) is same, factor


def test_a_feasible_plan_that_costs_less_than_a_locally_optimal_one_is_the_answer(hinge_plan):
    def costing(objective: float, status: str):
        return replace(hinge_plan, objective=objective, verdict=hinge_plan.verdict.replace(kind=status))

    search = search_for(hinge_plan.problem)
    search.plans.extend([costing(3.0, "optimal"), costing(2.0, "feasible")])
    assert search.best.objective == 2.0
    search.plans.append(costing(2.0, "optimal"))
    search.plans.append(costing(2.0 + 1e-12, "feasible"))
    assert search.best.status == "optimal"


@pytest.fixture(scope="module")
def hinge_plan():
    return plan_motion(body_problem(HINGE, QUARTER_TURN + 'duration_s = "free"\n', "objective.minimize=time"))
