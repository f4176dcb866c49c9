"""Angles of bodies: the sum of hinges, against MuJoCo's orientation of the body and a closed form of a four-bar."""

import mujoco
import numpy as np
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.body_angles import body_index, sum_text, turning, turning_bodies
from tests.support.polycentric import KNEE, shank_deg
from tests.support.refusals import assert_names, refusal

# Hinges about one line, both ways, with a slide between them; and a base that is not at the reference pose at zero.
MASS = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
BOTH_WAYS = f"""<mujoco><option gravity="0 0 0"/><worldbody>
<body name="thigh" quat="0.8 0 0.6 0"><joint name="hip" axis="0 1 0" ref="10"/>{MASS}
<body name="tube" pos="0 0 -0.4"><joint name="s" type="slide" axis="0 0 1"/>{MASS}
<body name="shank" pos="0 0 -0.4" quat="0.6 0 0.8 0"><joint name="knee" axis="0 -2 0"/>{MASS}
<body name="shoe" pos="0 0 1">{MASS}</body></body></body></body></worldbody>
<actuator><motor joint="hip"/><motor joint="knee"/><motor joint="s"/></actuator></mujoco>"""
PAIR = f"""<mujoco><worldbody><body name="a"><joint name="one" %s/>{MASS}
<body name="b"><joint name="two" %s/>{MASS}</body></body></worldbody><actuator><motor joint="one"/></actuator></mujoco>"""
ABOUT_Y, ALONG_Y = 'axis="0 1 0"', 'type="slide" axis="0 1 0"'


def turned_by_mujoco(mechanism, body: str, q: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) [rad] of a body from its orientation at q = 0, by MuJoCo."""
    model, data = mechanism.model, mujoco.MjData(mechanism.model)
    frames = []
    for pose in (np.zeros(mechanism.n_q), q):
        data.qpos[:] = mechanism.qpos_of(pose)
        mujoco.mj_kinematics(model, data)
        frames.append(np.array(data.xmat[model.body(body).id]).reshape(3, 3))
    quaternion, found = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, (frames[1] @ frames[0].T).ravel())
    mujoco.mju_quat2Vel(found, quaternion, 1.0)
    return found


@pytest.mark.parametrize("body", ["thigh", "tube", "shank", "shoe"])
def test_the_angle_is_mujocos_turn_of_the_body_about_its_first_hinge(body):
    mechanism = load_mechanism(BOTH_WAYS)
    q = np.array([0.4, 0.1, -0.9])
    angle = turning(mechanism, mechanism.model.body(body).id, "the angle") @ q
    assert abs(angle) > 0.3
    np.testing.assert_allclose(turned_by_mujoco(mechanism, body, q), [0.0, angle, 0.0], atol=1e-12)


def test_a_hinge_about_the_opposite_axis_counts_backwards():
    mechanism = load_mechanism(BOTH_WAYS)
    assert {name: sum_text(mechanism, sigma) for name, sigma in turning_bodies(mechanism).items()} == {"shank": "hip - knee"}


@pytest.mark.parametrize("rear_deg", [-30.0, -10.0, 20.0, 35.0])
def test_the_shank_of_a_polycentric_knee_turns_as_the_closed_form_of_its_four_bar(rear_deg):
    mechanism = load_mechanism(KNEE)
    q = close_at(mechanism, np.radians([rear_deg]))
    expected = float(shank_deg(np.array(rear_deg)))
    assert abs(expected) > 5, "not a parallelogram"
    assert np.degrees(turning_bodies(mechanism)["shank"] @ q) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(
    ("joints", "body", "words"),
    [
        ((ABOUT_Y, 'axis="0 1 0.1"'), "b", ["'b'", "no single angle", "'one'", "'two'", "not parallel"]),
        ((ABOUT_Y, 'type="ball"'), "b", ["'b'", "no single angle", "ball joint 'two'"]),
        ((ALONG_Y, ABOUT_Y), "a", ["'a'", "no hinge"]),
        ((ABOUT_Y, ABOUT_Y), "d", ["'d'", "legal: a, b"]),
    ],
    ids=["skew", "ball", "slide", "unknown"],
)
def test_a_body_without_a_single_angle_is_refused_in_one_line(joints, body, words):
    mechanism, what = load_mechanism(PAIR % joints), "limits.body_deg"
    said = refusal(lambda: turning(mechanism, body_index(mechanism.model, body, what), what), ModelError)
    assert_names(said, what, *words)


def test_axes_that_differ_by_the_rounding_of_a_file_are_parallel():
    mechanism = load_mechanism(PAIR % (ABOUT_Y, 'axis="0 1 1e-7"'))
    assert np.array_equal(turning(mechanism, mechanism.model.body("b").id, "the angle"), [1.0, 1.0])
