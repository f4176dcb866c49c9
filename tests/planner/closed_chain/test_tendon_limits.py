"""Ranges of tendons: kept in the program, looked at between the nodes, found before any solving, and MuJoCo's own."""

import mujoco
import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.check.inspection import inspect
from tests.support.mechanisms import replaced
from tests.support.refusals import assert_refused, refusal

# Two links in the plane, swung level: a strap from the wall behind to the tip, or the sum of their angles, is limited.
ARM = """<mujoco model="strapped"><compiler angle="radian" autolimits="true"/><option gravity="0 0 0"/>
  <default><joint axis="0 1 0"/><geom contype="0" conaffinity="0" size="0.02" mass="0.5"/></default>
  <worldbody><site name="wall" pos="-0.3 0 0.1"/>
    <body name="upper"><joint name="S"/><geom type="capsule" fromto="0 0 0 0.3 0 0"/>
      <body name="fore" pos="0.3 0 0"><joint name="E"/><geom type="capsule" fromto="0 0 0 0.25 0 0"/>
        <site name="tip" pos="0.25 0 0"/></body></body></worldbody>
  <tendon>{tendon}</tendon>
  <actuator><motor name="s" joint="S" ctrlrange="-5 5"/><motor name="e" joint="E" ctrlrange="-5 5"/></actuator></mujoco>"""
STRAP = '<spatial name="strap" range="{low} {high}"><site site="wall"/><site site="tip"/></spatial>'
SUM = '<fixed name="sum" range="{low} {high}"><joint joint="S" coef="1"/><joint joint="E" coef="1"/></fixed>'
MOTION = {"start_deg": {"S": 40, "E": 60}, "goal_deg": {"S": 40, "E": -60}, "duration_s": 0.6}
# A length that is kept [of itself]: what rounding leaves, and how near the strap comes to its end.
KEPT, NEAR = 1e-6, 1e-3


def planned(model: str, **motion: object) -> Plan:
    return plan_motion(Problem.reach(model, **MOTION | motion))


def strapped(high: float) -> str:
    return ARM.format(tendon=STRAP.format(low=0.0, high=high))


def lengths(plan: Plan) -> np.ndarray:
    """Return MuJoCo's tendon length along a plan, finely."""
    mechanism, time = plan.problem.mechanism, np.linspace(0.0, plan.trajectory.duration_s, 2001)
    data, found = mujoco.MjData(mechanism.model), []
    for s in plan.trajectory.position_at(time):
        data.qpos[:] = mechanism.qpos_of(s)
        mujoco.mj_fwdPosition(mechanism.model, data)
        found.append(float(data.ten_length[0]))
    return np.array(found)


def test_a_strap_is_not_overstretched_between_the_nodes():
    free, kept = planned(strapped(2.0)).require(), planned(strapped(0.81)).require()
    assert lengths(free).max() > 0.82, "it would be"
    assert 0.81 * (1 - NEAR) < lengths(kept).max() < 0.81 * (1 + KEPT)
    assert kept.objective > 1.001 * free.objective
    (margin,) = [margin for margin in kept.certificate.margins if margin.what == "tendon"]
    assert (margin.name, margin.limit, margin.unit) == ("strap", 0.81, "m")


def test_a_plan_made_without_the_strap_fails_the_certificate_with_it():
    free = planned(strapped(2.0)).require()
    asked = Problem.reach(strapped(0.81), **MOTION)
    (failure,) = certify(asked, free.trajectory).failures
    assert "the length of tendon strap comes to 0.8" in failure
    assert "beyond its limit of 0.81" in failure


def test_a_sum_of_angles_is_limited_as_a_fixed_tendon_says():
    bent = planned(ARM.format(tendon=SUM.format(low=-2.0, high=1.8))).require()
    assert lengths(bent).max() < 1.8 * (1 + KEPT)
    assert lengths(bent)[0] == pytest.approx(np.radians(100))


def test_a_goal_beyond_a_tendons_range_is_said_before_any_solving():
    plan = planned(ARM.format(tendon=SUM.format(low=-0.2, high=1.8)))
    assert plan.status == "infeasible"
    assert plan.history == ()
    assert "the length of tendon sum is -0.349066 at the goal, 0.1491 beyond its limit of -0.2" in plan.message


def test_a_tendon_that_is_too_short_on_the_only_way_is_named():
    text = replaced(strapped(0.6), '<joint name="E"/>', "")
    text = replaced(text, '<motor name="e" joint="E" ctrlrange="-5 5"/>', "")
    plan = planned(text, start_deg={"S": 120}, goal_deg={"S": -120})
    assert plan.status == "infeasible"
    assert "the length of tendon strap is 0.8" in plan.message
    assert "between start and goal" in plan.message


def test_check_says_where_a_tendon_ends_the_motion():
    text = replaced(strapped(0.6), '<joint name="E"/>', "")
    text = replaced(text, '<motor name="e" joint="E" ctrlrange="-5 5"/>', "<!-- -->")
    mechanism = load_mechanism(text, home={"S": 2.2})
    found = inspect(mechanism, [])
    (note,) = [note for note in found.notes if "tendon strap" in note]
    assert "at the end of its range [0, 0.6] m at S = " in note
    first = float(note.split("S = ")[1].split(",")[0].split()[0])
    pose = close_at(mechanism, np.radians([first]))
    assert float(mechanism.dynamics.tendon_length(pose)) == pytest.approx(0.6, abs=1e-4)
    straight = inspect(load_mechanism(text), [])
    assert any("tendon strap has the length 0.8559 at home, outside its range" in problem for problem in straight.problems)


def test_a_margin_that_leaves_a_tendon_no_length_is_refused():
    text = ARM.format(tendon=STRAP.format(low=0.5, high=0.8).replace("range=", 'margin="0.2" range='))
    assert "tendon strap is left no length" in refusal(lambda: load_mechanism(text))


def test_a_tendon_through_the_inside_of_a_geom_is_refused_with_its_limit():
    through = '<geom geom="post" sidesite="inside"/><site site="tip"/>'
    wrapped = STRAP.format(low=0.0, high=0.8).replace('<site site="tip"/>', through)
    post = '<worldbody><geom name="post" type="cylinder" size=".1 .1" pos="0 0.2 0.5"/><site name="inside" pos="0 0.2 0.5"/>'
    text = replaced(ARM.format(tendon=wrapped), "<worldbody>", post)
    assert_refused(lambda: planned(text), "limit of tendon strap, which passes through the inside of a geom")
