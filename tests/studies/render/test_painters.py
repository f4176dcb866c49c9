"""What is drawn: MuJoCo's renderer where there is OpenGL, Matplotlib where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.errors import LinkplanError
from linkplan.studies.render.caption import frame_lines, written
from linkplan.studies.render.flat_painter import flat_painter
from linkplan.studies.render.framing import FOOT_MARGIN, framed, own_direction
from linkplan.studies.render.gl import find_gl
from linkplan.studies.render.scenes import all_points, coloured_model, film_scenes
from tests.support.linkages import RSSR
from tests.support.pictures import N, waved

SIZE = (160, 120)


def by_mujoco(motion, instants) -> list[np.ndarray]:
    from linkplan.studies.render.mujoco_painter import mujoco_painter

    gl = find_gl(None)
    if gl.name is None:
        pytest.skip(f"no OpenGL here: {gl.why_not}")
    direction = own_direction(motion.mechanism.model)
    points = all_points(motion, direction)
    eye = framed(points, *direction, np.radians(45.0), SIZE[0] / SIZE[1])
    with mujoco_painter(coloured_model(motion.mechanism), gl.name, SIZE, eye, points) as painter:
        return [painter.paint(scene) for scene in film_scenes(motion, np.array(instants), direction)]


def by_matplotlib(motion, instants) -> list[np.ndarray]:
    scenes = film_scenes(motion, np.array(instants), own_direction(motion.mechanism.model))
    return [flat(motion).paint(scene) for scene in scenes]


def flat(motion):
    direction = own_direction(motion.mechanism.model)
    return flat_painter(all_points(motion, direction), direction, SIZE, FOOT_MARGIN, motion.mechanism)


@pytest.mark.parametrize("paint", [by_mujoco, by_matplotlib])
@pytest.mark.parametrize("source", ["optimus-knee", RSSR])
def test_the_mechanism_is_on_white_within_the_picture_and_moves(paint, source):
    first, later = paint(waved(source, 0.3, 0.1), (0, N // 2))
    assert first.shape == (SIZE[1], SIZE[0], 3)
    border = np.concatenate([first[[0, -1]].reshape(-1, 3), first[:, 0]])
    assert np.mean(np.all(border >= 250, axis=1)) > 0.9
    inked = np.any(first < 200, axis=2)
    assert 0.005 < inked.mean() < 0.7
    assert np.mean(np.any(np.abs(first.astype(int) - later) > 40, axis=2)) > 0.01


def test_pins_on_the_ground_are_drawn_where_there_is_nothing_else_of_it():
    motion = waved("optimus-knee", 0.3, 0.0)
    (scene,) = film_scenes(motion, np.array([0]), own_direction(motion.mechanism.model))
    bare = replace(scene, figures=tuple(replace(figure, ground=()) for figure in scene.figures))
    image, without = flat(motion).paint(scene), flat(motion).paint(bare)
    pins = image[np.any(image != without, axis=2)].astype(int)
    assert np.sum(np.ptp(pins, axis=1) < 12) > 5


@pytest.mark.parametrize("paint", [by_mujoco, by_matplotlib])
def test_an_effort_at_its_limit_is_seen_in_red(paint):
    none, all_of_it = paint(waved("five-bar", 0.1, 0.0), (0, N - 1))

    def red(image: np.ndarray) -> int:
        r, g, b = np.moveaxis(image.astype(int), 2, 0)
        return int(np.sum((r > 150) & (g < 70) & (b < 90)))

    assert red(none) < 10
    assert red(all_of_it) > 60


@pytest.mark.parametrize("paint", [by_mujoco, by_matplotlib])
def test_the_ghost_is_seen_in_violet_only_where_the_motion_is_astray(paint):
    exact, astray = paint(waved("optimus-knee", 0.3, 0.3), (N // 4, N - 1))

    def violet(image: np.ndarray) -> int:
        r, g, b = np.moveaxis(image.astype(int), 2, 0)
        return int(np.sum((b > g + 40) & (r > g + 20)))

    assert violet(astray) > 10 * max(violet(exact), 5)


def test_words_are_written_into_the_upper_left_corner():
    motion = waved("optimus-knee")
    blank = np.full((240, 320, 3), 255, dtype=np.uint8)
    lines = frame_lines(motion, N - 1, 25.0)
    assert lines[0][0] == "t = 0.200 s  25x slower"
    assert lines[1][0] == "act_O: 100 of 100 N.m"
    image = written(blank, lines, "foot")
    assert np.any(image[:60, :160] < 100)
    assert np.all(image[80:200] == 255)


@pytest.mark.parametrize("asked", ["disable", "off", "0"])
def test_opengl_that_is_switched_off_is_not_looked_for(asked):
    gl = find_gl(asked)
    assert gl.name is None
    assert asked in gl.why_not


def test_opengl_that_fails_says_why(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":7777")
    gl = find_gl("glfw")
    assert gl.name is None
    assert "glfw" in gl.why_not


def test_a_name_of_no_opengl_is_refused_with_those_there_are():
    with pytest.raises(LinkplanError, match=r"MUJOCO_GL is .* or disable, got 'vulkan'"):
        find_gl("vulkan")
