"""Springs whose equilibrium lies beyond a joint's range: the joint rests on its stop, which is named with its remedy."""

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.models.poses.equilibrium import rests_on_stops
from linkplan.studies.check.drives import pressed_joints, sprung_stops
from linkplan.studies.check.new.changes import changed_mechanism

STIFFNESS, REST_DEG = 3.0, -30.0
LEG = """<mujoco><worldbody><body pos="0 0 1"><joint name="A" axis="0 1 0" damping=".1"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3" mass="1"/><body pos="0 0 -.3">
<joint name="toe" axis="0 1 0" range="{low} 40" stiffness="3" springref="-30" damping=".02"/>
<geom type="capsule" size=".01" fromto="0 0 0 .1 0 0" mass=".1"/></body></body></worldbody>
<actuator><motor name="m" joint="A" ctrlrange="-30 30"/></actuator>
<keyframe><key name="home" qpos="0 {home}"/></keyframe></mujoco>"""


def leg(low_deg: float, home_deg: float = 10.0) -> linkplan.Mechanism:
    """Return a leg whose toe is turned by a spring towards -30 deg, with a stop at an angle."""
    return linkplan.load_mechanism(LEG.format(low=low_deg, home=np.radians(home_deg)))


@pytest.mark.parametrize("home_deg", [10.0, 0.0])
def test_a_toe_pressed_onto_its_stop_is_a_problem_with_its_remedy(home_deg):
    mechanism = leg(0.0, home_deg)
    (problem,) = [line for line in linkplan.check(mechanism).problems if "stop" in line]
    assert "weight and springs press toe (0 deg) onto its stop" in problem
    assert "mechanism.lock = { toe = 0 }" in problem
    changed, notes = changed_mechanism({"model": LEG.format(low=0.0, home=np.radians(home_deg))})
    assert [joint.name for joint in changed.joints] == ["A"]
    assert any("mechanism.lock: toe = 0" in note for note in notes)


def test_a_toe_with_its_equilibrium_inside_its_range_is_free():
    mechanism = leg(-40.0)
    assert rests_on_stops(mechanism, {0: 0.0}, (1,)) == {}
    assert sprung_stops(mechanism) == []
    assert pressed_joints(mechanism) == []
    assert not [line for line in linkplan.check(mechanism).problems if "stop" in line]


def test_a_stop_is_where_the_spring_s_moment_and_the_weight_have_no_balance():
    # k (q - rest) = -m g l cos(q): without a stop the toe's equilibrium is a root of this equation.
    moment = 0.1 * 9.81 * 0.05
    q = np.radians(np.linspace(-40, 0, 400_001))
    balance = STIFFNESS * (q - np.radians(REST_DEG)) - moment * np.cos(q)
    rest_deg = float(np.degrees(q[np.argmin(np.abs(balance))]))
    for low_deg in (rest_deg - 0.1, rest_deg + 0.1):
        stops = rests_on_stops(leg(low_deg), {0: 0.0}, (1,))
        assert stops == ({} if low_deg < rest_deg else {1: pytest.approx(np.radians(low_deg))})


def test_a_start_that_does_not_name_it_is_refused_with_the_remedy():
    with pytest.raises(ProblemError, match=r"names no value for toe: weight and springs press toe .*lock = \{ toe = 0 \}"):
        linkplan.Problem.reach(leg(0.0), start_deg={"A": 0.0}, goal_deg={"A": 20.0}, duration_s=0.5)
    problem = linkplan.Problem.reach(leg(-40.0), start_deg={"A": 0.0}, goal_deg={"A": 20.0}, duration_s=0.5)
    assert np.degrees(problem.motion.start[1]) == pytest.approx(-29.0, abs=0.5)


def test_the_joint_that_is_pressed_farther_is_held_first_and_may_free_the_other():
    """Springs pull a to -0.952 m and b, half as far, to -0.476 m; with a on its stop at -0.1 m, b rests at -0.05 m."""
    tied = linkplan.load_mechanism(
        """<mujoco><option gravity="0 0 0"/><compiler autolimits="true"/><default><joint type="slide" axis="1 0 0"/>
        <geom size=".01" mass="1" contype="0" conaffinity="0"/></default><worldbody>
        <body><joint name="a" range="-.1 1" stiffness="100" springref="-1"/><geom/></body>
        <body><joint name="b" range="-.4 1" stiffness="10"/><geom/></body></worldbody>
        <tendon><fixed stiffness="10" springlength="0"><joint joint="a" coef="1"/><joint joint="b" coef="-1"/></fixed>
        </tendon></mujoco>"""
    )
    assert rests_on_stops(tied, {}, (0, 1)) == pytest.approx({0: -0.1})


def test_a_load_that_one_of_two_ropes_holds_is_not_pressed_onto_its_stop():
    mechanism = linkplan.load_mechanism("""<mujoco><worldbody><body><joint name="z" type="slide" axis="0 0 1" range="0 1"/>
    <inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody><actuator>
    <motor name="up" joint="z" ctrlrange="0 100"/><motor name="down" joint="z" gear="-1" ctrlrange="0 100"/>
    </actuator></mujoco>""")
    assert pressed_joints(mechanism) == []
