"""The animations of the pages: one for each mechanism, small enough, going on without a jump."""

import pytest
from PIL import Image

from linkplan.planner.files.tables import read_tables
from linkplan.studies.demo.draw_animations import FOLDER, LARGE_BYTES, SMALL_BYTES
from linkplan.studies.demo.draw_gallery import SHOWN

ANIMATIONS = ["knee-reach", *(read_tables(name)[1]["mechanism"]["model"] for name in SHOWN)]


@pytest.mark.parametrize("name", ANIMATIONS)
def test_an_animation_is_small_and_goes_on_for_ever(name):
    path = FOLDER / f"{name}.gif"
    assert path.stat().st_size <= (LARGE_BYTES if name == "knee-reach" else SMALL_BYTES)
    with Image.open(path) as film:
        assert film.info["loop"] == 0
        assert film.n_frames > 30
        assert max(film.size) == (480 if name == "knee-reach" else 320)
