"""The table of kinds of limits: program, certificate and diagnosis loop over it. A kind that is not in it limits nothing."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.limits.actuators import ControlLimit, MotorLimit, PowerLimit
from linkplan.planner.limits.efforts import EffortLimit, RobustLimit
from linkplan.planner.limits.joints import RangeLimit, SingularMarginLimit, SpeedLimit, TendonLimit
from linkplan.planner.limits.kinds import _ORDER, BETWEEN_NODES_FACTOR, KINDS, factor_of, without
from linkplan.planner.limits.limit import Limit, limit_margin
from linkplan.planner.limits.pins import ClosureForceLimit, PinForceLimit
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.problem.instant import Robust
from linkplan.planner.problem.keys import kinds
from linkplan.planner.problem.keys.limits import LIMIT_KEYS
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.trajectory import Trajectory
from tests.support.linkages import LINKAGES
from tests.support.plans import planned, problem_of
from tests.support.random_motions import motion_of
from tests.support.sources import SOURCES


def test_every_key_of_a_limit_has_one_kind_of_limit_that_imposes_it():
    classes = [kind for kind in Limit.__subclasses__() if kind.__module__ != __name__]
    names = {leaf.__name__ for kind in classes for leaf in kind.__subclasses__() or [kind]}
    assert {kind.__name__ for kind in KINDS} == {name for name in names if not name.startswith("_")}
    assert len({kind.key for kind in KINDS}) == len(KINDS)
    limited = {name for name, key in LIMIT_KEYS.items() if key.kind != kinds.Contacts} - {"reserve", "initial_effort"}
    assert limited <= {kind.key for kind in KINDS}


def test_rows_are_in_the_stated_order_and_rows_of_other_kinds_follow():
    assert [kind.key for kind in KINDS[: len(_ORDER)]] == [*_ORDER]


def test_a_limit_has_ten_members_at_most():
    members = {name for name in vars(Limit) if not name.startswith("_")} | set(Limit.__annotations__) - {"key"}
    assert members == {"item", "of", "facts", "rows", "bounds", "measured", "claims", "affine", "effort_bounds", "relaxed"}


def test_no_other_room_of_the_planner_names_a_kind_of_limit_or_reads_its_values():
    named = re.compile(rf"\b({'|'.join(kind.__name__ for kind in KINDS)})\b|\blimits\.(effort|speed|position|power)\b")
    others = [path for path in SOURCES if path.match("planner/*/*.py") and path.parent.name not in ("limits", "problem")]
    assert len(others) > 50
    assert [path.name for path in others if named.search(re.sub("#.*", "", path.read_text(encoding="utf-8")))] == []


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
    assert [one.reason for one in proof.of("undecided")] == ["not proved: the limit has no claim"]


def test_only_actuators_with_a_limit_have_one_at_the_corners():
    problem = planned("knee-reach").problem.varied(robust=Robust(payload_factor=(0.8, 1.2)))
    assert len(RobustLimit.of(problem)) == 2
    free = problem.varied(limits=replace(problem.limits, effort=np.array([[-np.inf, np.inf]])))
    assert RobustLimit.of(free) == []


LINE = "motors.act_O={{stall_effort=60.0,no_load_speed_deg_s={}}}"
KNEE = {
    "speed": (SpeedLimit, "limits.speed_deg_s.C=150.0"),
    "speed one way": (SpeedLimit, "limits.speed_deg_s.O=[-20.0, 40.0]"),
    "power": (PowerLimit, "limits.power_w.act_O=300.0"),
    "power taken": (PowerLimit, "limits.power_w.act_O=[-100.0, 2000.0]"),
    "closure force": (ClosureForceLimit, "limits.closure_force.B=1.0"),
    "pin force": (PinForceLimit, "limits.pin_force.O=100"),
    "singular margin": (SingularMarginLimit, "limits.singular_margin=0.6"),
    "torque-speed line": (MotorLimit, LINE.format(400.0)),
    "corners": (RobustLimit, "robust.payload_factor=[0.5, 3.0]"),
    "effort": (EffortLimit, "limits.effort.act_O=[-20.0, 20.0]"),
    "range": (RangeLimit, "limits.range_deg.C=[-30.0, 30.0]"),
}


def kept_from(kind: type[Limit], problem: Problem, motion: Trajectory) -> float:
    """Return the factor next to 1 with which a motion keeps its limits of a kind, by bisection on `relaxed`."""

    def is_kept(factor: float) -> bool:
        relaxed = kind.relaxed(problem, factor)
        samples = samples_of(relaxed, motion)
        return all(limit_margin(limit, samples).left >= 0 for limit in kind.of(relaxed))

    kept, overrun = (1e-2 if kind is SingularMarginLimit else 1e4), 1.0
    assert is_kept(kept)
    assert not is_kept(overrun)
    for _ in range(40):
        middle = float(np.sqrt(kept * overrun))
        kept, overrun = (middle, overrun) if is_kept(middle) else (kept, middle)
    return kept


def check(kind: type[Limit], problem: Problem, motion: Trajectory) -> None:
    """Check that a motion keeps limits relaxed by `factor`, and that less would do only by the allowance between nodes."""
    factor, least = factor_of(kind, problem, motion), kept_from(kind, problem, motion)
    assert factor == pytest.approx(least, rel=1.5 * (BETWEEN_NODES_FACTOR - 1))
    assert abs(np.log(factor)) >= abs(np.log(least))
    assert factor_of(kind, kind.relaxed(problem, factor), motion) is None
    assert factor_of(kind, without(kind, problem), motion) is None


@pytest.mark.parametrize("case", KNEE)
def test_the_factor_of_a_motion_is_the_least_with_which_it_keeps_limits_that_it_overruns(case):
    kind, override = KNEE[case]
    check(kind, problem_of("knee-reach", override), planned("knee-reach").trajectory)


def narrowed(kind: type[Limit], end: str) -> tuple[Problem, Trajectory]:
    """Return a motion of a gripper that overruns the low or high end of its tendon's length, or of its servo's ctrl."""
    text = LINKAGES["gripper"].replace('<fixed name="split">', '<fixed name="split" limited="true" range="-2 2">')
    problem, motion = motion_of(load_mechanism(text), np.random.default_rng(0), size=0.1)
    samples, mechanism = samples_of(problem, motion), problem.mechanism
    (limit,) = kind.of(problem)
    values = limit.measured(samples).values
    middle, span = float(values.mean()), float(np.ptp(values))
    low, high = (middle, middle + 3 * span) if end == "low" else (middle - 3 * span, middle)
    if kind is TendonLimit:
        narrow = replace(mechanism, tendons=(replace(mechanism.tendons[0], low=low, high=high),))
    else:
        actuators = list(mechanism.actuators)
        actuators[limit.item] = replace(actuators[limit.item], control_lower=low, control_upper=high)
        narrow = replace(mechanism, actuators=tuple(actuators))
    return problem.varied(mechanism=narrow), motion


@pytest.mark.parametrize("end", ["low", "high"])
@pytest.mark.parametrize("kind", [TendonLimit, ControlLimit])
def test_the_factor_on_a_part_s_range_is_the_least_with_which_a_motion_keeps_it(kind, end):
    check(kind, *narrowed(kind, end))
