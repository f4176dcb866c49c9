"""Films read back by the library that wrote them, and by others."""

import av
import numpy as np
import pytest
from matplotlib.colors import rgb_to_hsv, to_rgb
from PIL import Image, ImageSequence

from linkplan.planner.files.single_file import MADE_BY
from linkplan.planner.files.tables import read_tables
from linkplan.studies.demo.draw_animations import FOLDER, LARGE_BYTES, SMALL_BYTES
from linkplan.studies.demo.draw_gallery import SHOWN
from linkplan.studies.output.figure import SERIES
from linkplan.studies.render.film_file import write_gif, write_mp4, write_png
from linkplan.studies.render.shapes import GHOST, load_colour

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
