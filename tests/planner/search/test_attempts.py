"""What plans say of the solves behind them, on both sides of each share: changes on finer meshes, arcs, efforts carried."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.search import attempts
from linkplan.planner.search.attempts import certified, only_feasible, plan_from, unsound, without_solving
from linkplan.planner.search.solving import INTERVALS_PER_SWING


@dataclass(frozen=True)
class Said:
    """A plan that passes, as far as its words go."""

    optimal: bool
    message: str = "plan"
    passed: bool = True
    solved: object = None
    status: str = "optimal"
    problem: object = None


def finished(_problem, _motion, _certificate, _objective, words, *, optimal: bool = True) -> Said:
    return Said(optimal, words or "plan")


@dataclass(frozen=True)
class Solved:
    start: object = None


@pytest.mark.parametrize(
    ("moved", "against", "optimal", "words"),
    [
        (0.9e-4, [], True, ""),
        (1.1e-4, [], True, "; a finer mesh still changed its objective by 0.0001 of itself"),
        (0.049, [], True, "; a finer mesh still changed its objective by 0.05 of itself"),
        (0.051, [], False, "; a finer mesh still changed its objective by 0.05 of itself"),
        (0.0, [0.25, 0.5], False, "; the arc at t = 0.25 s would rather leave its limit"),
    ],
)
def test_a_plan_is_optimal_where_a_finer_mesh_hardly_changes_it_and_no_arc_leaves_its_limit(
    monkeypatch, moved, against, optimal, words
):
    solution = SimpleNamespace(transcribed=Solved(), objective=1.0, x="x")
    better = SimpleNamespace(solution=solution, motion=None, certificate=None, moved=moved, against=np.array(against))
    for name, value in {"surely_collides": None, "case_of": None, "refine": better, "own_objective": 1.0}.items():
        monkeypatch.setattr(attempts, name, lambda *_, value=value, **__: value)
    monkeypatch.setattr(attempts, "finished", finished)
    problem = SimpleNamespace(objective=SimpleNamespace(is_smoothed=False))
    monkeypatch.setattr(attempts, "of_several", lambda _: False)
    plan = certified(problem, SimpleNamespace(motion=None, solution=solution))
    assert plan.optimal is optimal
    assert plan.message.startswith(f"plan{words}") if words else plan.message == "plan"
    assert plan.solved == Solved("x")


@pytest.mark.parametrize(("residual", "best", "words"), [(0.9e-6, "the best", "the best"), (1.1e-6, "the best", "a plan")])
def test_a_motion_built_without_a_solve_is_the_best_where_it_carries_its_efforts_to_a_millionth(
    monkeypatch, residual, best, words
):
    monkeypatch.setattr(attempts, "certify", lambda *_: SimpleNamespace(dynamics_residual=5.0 * residual))
    monkeypatch.setattr(attempts, "finished", finished)
    motion = SimpleNamespace(effort=np.array([1.0, -5.0]))
    plan = without_solving(None, motion, 1.0, "a plan", best=best)
    assert (plan.message, plan.optimal) == (words, words == best)
    assert without_solving(None, motion, 1.0, "a plan").message == "a plan"


@pytest.mark.parametrize(("objective", "tried"), [(1.9, True), (2.0, False), (2.1, False)])
def test_only_solutions_that_are_worth_it_are_refined(monkeypatch, objective, tried):
    solved = SimpleNamespace(solution=SimpleNamespace(objective=objective))
    monkeypatch.setattr(attempts, "_solved", lambda *_: [solved])
    monkeypatch.setattr(attempts, "with_longer_durations", lambda _, found: (found, None))
    monkeypatch.setattr(attempts, "refined", lambda *_, **__: Said(True))
    monkeypatch.setattr(attempts, "replace", lambda budget, **_: budget)
    search = SimpleNamespace(within=lambda _: None, verdicts=[])
    assert (plan_from(search, None, "a start", None, worth=2.0) is not None) is tried


@pytest.mark.parametrize(
    ("held", "order", "first_after"), [(2.0019, [2.0019, 1.99], 1), (2.0021, [2.0021, 1.99], 2), (2.1, [1.99, 2.1], 2)]
)
def test_a_solution_with_held_switches_that_takes_the_exact_time_is_the_first_and_may_be_the_only(
    monkeypatch, held, order, first_after
):
    """The phase plane's time is 2 s to a thousandth: 1.99 s are less by a mesh's error."""
    intervals, solved = [], []

    def solve_from(*_, bang_efforts=None):
        solved.append(held if bang_efforts is not None else 1.99)
        return SimpleNamespace(solution=SimpleNamespace(objective=solved[-1]))

    monkeypatch.setattr(attempts, "first_mesh", lambda *_: (None, None))
    monkeypatch.setattr(attempts, "graded_mesh", lambda *given: (intervals.append(given[-1]), None))
    monkeypatch.setattr(attempts, "solve_from", solve_from)
    guess = SimpleNamespace(switch_times_s=np.ones(1), swings=3, bang_efforts=np.ones(2), duration_s=2.0)
    problem = SimpleNamespace(mesh=SimpleNamespace(intervals=9))
    found = attempts._solved(problem, guess, "start", SimpleNamespace(only_time_counts=True))
    first = next(found)
    assert len(solved) == first_after
    assert [one.solution.objective for one in (first, *found)] == order
    assert intervals == [3 * INTERVALS_PER_SWING]


def test_a_feasible_plan_says_why_it_is_not_the_best():
    plan = SimpleNamespace(certificate=SimpleNamespace(mendable=True))
    assert unsound(plan)
    assert not unsound(SimpleNamespace(certificate=None))
    objective = SimpleNamespace(name="effort")
    problem = SimpleNamespace(objective=objective)
    said = only_feasible(Said(True, "plan", problem=problem), "; longer ones may be better")
    assert (said.status, said.message) == ("feasible", "plan; longer ones may be better")


def tracked(own: float, n_intervals: int = 40, *, passed: bool = True):
    """Return a motion with an objective of its own, which is refined as it is."""
    program = SimpleNamespace(mesh=SimpleNamespace(n_intervals=n_intervals))
    transcribed = SimpleNamespace(units=SimpleNamespace(objective=2.0), program=program)
    return SimpleNamespace(
        own=own, certificate=SimpleNamespace(passed=passed), solution=SimpleNamespace(transcribed=transcribed)
    )


def unsmoothed(monkeypatch, first, lighter=(), finer=()):
    """Return the result for a first motion; `lighter` are motions with less smoothing, `finer` ones on finer meshes."""
    case, rest = SimpleNamespace(smoothing=1.0), iter(finer)
    monkeypatch.setattr(attempts, "objective_of", lambda at: at.own)
    monkeypatch.setattr(attempts, "refine", lambda _case, found, **_: found)
    monkeypatch.setattr(attempts, "followed", lambda at, *_: SimpleNamespace(stages=(at, *((case, x) for x in lighter))))
    monkeypatch.setattr(attempts, "_smoothed", lambda *_, **__: (case, next(rest)))
    return attempts._unsmoothed(case, first, False)


def test_smoothing_is_taken_out_down_to_the_least_weight_that_passes(monkeypatch):
    light, lightest = tracked(0.5, 160), tracked(0.4, 160, passed=False)
    assert unsmoothed(monkeypatch, tracked(1.0, 160), (light, lightest)) == (light, None)
    missed = tracked(1.0, 160, passed=False)
    assert unsmoothed(monkeypatch, missed, (lightest,)) == (missed, None)


@pytest.mark.parametrize(("share", "exact"), [(0.9e-10, True), (1.1e-10, False)])
def test_of_a_reference_that_is_followed_exactly_nothing_is_taken_out(monkeypatch, share, exact):
    first, light, fine = tracked(2.0 * share), tracked(1.5e-10 * 2.0), tracked(1.2e-10 * 2.0, 160)
    at, change = unsmoothed(monkeypatch, first, (light,), (fine,))
    assert at is (first if exact else fine)
    assert (change is None) is exact


@pytest.mark.parametrize(
    ("finer", "expected", "change"),
    [
        ([(0.45, 80), (0.449, 160)], 1, 0.45 / 0.449 - 1),  # up to 160 intervals
        ([(0.49996, 80), (0.4, 160)], 0, 0.5 / 0.49996 - 1),  # by less than a ten thousandth: fine enough
        ([(0.49994, 80), (0.4, 160)], 1, 0.49994 / 0.4 - 1),
        ([(0.51, 80)], None, None),  # a finer mesh that is worse
    ],
)
def test_the_mesh_is_halved_until_that_changes_the_objective_by_less_than_a_ten_thousandth(
    monkeypatch, finer, expected, change
):
    first, meshes = tracked(0.5), [tracked(own, n) for own, n in finer]
    at, found = unsmoothed(monkeypatch, first, (), meshes)
    assert at is (first if expected is None else meshes[expected])
    assert found == (None if change is None else pytest.approx(change))
