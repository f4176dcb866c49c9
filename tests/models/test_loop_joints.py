"""Closures of a URDF that are written wrong are refused by name; what is not read of them is named."""

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import LinkplanError
from tests.support.four_bar_urdf import CUT, FOUR_BAR, FRAMES, LOOP_JOINT, robot, written


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('rpy="0 0 0"/><link2', 'rpy="0 0"/><link2', "loop_joint 'B' has link1 rpy = '0 0'; it takes 3 numbers"),
        ('xyz="0 0 0.15"', 'xyz="0 0 nan"', "loop_joint 'B' has link2 xyz = '0 0 nan'"),
        ('xyz="0 1 0"', 'xyz="0 1 a"', "loop_joint 'B' has axis xyz = '0 1 a'"),
        ('xyz="0 1 0"', 'xyz="0 0 0"', "loop_joint 'B' has axis xyz = '0 0 0', which has no direction"),
        ('type="continuous"', 'type="prismatic"', "unknown type of loop_joint 'B' 'prismatic'; legal: revolute"),
        ("<axis", "<axis/><axis", "loop_joint 'B' has 2 <axis>"),
        ("<link2", "<link1/><link2", "loop_joint 'B' has 2 <link1>"),
        ("<link2", "<link3", "loop_joint 'B' has no <link2>"),
        ('link="rocker"', 'link="coupler"', "loop_joint 'B' has link1 and link2 = 'coupler'"),
    ],
)
def test_a_loop_joint_that_closes_no_loop_is_refused_by_name_and_attribute(old, new, said):
    assert old in LOOP_JOINT
    with pytest.raises(LinkplanError) as refused:
        linkplan.load_mechanism(robot(FOUR_BAR, LOOP_JOINT.replace(old, new)))
    assert said in str(refused.value)


def test_what_is_not_read_of_a_loop_joint_is_named():
    loop = LOOP_JOINT.replace("<axis", '<limit lower="0"/><axis').replace('rpy="0 0 0"/><link2', 'rpx="1"/><link2')
    mechanism = linkplan.load_mechanism(robot(FOUR_BAR, loop))
    assert "left out of loop_joint 'B': <limit>, rpx of <link1>" in mechanism.notes


def test_the_length_of_a_loop_joints_axis_does_not_matter():
    first, *others = (
        linkplan.load_mechanism(robot(FOUR_BAR, LOOP_JOINT.replace('xyz="0 1 0"', f'xyz="0 {length} 0"')))
        for length in ("1", "1e-200", "1e200")
    )
    for other in others:
        np.testing.assert_allclose(other.model.site_pos, first.model.site_pos, atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new"), [("[0, 2, 0]", "[0, 0, 0]"), ("[0, 2, 0]", "[0, .inf, 0]"), ("[0.2, 0", "[.nan, 0")]
)
def test_a_cut_hinge_without_an_axis_or_a_point_is_refused(tmp_path, old, new):
    assert old in CUT
    (tmp_path / "loop_closures.yaml").write_text(CUT.replace(old, new), encoding="utf-8")
    with pytest.raises(LinkplanError, match=r"closure coupler-rocker has (axis|point) = "):
        linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR)))


def test_a_closing_frame_without_its_other_half_is_refused(tmp_path):
    frames = FRAMES.replace("end_A", "lonely").replace("end_B", "closing_pin_2")
    with pytest.raises(LinkplanError, match="'closing_pin_1'"):
        linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR, frames)))
