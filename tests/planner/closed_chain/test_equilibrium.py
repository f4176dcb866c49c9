"""Starts in equilibrium, and joints at rest beside moving ones."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.equilibrium import slopes_at_rest, spring_equilibrium, sprung_freedoms
from linkplan.models.selection import Selection
from linkplan.planner.certificate.integration import integrate
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.transcribe import choose_scales
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import body_plan, body_problem
from tests.support.fourbar import G
from tests.support.tolerances_planner import SAME_FIGURE

MASS, STIFFNESS = 2.0, 400.0
# An arm on a motor, and a weight that hangs from its tip on a spring along the arm.
HANGING = f"""<mujoco><compiler angle="radian"/><option gravity="0 0 -{G}"/><worldbody>
<body name="arm"><joint name="arm" axis="0 -1 0"/><inertial mass="1" pos="0.2 0 0" diaginertia="0.01 0.01 0.01"/>
<body name="weight" pos="0.4 0 0"><joint name="spring" type="slide" axis="1 0 0" {{spring}}/>
<inertial mass="{MASS}" pos="0 0 0" diaginertia="0.001 0.001 0.001"/></body></body>
</worldbody><actuator><motor name="drive" joint="arm" ctrlrange="-60 60"/></actuator></mujoco>"""
SPRUNG = HANGING.format(spring=f'stiffness="{STIFFNESS}" damping="4"')
# Rests found against the closed form [m].
REST_M = 1e-12


def tables(path, start: dict, goal: dict) -> dict:
    motion = {"kind": "reach", "start_deg": start, "goal_deg": goal, "duration_s": 1.0}
    return {"mechanism": {"model": str(path)}, "motion": motion}


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(SPRUNG, encoding="utf-8")
    return path


def test_an_unnamed_weight_hangs_where_its_spring_holds_it(arm):
    problem = Problem.from_tables("arm", tables(arm, {"arm": -30.0}, {"arm": 20.0}))
    for s, angle in ((problem.motion.start, -30.0), (problem.motion.goal, 20.0)):
        # Along the arm at this angle above the horizon gravity has -g sin.
        assert s == pytest.approx([np.radians(angle), -MASS * G * np.sin(np.radians(angle)) / STIFFNESS], abs=REST_M)


def test_a_value_that_is_named_is_kept(arm):
    named = tables(arm, {"arm": -30.0}, {"arm": 20.0})
    named["motion"]["start_m"] = {"spring": 0.0}
    problem = Problem.from_tables("arm", named)
    assert problem.motion.start[1] == 0.0
    assert problem.motion.goal[1] < -1e-3


def test_a_home_that_rounding_keeps_from_zero_is_a_start_like_any_other(arm):
    """Assembled homes are 1e-15 from zero: a first step as short as that would never arrive."""
    mechanism = load_mechanism(arm)
    mechanism = replace(mechanism, home=mechanism.home + 1e-15)
    rest = spring_equilibrium(mechanism, {0: np.radians(-30.0)}, (1,))
    assert rest is not None
    assert rest[1] == pytest.approx(MASS * G * np.sin(np.radians(30.0)) / STIFFNESS, abs=REST_M)


def test_from_rest_to_rest_a_plan_needs_no_effort_beyond_the_arm_s_at_its_ends(arm):
    plan = plan_motion(Problem.from_tables("arm", tables(arm, {"arm": -30.0}, {"arm": 20.0}))).require()
    assert plan.certificate.passed
    ends = plan.trajectory.position_at(np.array([0.0, plan.trajectory.duration_s]))
    assert ends[:, 1] == pytest.approx(
        [-MASS * G * np.sin(np.radians(a)) / STIFFNESS for a in (-30.0, 20.0)], abs=SAME_FIGURE
    )


def test_freedoms_on_springs_that_have_no_rest_are_named_with_the_key_that_locks_them(arm, monkeypatch):
    arm.write_text(SPRUNG.replace('name="spring"', 'name="a spring"'), encoding="utf-8")
    monkeypatch.setattr("linkplan.planner.problem.motion_table.spring_equilibrium", lambda *_: None)
    with pytest.raises(ProblemError, match="has no value for a spring, and no equilibrium") as refused:
        Problem.from_tables("arm", tables(arm, {"arm": -30.0}, {"arm": 20.0}))
    key = str(refused.value).split("near home; mechanism.")[1].removesuffix(" holds them")
    locked = load_mechanism(arm, selection=Selection(**tomllib.loads(key)))
    assert [joint.name for joint in locked.joints] == ["arm"]


def test_the_value_of_a_joint_without_a_spring_or_with_a_drive_is_asked_for(arm):
    loose = tables(HANGING.format(spring='damping="4"'), {"arm": 0.0}, {"arm": 20.0})
    driven = tables(arm, {}, {})
    driven["motion"]["start_m"] = driven["motion"]["goal_m"] = {"spring": 0.0}
    for asked, joint in ((loose, "spring"), (driven, "arm")):
        with pytest.raises(ProblemError, match=f"has no value for the independent joint {joint}"):
            Problem.from_tables("arm", asked)


def test_a_rest_within_a_loop_is_where_no_effort_is_missing():
    """A five-bar driven at one crank, the other on a spring: at the rest its motor alone holds all."""
    text = """<mujoco><compiler angle="degree"/><worldbody>
