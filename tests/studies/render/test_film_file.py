"""Films: instants, cameras, and files of every kind."""

import av
import numpy as np
import pytest
from matplotlib.colors import rgb_to_hsv, to_rgb
from PIL import Image, ImageSequence

from docs.tools.draw_animations import FOLDER, LARGE_BYTES, SMALL_BYTES
from docs.tools.draw_gallery import SHOWN
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.files.single_file import MADE_BY
from linkplan.planner.files.tables import read_tables
from linkplan.studies.output.figure import SERIES
from linkplan.studies.render.film_file import write_gif, write_mp4, write_png
from linkplan.studies.render.framing import FOOT_MARGIN, SIDE_MARGIN, axes_of, framed, own_direction
from linkplan.studies.render.motion import frame_times, own_slowness
from linkplan.studies.render.render import camera_from, picture
from linkplan.studies.render.settings import RenderSettings
from linkplan.studies.render.shapes import GHOST, load_colour
from tests.support.linkages import RSSR
from tests.support.pictures import PERIOD_S, waved
from tests.support.refusals import assert_refused

WIDTH, HEIGHT, MANY = 96, 64, 30


def frames() -> list[np.ndarray]:
    """Return images with a dark square that goes from left to right."""
    found = []
    for k in range(MANY):
        image = np.full((HEIGHT, WIDTH, 3), 255, dtype=np.uint8)
        image[20:40, 2 * k : 2 * k + 20] = (200, 30, 30)
        found.append(image)
    return found


def square(image: np.ndarray) -> float:
    """Return where the square's middle is [px from the left]."""
    return float(np.mean(np.nonzero(np.any(image < 128, axis=2))[1]))


def test_an_mp4_has_the_frames_the_size_and_the_duration_that_went_in(tmp_path):
    path = tmp_path / "film.mp4"
    write_mp4(path, frames(), 25.0)
    with av.open(str(path)) as film:
        stream = film.streams.video[0]
        assert (stream.width, stream.height, stream.codec_context.name) == (WIDTH, HEIGHT, "h264")
        assert stream.pix_fmt == "yuv420p"
        assert film.duration / av.time_base == pytest.approx(MANY / 25.0, abs=1e-3)
        found = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(found) == MANY
    assert [square(image) for image in found] == pytest.approx([square(image) for image in frames()], abs=1.0)


def test_a_gif_has_the_frames_goes_on_for_ever_and_lasts_as_long(tmp_path):
    path = tmp_path / "film.gif"
    write_gif(path, frames(), MANY, 15.0, frames()[::10])
    with Image.open(path) as film:
        assert film.size == (WIDTH, HEIGHT)
        assert film.info["loop"] == 0
        shown = [(square(np.array(one.convert("RGB"))), one.info["duration"]) for one in ImageSequence.Iterator(film)]
    assert len(shown) == MANY
    assert sum(duration for _, duration in shown) == pytest.approx(1000 * MANY / 15.0, abs=10)
    assert [at for at, _ in shown] == pytest.approx([square(image) for image in frames()], abs=0.5)


def test_a_gif_keeps_the_colours_of_thin_rods_before_a_shaded_floor(tmp_path):
    height, width = 240, 320
    y, x = np.mgrid[:height, :width]
    floor = 120 + 90 * y / height + 20 * np.sin(x / 9.0) * np.cos(y / 7.0)  # hundreds of greys, as under MuJoCo's headlight
    image = np.repeat(floor[..., None], 3, axis=2) + np.array([0.0, 2.0, 9.0])
    inks = [*SERIES, GHOST[:3], load_colour(1.0)[:3]]
    for k, ink in enumerate(inks):
        image[20 + 22 * k : 24 + 22 * k, 40:100] = 255 * np.array(to_rgb(ink))
    image = image.astype(np.uint8)
    path = tmp_path / "film.gif"
    write_gif(path, [image, image], 2, 15.0, [image])
    with Image.open(path) as film:
        found = np.array(film.convert("RGB")).astype(int)
    for k, ink in enumerate(inks):
        off = np.abs(found[22 + 22 * k, 70] - image[22 + 22 * k, 70]).max()
        assert off < 25, f"{ink} is off by {off} of 255 levels"
    assert np.abs(found - image).mean() < 6  # the floor is still one


def test_a_png_is_the_image_itself(tmp_path):
    path = tmp_path / "picture.png"
    write_png(path, frames()[3])
    with Image.open(path) as picture:
        assert np.array_equal(np.array(picture), frames()[3])


@pytest.mark.parametrize("kind", ["mp4", "gif", "png"])
def test_every_file_says_who_made_it(kind, tmp_path):
    path = tmp_path / f"film.{kind}"
    write = {
        "mp4": lambda: write_mp4(path, frames(), 25.0),
        "gif": lambda: write_gif(path, frames(), MANY, 25.0, frames()[:1]),
        "png": lambda: write_png(path, frames()[0]),
    }
    write[kind]()
    assert MADE_BY.encode() in path.read_bytes()


# The ends [deg] of the hues of the knee's bodies, of the plan's ghost and of an effort at its limit.
HUES_DEG = {"orange": (10, 45), "green": (130, 175), "blue": (195, 225), "violet": (262, 295), "red": (345, 360)}
ANIMATIONS = ["knee-reach", *(read_tables(name)[1]["mechanism"]["model"] for name in SHOWN)]


@pytest.mark.parametrize("name", ANIMATIONS)
def test_an_animation_is_small_and_goes_on_for_ever(name):
    path = FOLDER / f"{name}.gif"
    assert path.stat().st_size <= (LARGE_BYTES if name == "knee-reach" else SMALL_BYTES)
    with Image.open(path) as film:
        assert film.info["loop"] == 0
        assert film.n_frames > 30
        assert max(film.size) == (480 if name == "knee-reach" else 320)


def test_the_first_picture_of_the_readme_has_its_colours():
    with Image.open(FOLDER / "knee-reach.gif") as film:
        frames = np.array([np.array(one.convert("RGB")) for one in ImageSequence.Iterator(film)])
    coloured = frames[np.ptp(frames, axis=-1) > 70]
    hues = 360 * rgb_to_hsv(coloured / 255)[:, 0]
    for name, (low, high) in HUES_DEG.items():
        assert np.sum((hues > low) & (hues < high)) > 5_000, f"{name} is missing"


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
    assert_refused(lambda: camera_from(text, load_mechanism("optimus-knee")), *words, kind=ProblemError)


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
    with pytest.raises(ProblemError, match=r"2\.?\d*.* s, 1e\+06 times slower .* frames; the limit is 20000"):
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
    with pytest.raises(ProblemError, match=f"ends at {motion.time_s[-1]:.4g} s; a picture at 99 s is not possible"):
        picture(motion, None, asked, None)
