"""The animations of the pages: one for each mechanism, small enough, going on without a jump."""

import numpy as np
import pytest
from matplotlib.colors import rgb_to_hsv
from PIL import Image, ImageSequence

from linkplan.planner.files.tables import read_tables
from linkplan.studies.demo.draw_animations import FOLDER, LARGE_BYTES, SMALL_BYTES
from linkplan.studies.demo.draw_gallery import SHOWN

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
