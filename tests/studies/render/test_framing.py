"""Films: which instants are shown, and where the camera stands."""

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.render.camera import camera_from
from linkplan.studies.render.framing import FOOT_MARGIN, SIDE_MARGIN, axes_of, framed, own_direction
from linkplan.studies.render.motion import frame_times, own_slowness
from linkplan.studies.render.render import picture
from linkplan.studies.render.settings import RenderSettings
from tests.support.linkages import RSSR
from tests.support.pictures import PERIOD_S, waved

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


def test_a_films_frames_are_evenly_spaced_from_the_beginning_to_the_end():
    times = frame_times(0.16, 25.0, 25.0)
    assert len(times) == 101
    assert times[[0, -1]] == pytest.approx([0.0, 0.16])
    assert np.diff(times) == pytest.approx(0.0016)


def test_the_end_is_shown_even_where_no_frame_falls_on_it():
    times = frame_times(0.1, 1.0, 25.0)
    assert times[-1] == pytest.approx(0.1, abs=0.02)
    assert times[-1] >= 0.08
    assert np.all(np.diff(times) > 0)


def test_a_motion_that_repeats_itself_leaves_out_the_end_which_is_the_beginning():
    times = frame_times(0.25, 4.0, 25.0, repeats=True)
    assert len(times) == 25
    assert times[-1] == pytest.approx(0.25 - 0.01)


def test_too_many_frames_are_refused_with_how_many_there_would_be():
    with pytest.raises(ProblemError, match=r"2\.?\d*.* s, 1e\+06 times slower .* frames; at most 20000"):
        frame_times(2.0, 1e6, 25.0)


@pytest.mark.parametrize(("duration", "slow"), [(4.0, 1.0), (100.0, 1.0), (2.0, 2.0), (0.4, 10.0), (0.004, 1000.0)])
def test_a_short_motion_is_slowed_down_to_some_seconds_by_a_round_factor(duration, slow):
    assert own_slowness(duration) == pytest.approx(slow)


def test_an_instant_is_the_control_period_that_it_falls_into():
    motion = waved("optimus-knee")
    assert [motion.index_at(t) for t in (0.0, 2.5 * PERIOD_S, 3 * PERIOD_S, 99.0)] == [0, 2, 3, len(motion.time_s) - 1]


def test_a_picture_of_an_instant_after_the_run_is_refused_with_its_end():
    motion = waved("optimus-knee")
    asked = RenderSettings(suffix=".png", at_s=99.0)
    with pytest.raises(ProblemError, match=f"ends at {motion.time_s[-1]:.4g} s; there is no picture of it at 99 s"):
        picture(motion, None, asked, None)