<body><joint name="a" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 0.1 0 0.2" size="0.01" contype="0"/>
<body pos="0.1 0 0.2"><joint name="b" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 0.1 0 0.1" size="0.01" contype="0"/>
<site name="one" pos="0.1 0 0.1"/></body></body>
<body pos="0.4 0 0"><joint name="c" axis="0 -1 0" stiffness="3"/>
<geom type="capsule" fromto="0 0 0 -0.1 0 0.2" size="0.01" contype="0"/>
<body pos="-0.1 0 0.2"><joint name="d" axis="0 -1 0"/>
<geom type="capsule" fromto="0 0 0 -0.1 0 0.1" size="0.01" contype="0"/><site name="two" pos="-0.1 0 0.1"/></body></body>
</worldbody><equality><connect name="pin" site1="one" site2="two"/></equality>
<actuator><motor name="m" joint="a" ctrlrange="-9 9"/></actuator></mujoco>"""
    mechanism = load_mechanism(text, independent=["a", "c"])
    assert sprung_freedoms(mechanism) == (1,)
    s = spring_equilibrium(mechanism, {0: np.radians(5.0)}, (1,))
    assert s is not None
    assert abs(s[1]) > 1e-3
    still = np.zeros(2)
    pose = close_at(mechanism, s)
    tau = np.array(mechanism.dynamics.inverse_dynamics(pose, still, still)).ravel()
    assert abs(tau[1]) < SAME_FIGURE
    assert abs(tau[0]) > 1e-3


def test_the_slopes_of_the_missing_effort_are_those_of_finite_differences():
    text = """<mujoco><worldbody><body><joint name="a" axis="0 1 0" stiffness="2"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/><body pos="0.3 0 0"><joint name="b" axis="0 1 0" stiffness="1"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/></body></body></worldbody>
<tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="-0.5"/></fixed></tendon>
<actuator><motor tendon="t" ctrlrange="-9 9"/></actuator></mujoco>"""
    mechanism = load_mechanism(text)
    q, u, still = np.array([0.2, 0.5]), np.array([0.7]), np.zeros(2)

    def missing(q):
        return np.array(mechanism.dynamics.residual(q, still, still, u)).ravel()

    steps = 1e-6 * np.eye(2)
    expected = np.array([(missing(q + step) - missing(q - step)) / 2e-6 for step in steps]).T
    np.testing.assert_allclose(slopes_at_rest(mechanism)(q, u), expected, rtol=1e-7)


INERTIA = 0.02
# Two wheels, of which the second stands still; damping makes both stable.
WHEELS = f"""<mujoco><worldbody>
  <body><joint name="A" damping="0.1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 {INERTIA}"/></body>
  <body pos="1 0 0"><joint name="B" damping="0.1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 {INERTIA}"/></body>
</worldbody><actuator>
  <motor name="at_A" joint="A" ctrlrange="-50 50"/><motor name="at_B" joint="B" ctrlrange="-50 50"/>
</actuator></mujoco>"""
ONE_MOVES = 'kind = "reach"\nstart_deg = { A = 0.0, B = 0.0 }\ngoal_deg = { A = 60.0, B = 0.0 }\nduration_s = 0.5\n'


def planned() -> Plan:
    plan = body_plan(WHEELS, ONE_MOVES)
    assert plan.status == "optimal", plan.message
    return plan


def test_the_unit_of_an_effort_at_rest_is_the_one_that_turns_its_joint_by_a_radian():
    problem = body_problem(WHEELS, ONE_MOVES)
    scales = choose_scales(problem, first_guess(problem, problem.start_pose()))
    assert scales.effort[1] == pytest.approx(INERTIA / 0.5**2, rel=0.01)
    assert scales.residual == pytest.approx(scales.effort)  # each motor turns one wheel


def test_a_stable_motion_beside_a_joint_at_rest_is_integrated_in_one_go():
    """Its speed, divided by the rounding that the joint at rest moves by, looked like the growth of an error."""
    plan = planned()
    wrong = replace(plan.trajectory, effort=1.1 * plan.trajectory.effort)
    judged = integrate(plan.problem.mechanism, wrong, 4.0, np.full(2, 1e-4))
    assert judged.position[0] > 1e-4
    assert judged.restarts == 0
