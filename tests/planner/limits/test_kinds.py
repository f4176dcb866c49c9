"""The table of kinds of limits: program, certificate and diagnosis loop over it. A kind that is not in it limits nothing."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from linkplan.planner.limits.efforts import EffortLimit, RobustLimit
from linkplan.planner.limits.joints import RangeLimit, SpeedLimit
from linkplan.planner.limits.kinds import KINDS, RELAXED
from linkplan.planner.limits.limit import Limit
from linkplan.planner.problem.instant import Robust
from linkplan.planner.proof.prove import prove
from tests.support.plans import planned


def test_every_kind_of_limit_is_in_the_table():
    assert {kind.__name__ for kind in Limit.__subclasses__() if kind.__module__ != __name__} == {
        kind.__name__ for kind in KINDS
    }


def test_the_diagnosis_may_take_every_kind_away_but_ranges_and_efforts_which_it_takes_last():
    assert set(RELAXED) == set(KINDS) - {RangeLimit, EffortLimit}
    assert len(RELAXED) == len(KINDS) - 2


def test_no_two_kinds_have_one_key():
    assert len({kind.key for kind in KINDS}) == len(KINDS)


def test_a_limit_has_eight_members_at_most():
    members = {name for name in vars(Limit) if not name.startswith("_")} | set(Limit.__annotations__) - {"key"}
    assert members == {"item", "of", "facts", "rows", "bounds", "measured", "claims", "relaxed"}


def test_a_limit_without_a_claim_is_refused():
    @dataclass(frozen=True, slots=True)
    class Unclaimed(Limit):
        key = "unclaimed"
        facts = SpeedLimit.facts
        item: int
        of, bounds, measured, relaxed = SpeedLimit.of, SpeedLimit.bounds, SpeedLimit.measured, SpeedLimit.relaxed

    with pytest.raises(TypeError, match="claims"):
        Unclaimed(0)


def test_a_plan_with_a_limit_that_claims_nothing_is_not_proved(monkeypatch):
    plan = planned("knee-reach")
    assert prove(plan.problem, plan.trajectory, existence=False).complete
    monkeypatch.setattr(EffortLimit, "claims", lambda *_: iter(()))
    proof = prove(plan.problem, plan.trajectory, existence=False)
    assert not proof.complete
    assert [one.reason for one in proof.of("undecided")] == ["not proved: the limit claims nothing"]


def test_only_actuators_with_a_limit_have_one_at_the_corners():
    problem = replace(planned("knee-reach").problem, robust=Robust(payload_factor=(0.8, 1.2)))
    assert len(RobustLimit.of(problem)) == 2
    free = replace(problem, limits=replace(problem.limits, effort=np.array([[-np.inf, np.inf]])))
    assert RobustLimit.of(free) == []
