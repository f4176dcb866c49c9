"""Limits on the forces in joints of the tree: closed forms of an arm, and names that are refused."""

import numpy as np
import pytest
from scipy.integrate import quad

from linkplan.models.errors import ProblemError
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion
from tests.support.refusals import assert_refused

ARM = """<mujoco><option gravity="0 0 {}"/><worldbody><body><joint name="J" axis="0 {} {}"/>
  <inertial pos="0.5 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody>
  <actuator><motor joint="J" ctrlrange="-40 40"/></actuator></mujoco>"""
IN_GRAVITY, LEVEL = ARM.format(-9.81, 1, 0), ARM.format(0, 0, 1)


def plan_of(model: str, newton: float, minimize: str, **motion: object) -> Plan:
    tables = {"mechanism": {"model": model}, "motion": motion, "objective": {"minimize": minimize}}
    return plan_motion(Problem.from_tables("arm", tables | {"limits": {"pin_force": {"J": newton}}}))


@pytest.mark.slow
@pytest.mark.parametrize("angle_deg", [60.0, 150.0])
def test_the_least_time_of_a_level_arm_is_a_lemniscate_s_and_is_proved(angle_deg):
    """(m r)^2 (v^4 + v'^2) <= R^2: v' = sqrt(c^2 - v^4) up to v^2 = c sin(angle), or up to c, where v stays."""
    c, angle = 8.0, np.radians(angle_deg)  # R / (m r) [rad2/s2] with R = 8 N
    plan = plan_of(LEVEL, 8.0, "time", kind="reach", start_deg={"J": 0}, goal_deg={"J": angle_deg}, duration_s="free")
    top = np.sqrt(np.sin(min(angle, np.pi / 2)))
    rising, _ = quad(lambda p: top * np.cos(p) / np.sqrt(1 - (top * np.sin(p)) ** 4), 0, np.pi / 2)
    assert plan.duration_s == pytest.approx((2 * rising + max(0.0, angle - np.pi / 2)) / np.sqrt(c), rel=1e-7)
    assert plan.duration_s > 1.05 * 2 * np.sqrt(angle * 1.5 / 40)  # of the motor alone
    (finding,) = [one for one in plan.prove(existence=False).findings if one.name == "squared pin force of J"]
    assert finding.answer == "proved"


@pytest.mark.parametrize("newton", [20.0, 15.0])
def test_a_pin_too_weak_for_the_weight_at_rest_is_named_with_the_weight(newton):
    plan = plan_of(IN_GRAVITY, newton, "effort", kind="hold", start_deg={"J": 30}, duration_s=1.0)
    assert plan.passed == (newton > 2 * 9.81)
    if not plan.passed:
        (over,) = plan.verdict.overruns
        assert (plan.status, over.limit, over.name, over.bound, over.unit) == ("infeasible", "pin_force", "J", 15.0, "N")
        assert over.value == pytest.approx(2 * 9.81, rel=1e-9)
        assert "the pin force of J comes to 19.62 N at t = 0 s, 4.62 N beyond its limit of 15 N" in plan.message


def test_a_closure_s_pin_is_limited_by_either_key_and_a_joint_by_its_own_name_or_its_pin_s():
    limits = load_problem("knee-reach", ["limits.pin_force={B=5, O=300}"]).limits
    assert (limits.closure_force.tolist(), limits.pin_force) == ([5.0], {"O": 300.0})
    assert load_problem("slider-crank-turn", ["limits.pin_force={'joint B'=9}"]).limits.pin_force == {"joint B": 9.0}


LOOSE = """<mujoco><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/><joint name="turn" axis="0 0 1"/>
  <geom size="0.1"/></body><body name="base"><freejoint name="base"/><geom size="0.1"/></body></worldbody>
  <actuator><motor joint="x" ctrlrange="-9 9"/><motor joint="turn" ctrlrange="-9 9"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("model", "given", "said"),
    [
        ("optimus-knee", {"Q": 5}, "unknown joint or closure in limits.pin_force 'Q'; legal: O, A, C, B"),
        ("slider-crank", {"B": 5}, "'joint B' limits the joint, limits.closure_force.B the closure"),
        (LOOSE, {"x": 5, "turn": 6}, "names joints x, turn, which share one force, twice"),
        (LOOSE, {"base": 5}, "joint base leaves its body all six freedoms and carries no force"),
    ],
)
def test_a_name_without_one_force_is_refused_in_one_line(model, given, said):
    tables = {"mechanism": {"model": model}, "motion": {"kind": "hold", "duration_s": 1.0}, "limits": {"pin_force": given}}
    assert_refused(lambda: Problem.from_tables("pins", tables), said, kind=ProblemError)


def test_one_force_has_one_limit():
    twice = ["limits.pin_force.B=5", "limits.closure_force.B=6"]
    assert_refused(lambda: load_problem("knee-reach", twice), "limit one force: keep one of them", kind=ProblemError)
