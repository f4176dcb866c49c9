"""Limits of every kind relaxed by a factor: the factor of a motion is the least with which it keeps them."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.limits.actuators import ControlLimit, MotorLimit, PowerLimit
from linkplan.planner.limits.efforts import EffortLimit, RobustLimit
from linkplan.planner.limits.joints import ClosureForceLimit, RangeLimit, SingularMarginLimit, SpeedLimit, TendonLimit
from linkplan.planner.limits.kinds import BETWEEN_NODES_FACTOR, factor_of, without
from linkplan.planner.limits.limit import Limit, limit_margin
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory
from tests.support.linkages import LINKAGES
from tests.support.plans import planned, problem_of
from tests.support.random_motions import motion_of

LINE = "motors.act_O={{stall_effort=60.0,no_load_speed_deg_s={}}}"
KNEE = {
    "speed": (SpeedLimit, "limits.speed_deg_s.C=150.0"),
    "speed one way": (SpeedLimit, "limits.speed_deg_s.O=[-20.0, 40.0]"),
    "power": (PowerLimit, "limits.power_w.act_O=300.0"),
    "power taken": (PowerLimit, "limits.power_w.act_O=[-100.0, 2000.0]"),
    "pin force": (ClosureForceLimit, "limits.closure_force.B=1.0"),
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
    return replace(problem, mechanism=narrow), motion


@pytest.mark.parametrize("end", ["low", "high"])
@pytest.mark.parametrize("kind", [TendonLimit, ControlLimit])
def test_the_factor_on_a_part_s_range_is_the_least_with_which_a_motion_keeps_it(kind, end):
    check(kind, *narrowed(kind, end))
