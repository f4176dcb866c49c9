"""Where the eye stands: everything in the picture, as large as it goes, from the mechanism's own side."""

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.render.camera import camera_from
from linkplan.studies.render.framing import FOOT_MARGIN, SIDE_MARGIN, axes_of, framed, own_direction
from tests.support.linkages import RSSR

FOVY = np.radians(45.0)


def on_picture(points, eye, aspect: float) -> np.ndarray:
    """Return where points (n, 3) stand in the picture (n, 2): -1 to 1 from side to side and from foot to top."""
    right, up, sight = axes_of(eye.azimuth, eye.elevation)
    seen = points - (eye.target - eye.distance * sight)
    deep = seen @ sight * np.tan(FOVY / 2)
    return np.stack([seen @ right / (deep * aspect), seen @ up / deep], axis=1)


@pytest.mark.parametrize("direction", [(90, -10), (125, -20), (0, -89), (-30, 45)])
@pytest.mark.parametrize("aspect", [0.5, 4 / 3, 3.0])
def test_all_points_are_in_the_picture_and_one_is_at_its_margin(direction, aspect):
    points = np.random.default_rng(7).normal(size=(40, 3)) * [0.3, 0.1, 0.2] + [5.0, 0.0, 1.0]
    eye = framed(points, *np.radians(direction), FOVY, aspect, head=0.2)
    x, y = on_picture(points, eye, aspect).T
    rooms = [(1 - 2 * SIDE_MARGIN) - np.abs(x).max(), (1 - 2 * 0.2) - y.max(), y.min() + (1 - 2 * FOOT_MARGIN)]
    assert min(rooms) == pytest.approx(0.0, abs=1e-9)


def test_a_planar_mechanism_is_seen_along_its_hinges_from_a_little_above():
    azimuth, elevation = own_direction(load_mechanism("optimus-knee").model)
    assert np.degrees([azimuth, elevation]) == pytest.approx([90.0, -10.0])


def test_a_mechanism_in_a_level_plane_is_seen_from_above():
    lying = """<mujoco><worldbody><body><joint axis="0 0 1"/><geom size=".1" pos="1 0 0"/>
      <body pos="1 0 0"><joint axis="0 0 1"/><geom size=".1" pos="1 0 0"/></body></body></worldbody></mujoco>"""
    _, elevation = own_direction(load_mechanism(lying).model)
    assert np.degrees(elevation) == pytest.approx(-70.0, abs=1e-6)


def test_a_spatial_mechanism_is_seen_from_the_side_and_above():
    azimuth, elevation = own_direction(load_mechanism(RSSR).model)
    assert abs(np.sin(2 * azimuth)) > 0.5
    assert elevation < 0


def test_right_up_and_sight_are_as_mujoco_counts_azimuth_and_elevation():
    right, up, sight = axes_of(np.radians(90.0), 0.0)
    assert sight == pytest.approx([0, 1, 0])
    assert right == pytest.approx([1, 0, 0])
    assert up == pytest.approx([0, 0, 1])
    right, up, sight = axes_of(0.3, -0.4)
    assert np.cross(right, up) == pytest.approx(-sight)


def test_a_camera_is_a_name_or_two_angles():
    knee = load_mechanism("optimus-knee")
    assert camera_from("30/-15", knee).direction == pytest.approx(tuple(np.radians([30.0, -15.0])))
    side = camera_from("side", knee)
    assert side.fixed == 0
    assert np.degrees(side.direction) == pytest.approx([90.0, 0.0], abs=1e-6)


@pytest.mark.parametrize(("text", "words"), [("sid", ["did you mean 'side'"]), ("30", ["30"]), ("0/120", ["-90 to 90"])])
def test_what_is_no_camera_is_refused_with_those_there_are(text, words):
    with pytest.raises(ProblemError) as refusal:
        camera_from(text, load_mechanism("optimus-knee"))
    assert all(word in str(refusal.value) for word in words)
