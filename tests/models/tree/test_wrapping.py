"""Tendons that wrap around cylinders and spheres: their lengths and moment arms are MuJoCo's, wrapped and straight."""

import casadi as ca
import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.models.tree.dynamics import build_tree
from linkplan.models.tree.tendons import lacks_length

ARM = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody><site name="base" pos="-.3 .02 1.05"/>
<body name="arm" pos="0 0 1"><joint name="A" axis="0 -1 0" range="-1.2 1.2" damping=".1"/>{swing}
<geom name="drum" {drum} mass=".1"/><geom size=".02" fromto="0 0 0 .3 0 0" type="capsule" mass="1"/>
<site name="tip" pos=".2 -.03 .03"/><site name="eye" pos=".25 -.02 .04"/><site name="side" pos="{side}"/>
<body name="fore" pos=".3 0 0"><joint name="C" axis="0 1 0" range="-1 1" damping=".1"/>
<geom name="ball" type="sphere" size=".03" mass=".1"/>
<geom size=".02" fromto="0 0 0 .2 0 0" type="capsule" mass=".5"/><site name="hand" pos=".15 0 .04"/></body></body>
</worldbody><tendon><spatial name="rope" stiffness="40" springlength=".2"><site site="base"/><geom geom="drum" {sided}/>
<site site="tip"/><site site="eye"/><geom geom="ball"/><site site="hand"/><pulley divisor="2"/><site site="hand"/>
<site site="base"/></spatial></tendon>
<actuator><motor name="pull" tendon="rope" ctrlrange="-200 0"/><motor name="elbow" joint="C" ctrlrange="-20 20"/>
</actuator></mujoco>"""
CYLINDER, SPHERE = 'type="cylinder" size=".05 .1" euler="1.57 .1 0"', 'type="sphere" size=".05"'
# An arm whose rope runs over a pulley on its joint: the rope only pulls, and lifts the arm.
HOIST = """<mujoco><option timestep=".0005"/><worldbody><site name="base" pos="-.3 0 1.05"/><body pos="0 0 1">
<joint name="A" axis="0 -1 0" range="-60 60" damping=".1"/>
<geom name="drum" type="cylinder" size=".05" fromto="0 -.02 0 0 .02 0" mass=".1"/>
<geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/><site name="tip" pos=".2 0 .03"/>
<site name="side" pos="0 0 .08"/></body></worldbody><tendon><spatial name="rope"><site site="base"/>
<geom geom="drum" sidesite="side"/><site site="tip"/></spatial></tendon>
<actuator><motor name="pull" tendon="rope" ctrlrange="-90 0"/></actuator></mujoco>"""
SWING = '<joint name="B" axis="1 .3 0" range="-.4 .4"/>'


def arm(drum: str, side: str | None, swing: str = SWING) -> str:
    """Return an arm with a rope around a drum on its shoulder, on the side of a site, and around a ball on its elbow."""
    sided = "" if side is None else 'sidesite="side"'
    return ARM.format(drum=drum, side=side or "0 0 0", sided=sided, swing=swing)


def both_lengths(model: mujoco.MjModel, n: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ours and MuJoCo's length and derivatives (n, 1 + nv) at random poses, and the numbers of geoms touched (n,)."""
    tree, data, rng = build_tree(model), mujoco.MjData(model), np.random.default_rng(4)
    (length,) = tree.tendon_lengths
    function = ca.Function("length", [tree.q], [ca.horzcat(length, ca.jacobian(length, tree.q))])
    ours, theirs, touched = [], [], []
    for _ in range(n):
        data.qpos[:] = rng.uniform(*model.jnt_range.T)
        mujoco.mj_forward(model, data)
        rows = np.zeros((1, model.nv))
        mujoco.mju_sparse2dense(rows, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind)
        ours.append(np.array(function(data.qpos)).ravel())
        theirs.append([data.ten_length[0], *rows[0]])
        touched.append((int(data.ten_wrapnum[0]) - 7) // 2)  # six sites and the pulley
    return np.array(ours), np.array(theirs), np.array(touched)


@pytest.mark.parametrize(("drum", "side"), [(CYLINDER, None), (CYLINDER, "0 0 .08"), (CYLINDER, "0 0 -.08"), (SPHERE, None)])
def test_lengths_and_moment_arms_are_mujoco_s_where_the_rope_touches_and_where_not(drum, side):
    ours, theirs, touched = both_lengths(mujoco.MjModel.from_xml_string(arm(drum, side)))
    assert np.abs(ours - theirs).max() < 1e-12
    assert len(set(touched.tolist())) > 1  # the rope touches more geoms at some poses than at others


def test_a_rope_around_a_pulley_on_its_joint_has_the_pulley_s_radius_as_its_moment_arm():
    tree = build_tree(mujoco.MjModel.from_xml_string(HOIST))
    (length,) = tree.tendon_lengths
    arms = ca.Function("arms", [tree.q], [ca.jacobian(length, tree.q)]).map(9)
    assert np.array(arms(np.linspace(-1.0, 0.0, 9)[None])).ravel() == pytest.approx(np.full(9, -0.05), abs=1e-12)


@pytest.mark.parametrize(("drum", "side"), [(CYLINDER, ".01 0 .01"), (SPHERE, "0 0 .08"), (SPHERE, "0 0 .01")])
def test_what_has_no_expression_is_named_with_its_remedy(drum, side):
    text = arm(drum, side)
    assert lacks_length(mujoco.MjModel.from_xml_string(text), 0)
    said = " ".join([*(found := linkplan.check(linkplan.load_mechanism(text))).problems, *found.notes])
    assert "stiffness of tendon rope, which passes through the inside of a geom, or around a sphere with a side site" in said
    assert "make it a fixed tendon with the pulley's radius" in said


@pytest.mark.slow
def test_a_rope_around_a_pulley_drives_a_planned_motion_that_mujoco_makes():
    problem = linkplan.Problem.reach(HOIST, start_deg={"A": 0.0}, goal_deg={"A": 25.0}, duration_s=0.6)
    plan = linkplan.plan(problem).require()
    ends = plan.trajectory.effort_at(np.array([0.0, 0.6]))[:, 0]
    assert (ends < 0).all()  # the rope pulls
    assert (ends > -90).all()
    (rollout,) = linkplan.track(plan, "pd+ff").comparison.nominal.values()
    assert np.degrees(np.abs(rollout.error_rad).max()) < 0.05
    assert plan.prove().passed  # undecided where the rope leaves the pulley
