"""Where actuators are drawn to act: at their hinges, sites and tendons, and which way a positive effort goes."""

import mujoco
import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.studies.output.document import Drive
from linkplan.studies.output.drives import drives_of
from tests.support.linkages import GRIPPER
from tests.support.mechanisms import replaced

PLANE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
# Two links with a rope along them by way of a pulley's other branch, and a thruster at the tip, tilted with its link.
ROPED = """<mujoco><compiler angle="degree"/><option gravity="0 0 0"/><worldbody><site name="reel" pos="0 0 0.2"/>
<body name="upper"><joint name="a" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
<site name="guide" pos="0.1 0 0.1"/><body name="lower" pos="0.3 0 0"><joint name="b" axis="0 -1 0"/>
<geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/><site name="tip" pos="0.2 0 0"/></body></body></worldbody>
<tendon><spatial name="rope"><site site="reel"/><site site="guide"/><site site="tip"/></spatial></tendon>
<actuator><motor name="pull" tendon="rope" ctrlrange="-9 0"/><motor name="thrust" site="tip" gear="0 0 -2 0 0 0"
ctrlrange="-3 3"/></actuator></mujoco>"""
POSES = np.radians([[0.0, 0.0], [30.0, -20.0], [60.0, 40.0]])
# Rounding of a page's numbers, of the largest of their kind.
SHOWN = 2e-5


def drawn(model: str, poses: np.ndarray, frame: np.ndarray = PLANE) -> dict[str, Drive]:
    mechanism = load_mechanism(model)
    effort = np.ones((len(poses), mechanism.n_u))
    return {drive.name: drive for drive in drives_of(mechanism, poses, effort, None, frame)}


def places(model: str, name: str) -> np.ndarray:
    """Return where a site stands at the poses, by MuJoCo (n, 3) [m]."""
    found, data = [], mujoco.MjData(compiled := mujoco.MjModel.from_xml_string(model))
    for pose in POSES:
        data.qpos[:] = pose
        mujoco.mj_kinematics(compiled, data)
        found.append(np.array(data.site(name).xpos))
    return np.array(found)


def test_a_tendon_is_a_line_through_its_sites():
    (mark,) = drawn(ROPED, POSES)["pull"].marks
    assert mark.shape == "line"
    points = np.array(mark.at, dtype=float).reshape(len(POSES), 3, 2)
    for k, name in enumerate(("reel", "guide", "tip")):
        np.testing.assert_allclose(points[:, k], places(ROPED, name) @ PLANE.T, atol=SHOWN)


def test_a_tendon_over_a_pulley_is_a_line_for_each_branch():
    branches = replaced(
        ROPED, '<site site="reel"/><site site="guide"/>', '<site site="reel"/><site site="guide"/><pulley divisor="2"/>'
    ).replace('<pulley divisor="2"/>', '<pulley divisor="2"/><site site="reel"/>')
    marks = drawn(branches, POSES)["pull"].marks
    assert [mark.shape for mark in marks] == ["line", "line"]
    assert [len(mark.at[0]) for mark in marks] == [4, 4]


def test_a_tendon_that_touches_a_geom_on_the_way_is_one_line_with_as_many_points_at_every_pose():
    drum = '<geom name="drum" type="cylinder" size="0.05 0.05" zaxis="0 1 0" contype="0" conaffinity="0"/><site name="reel"'
    around = replaced(ROPED, '<site name="reel"', drum).replace('<site site="guide"/>', '<geom geom="drum"/>')
    straight, touching = np.array([[0.0, 0.0], [-1.5, 0.0]])  # at the second pose the drum lies between the reel and the tip
    (mark,) = drawn(around, np.array([straight, touching]))["pull"].marks
    points = np.array(mark.at, dtype=float).reshape(2, 4, 2)
    np.testing.assert_allclose(points[0], [[0, 0.2], [0.5, 0], [0.5, 0], [0.5, 0]], atol=SHOWN)
    np.testing.assert_allclose(np.linalg.norm(points[1, 1:3], axis=1), 0.05, atol=SHOWN)


def test_a_site_s_force_is_an_arrow_there_that_turns_with_its_link():
    (mark,) = drawn(ROPED, POSES)["thrust"].marks
    assert mark.shape == "arrow"
    np.testing.assert_allclose(np.array(mark.at, dtype=float), places(ROPED, "tip") @ PLANE.T, atol=SHOWN)
    angle = POSES.sum(axis=1)
    np.testing.assert_allclose(mark.axis, np.stack([np.sin(angle), -np.cos(angle)], axis=1), atol=5 * SHOWN)


def test_a_fixed_tendon_turns_each_of_its_joints_its_own_way():
    marks = drawn(GRIPPER, load_mechanism(GRIPPER).home[None])["grip"].marks
    assert [mark.shape for mark in marks] == ["arc", "arc"]
    right, left = (mark.axis[0][0] for mark in marks)
    assert right == pytest.approx(-left)
    assert abs(right) == 1


def test_an_arc_that_the_drawing_sees_from_its_side_is_left_out():
    across = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert drawn(GRIPPER, load_mechanism(GRIPPER).home[None], across)["grip"].marks == []
    assert len(drawn(GRIPPER, load_mechanism(GRIPPER).home[None], np.eye(3))["grip"].marks) == 2
