"""The search: which attempts it makes, their time limits, and its progress text. Solves are replaced: nothing is planned."""

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from linkplan.planner import planning
from linkplan.planner.planning import RUNGS, _first_starts, _with_the_best, _with_time_to_wait


@dataclass(frozen=True)
class Share:
    """A budget with its share of the time that is left."""

    share_of_time: float = 1.0


def search(*, starts: int = 1, dof: int = 1) -> SimpleNamespace:
    problem = SimpleNamespace(solver=SimpleNamespace(starts=starts), mechanism=SimpleNamespace(dof=dof))
    return SimpleNamespace(problem=problem)


@pytest.mark.parametrize(("starts", "made"), [(1, "first"), (2, "several")])
def test_several_starts_are_compared_where_they_are_asked_for(monkeypatch, starts, made):
    monkeypatch.setattr(planning.starts, "best_of_several", lambda *_: "several")
    monkeypatch.setattr(planning.starts, "from_first_starts", lambda *_: "first")
    assert _first_starts(search(starts=starts), Share()) == made


@pytest.mark.parametrize(("dof", "may_wait", "share"), [(1, True, 1.0), (2, True, 0.5), (2, False, 1.0), (1, False, 1.0)])
def test_a_start_has_half_of_the_time_where_several_freedoms_may_wait(monkeypatch, dof, may_wait, share):
    monkeypatch.setattr(planning.waiting, "may_wait", lambda _: may_wait)
    climb = _with_time_to_wait(lambda _, budget: budget.share_of_time)
    assert climb(search(dof=dof), Share()) == share


@pytest.mark.parametrize(("starts", "worth", "tried"), [(1, False, False), (1, True, True), (3, False, True)])
def test_first_starts_are_tried_where_one_is_worth_it_or_several_are_asked_for(monkeypatch, starts, worth, tried):
    monkeypatch.setattr(planning.starts, "one_start_is_worth_it", lambda _: worth)
    monkeypatch.setattr(planning, "of_several", lambda _: False)
    (first,) = (rung for rung in RUNGS if "multistart" in rung.name)
    assert first.tried(search(starts=starts)) == tried


def test_first_starts_are_left_to_the_search_for_several_motors(monkeypatch):
    monkeypatch.setattr(planning.starts, "one_start_is_worth_it", lambda _: True)
    monkeypatch.setattr(planning, "of_several", lambda _: True)
    (first,) = (rung for rung in RUNGS if "multistart" in rung.name)
    (several,) = (rung for rung in RUNGS if "several motors" in rung.name)
    assert (first.tried(search()), several.tried(search())) == (False, True)
    assert (first.tried(search(starts=3)), several.tried(search(starts=3))) == (True, False)


def test_progress_says_the_best_objective_that_has_passed_so_far():
    said, plans = [], []
    say = _with_the_best(said.append, plans)
    say("one")
    plans += [
        SimpleNamespace(passed=passed, objective=x) for passed, x in ((True, 3.0), (True, 2.0), (False, 1.0), (True, 2.5))
    ]
    say("two")
    assert said == ["one", "two; best certified 2"]
