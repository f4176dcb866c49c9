"""Joints' ranges: what is left of them beside a margin, within which MuJoCo pushes back."""

import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.models.digest import part_hashes
from linkplan.models.errors import ModelError, ProblemError

ARM = """<mujoco><option gravity="0 0 0"/><worldbody><body name="arm">
<joint name="J" axis="0 1 0" range="-90 60" limited="true" {margin}/><geom size="0.05" pos="0.3 0 0"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-4 4"/></actuator></mujoco>"""


def arm(margin: str) -> str:
    return ARM.format(margin=margin)


def test_a_margin_is_no_part_of_a_joints_free_range():
    mechanism = linkplan.load_mechanism(arm('margin="0.1"'))
    (joint,) = mechanism.joints
    assert (joint.lower, joint.upper) == pytest.approx((np.radians(-90) + 0.1, np.radians(60) - 0.1))


@pytest.mark.parametrize(("inside_rad", "pushed"), [(0.001, False), (-0.001, True)])
def test_mujoco_pushes_back_where_the_free_range_ends(inside_rad, pushed):
    mechanism = linkplan.load_mechanism(arm('margin="0.1"'))
    model = mujoco.MjModel.from_xml_string(arm('margin="0.1"'))
    data = mujoco.MjData(model)
    data.qpos[0] = mechanism.joints[0].upper - inside_rad
    mujoco.mj_forward(model, data)
    assert bool(np.any(data.qacc)) == pushed


def test_a_goal_within_the_margin_is_refused():
    mechanism = linkplan.load_mechanism(arm('margin="0.1"'))
    with pytest.raises(ProblemError, match=r"J = 58 deg is beyond reach.*54.27"):
        linkplan.Problem.reach(mechanism, start_deg={"J": 0}, goal_deg={"J": 58}, duration_s=1.0)


def test_a_margin_that_leaves_nothing_is_refused_in_one_line():
    with pytest.raises(ModelError, match="leaves joint J no position"):
        linkplan.load_mechanism(arm('margin="1.5"'))


def test_a_margin_changes_the_fingerprint_and_none_does_not():
    without, zero, some = (part_hashes(mujoco.MjModel.from_xml_string(arm(m))) for m in ("", 'margin="0"', 'margin="0.1"'))
    assert without == zero
    assert {part for part in some if some[part] != zero[part]} == {"joints"}
