"""`compare` names `tune` only where `tune` finds gains; elsewhere it says why there are none to be found."""

from dataclasses import replace

import pytest

import linkplan
from linkplan.models.errors import LinkplanError
from linkplan.studies.compare.compare import compare
from linkplan.studies.compare.comparison_notes import default_gains

ARM = """<mujoco><worldbody><body><joint name="J" axis="0 1 0"/><geom size=".05" pos="0 0 -.3" mass="1"/>{}</body>
</worldbody><actuator>{}</actuator></mujoco>"""
LOAD = """<body pos="0 0 -.3"><joint name="K" axis="0 1 0" damping=".1"/>
<geom size=".05" pos="0 0 -.3" mass=".2" contype="0" conaffinity="0"/></body>"""
MOTOR = '<motor name="{}" joint="J" ctrlrange="-10 10"/>'
CASES = {
    "one motor of one freedom": (ARM.format("", MOTOR.format("M")), True),
    "two motors of one freedom": (ARM.format("", MOTOR.format("M") + MOTOR.format("N")), False),
    "one motor of two freedoms": (ARM.format(LOAD, MOTOR.format("M")), False),
}


@pytest.mark.slow
@pytest.mark.parametrize(("text", "tunes"), CASES.values(), ids=CASES)
def test_tune_is_recommended_where_it_does_not_refuse(text, tunes):
    mechanism = linkplan.load_mechanism(text)
    names = [joint.name for joint in mechanism.independent_joints]
    ends = {"start_deg": dict.fromkeys(names, 0.0), "goal_deg": dict.fromkeys(names, 0.0) | {"J": 10.0}}
    problem = linkplan.Problem.reach(mechanism, **ends, duration_s=2.0)
    comparison = compare(linkplan.plan(problem).require(), None, asked=["pd"])
    (note,) = default_gains(comparison)
    assert ("linkplan tune" in note) is tunes
    if tunes:
        assert linkplan.tune(problem, bandwidth_hz=2.0).to_dict()
        return
    with pytest.raises(LinkplanError) as refused:
        linkplan.tune(problem, bandwidth_hz=2.0)
    assert str(refused.value) in note


@pytest.mark.slow
def test_tune_is_not_recommended_where_no_pose_is_held():
    """The least effort of the motor is more than the weight needs anywhere."""
    problem = linkplan.Problem.reach(
        linkplan.load_mechanism(CASES["one motor of one freedom"][0]),
        start_deg={"J": 0.0},
        goal_deg={"J": 10.0},
        duration_s=2.0,
    )
    comparison = compare(linkplan.plan(problem).require(), None, asked=["pd"])
    weak = problem.replace(limits={"effort": {"M": [0.9, 1.0]}})
    (note,) = default_gains(replace(comparison, plan=replace(comparison.plan, problem=weak)))
    assert "linkplan tune" not in note
    assert "needs effort to both sides" in note
