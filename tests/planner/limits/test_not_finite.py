"""A cost, a limit or a figure that is not a finite number makes a plan fail with a sentence that names it."""

import casadi as ca
import numpy as np
import pytest

import linkplan
from linkplan import ExtraCost, ExtraLimit, Problem
from linkplan.models.errors import PlanError, ProblemError
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.closed_chain.case import finished

ARM = """<mujoco><worldbody><body><joint name="J" axis="0 1 0" range="-170 170"/>
<geom size=".05" pos="0 0 -.3" mass="1"/></body></worldbody>
<actuator><motor name="M" joint="J" ctrlrange="-10 10"/></actuator></mujoco>"""
REACH = {"start_deg": {"J": 0}, "goal_deg": {"J": 60}, "duration_s": 1.0}
SINE = {"amplitude_deg": {"J": 20.0}, "frequency_hz": 0.5}


def angle(at):
    return at.position_rad["J"]


EVERYWHERE = {
    "sqrt of a negative number": lambda at: ca.sqrt(-1 - angle(at) ** 2),
    "log of a negative number": lambda at: ca.log(-1 - at.effort["M"] ** 2),
    "an overflow": lambda at: 1e200 * (1e200 + angle(at) ** 2),
}
SOMEWHERE = {
    "half of the way": lambda at: ca.if_else(angle(at) > 0.5, np.inf, angle(at) ** 2),
    "beyond a domain": lambda at: ca.sqrt(0.5 - angle(at)),
    "at the start": lambda at: ca.log(angle(at)),
}


@pytest.fixture(scope="module")
def arm():
    return linkplan.load_mechanism(ARM)


@pytest.fixture(scope="module")
def plain(arm):
    return linkplan.plan(Problem.reach(arm, **REACH)).require()


@pytest.mark.parametrize("alone", [True, False])
@pytest.mark.parametrize("expression", [*EVERYWHERE.values(), *SOMEWHERE.values()])
def test_a_plan_whose_cost_is_not_finite_fails_and_names_the_cost(arm, expression, alone):
    cost = ExtraCost(name="my cost", expression=expression, weight=1e-3)
    asked = {"minimize": {}} if alone else {}
    plan = linkplan.plan(Problem.reach(arm, **REACH, **asked, extra_costs=[cost]))
    assert plan.status == "failed"
    assert plan.objective is None
    assert "the extra cost 'my cost' is not finite (" in plan.message
    with pytest.raises(PlanError, match="my cost"):
        plan.require()


@pytest.mark.parametrize("expression", EVERYWHERE.values())
def test_a_plan_whose_limit_is_not_finite_fails_and_names_the_limit(arm, expression):
    limit = ExtraLimit(name="my limit", expression=expression, upper=100.0)
    plan = linkplan.plan(Problem.reach(arm, **REACH, extra_limits=[limit]))
    assert not plan.passed
    assert "the extra limit 'my limit' is " in plan.message


@pytest.mark.parametrize("expression", SOMEWHERE.values(), ids=SOMEWHERE)
@pytest.mark.parametrize("kind", [ExtraCost, ExtraLimit])
def test_a_certificate_names_what_is_not_finite_on_part_of_a_motion(arm, plain, expression, kind):
    bounds = {"lower": -100.0} if kind is ExtraLimit else {}
    extra = kind(name="mine", expression=expression, **bounds)
    problem = Problem.reach(arm, **REACH, **{f"extra_{extra.kind}s": [extra]})
    certificate = certify(problem, plain.trajectory)
    assert not certificate.passed
    assert f"the extra {extra.kind} 'mine' is not finite (" in "; ".join(certificate.failures)


def test_a_periodic_motion_whose_cost_is_not_finite_fails(arm):
    cost = ExtraCost(name="my cost", expression=EVERYWHERE["sqrt of a negative number"])
    plan = linkplan.plan(Problem.periodic(arm, reference=SINE, extra_costs=[cost]))
    assert plan.status == "failed"
    assert "my cost" in plan.message


@pytest.mark.parametrize(("objective", "said"), [(np.nan, "NaN"), (np.inf, "inf"), (-np.inf, "-inf")])
def test_a_motion_whose_objective_is_not_finite_fails_and_names_it(plain, objective, said):
    plan = finished(plain.problem, plain.trajectory, plain.certificate, objective, None)
    assert plan.status == "failed"
    assert plan.message == f"failed: the objective (effort) is not finite ({said})"


@pytest.mark.parametrize("kind", [ExtraCost, ExtraLimit])
def test_nan_as_a_constant_of_an_expression_is_refused(arm, kind):
    """Between two samples no certificate would see it."""
    bounds = {"upper": 100.0} if kind is ExtraLimit else {}
    extra = kind(name="mine", expression=lambda at: ca.if_else(angle(at) > 0.5, np.nan, angle(at)), **bounds)
    with pytest.raises(ProblemError, match=f"extra {extra.kind} 'mine': its expression contains NaN as a constant"):
        Problem.reach(arm, **REACH, **{f"extra_{extra.kind}s": [extra]})
