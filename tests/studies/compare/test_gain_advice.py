"""`compare` names `tune` only where `tune` finds gains; elsewhere it says why there are none to be found."""

from dataclasses import replace

import pytest

import linkplan
from linkplan.studies.compare.compare import compare
from linkplan.studies.compare.comparison_notes import default_gains

ARM = """<mujoco><worldbody><body><joint name="J" axis="0 1 0"/><geom size=".05" pos="0 0 -.3" mass="1"/>{}</body>
</worldbody><actuator>{}</actuator></mujoco>"""
LOAD = """<body pos="0 0 -.3"><joint name="K" axis="0 1 0" damping=".1"/>
<geom size=".05" pos="0 0 -.3" mass=".2" contype="0" conaffinity="0"/></body>"""
MOTOR = '<motor name="{}" joint="J" ctrlrange="-10 10"/>'
CASES = {
    "one motor of one freedom": ARM.format("", MOTOR.format("M")),
    "two motors of one freedom": ARM.format("", MOTOR.format("M") + MOTOR.format("N")),
    "one motor of two freedoms": ARM.format(LOAD, MOTOR.format("M")),
}


@pytest.mark.slow
@pytest.mark.parametrize("text", CASES.values(), ids=CASES)
def test_tune_is_recommended_and_answers(text):
    mechanism = linkplan.load_mechanism(text)
    names = [joint.name for joint in mechanism.independent_joints]
    ends = {"start_deg": dict.fromkeys(names, 0.0), "goal_deg": dict.fromkeys(names, 0.0) | {"J": 10.0}}
    problem = linkplan.Problem.reach(mechanism, **ends, duration_s=2.0)
    comparison = compare(linkplan.plan(problem).require(), None, asked=["pd"])
    (note,) = default_gains(comparison)
    assert "linkplan tune" in note
    assert linkplan.tune(problem, bandwidth_hz=2.0).tracking["kp"]


@pytest.mark.slow
def test_tune_is_not_recommended_where_no_pose_is_held():
    """The least effort of the motor is more than the weight needs anywhere."""
    problem = linkplan.Problem.reach(
        linkplan.load_mechanism(CASES["one motor of one freedom"]),
        start_deg={"J": 0.0},
        goal_deg={"J": 10.0},
        duration_s=2.0,
    )
    comparison = compare(linkplan.plan(problem).require(), None, asked=["pd"])
    weak = problem.replace(limits={"effort": {"M": [0.9, 1.0]}})
    (note,) = default_gains(replace(comparison, plan=replace(comparison.plan, problem=weak)))
    assert "linkplan tune" not in note
    assert "needs effort to both sides" in note
