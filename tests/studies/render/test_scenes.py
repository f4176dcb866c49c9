"""What is in a picture, before anybody draws it: skeletons, ghost, efforts, colours."""

import itertools

import mujoco
import numpy as np
import pytest

from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.output.body_colours import PAYLOAD, body_colours
from linkplan.studies.render.caption import frame_lines, written
from linkplan.studies.render.efforts import effort_shapes, load_shares
from linkplan.studies.render.framing import FOOT_MARGIN, framed, own_direction
from linkplan.studies.render.gl import find_gl
from linkplan.studies.render.render import flat_painter
from linkplan.studies.render.scenes import (
    all_points,
    coloured_model,
    film_scenes,
    place_bodies,
    skeletons,
    stroboscopic_scene,
)
from linkplan.studies.render.shapes import GHOST, load_colour
from tests.support.linkages import GRIPPER, RSSR
from tests.support.pictures import N, rods, waved
from tests.support.tolerances_planner import ROUNDING

SHOWN = ["optimus-knee", "slider-crank", "five-bar", "andrews-squeezer", RSSR]

# What moves by this share of the mechanism's size is seen to move.
VISIBLE = 0.003


def scenes(source: str, instants=(0, N // 4, N - 1)):
    motion = waved(source, 0.1, 0.1)
    return film_scenes(motion, np.array(instants), own_direction(motion.mechanism.model))


@pytest.mark.parametrize("source", SHOWN)
def test_frames_differ_along_the_motion(source):
    first, later, last = (rods(scene, -1) for scene in scenes(source))
    visible = VISIBLE * load_mechanism(source).extent_m
    assert np.abs(later - first).max() > visible
    assert np.abs(last - later).max() > visible


@pytest.mark.parametrize("source", SHOWN)
def test_the_ghost_coincides_with_the_mechanism_where_it_is_tracked_exactly_and_parts_where_it_is_not(source):
    exact, astray = scenes(source, (N // 4, N - 1))
    assert np.abs(rods(exact, 0) - rods(exact, -1)).max() < ROUNDING
    assert np.abs(rods(astray, 0) - rods(astray, -1)).max() > VISIBLE * load_mechanism(source).extent_m


def test_the_ghost_is_translucent_and_the_mechanism_is_not():
    (scene,) = scenes("optimus-knee", (0,))
    assert {shape.rgba for shape in scene.figures[0].shapes} == {GHOST}
    assert 0 < GHOST[3] < 1
    assert {shape.rgba[3] for shape in scene.figures[-1].shapes} == {1.0}


def test_the_skeleton_stands_on_the_models_own_sites():
    motion = waved("optimus-knee")
    (scene,) = film_scenes(motion, np.array([7]), (0.0, 0.0))
    data = mujoco.MjData(motion.mechanism.model)
    place_bodies(motion.mechanism.model, data, motion.mechanism.qpos_of(motion.pose[7]))
    ends = rods(scene, -1).reshape(-1, 3)
    for site in ("O", "C", "B_coupler"):
        assert np.linalg.norm(ends - data.site(site).xpos, axis=1).min() < ROUNDING, site


def test_a_mechanism_without_geoms_is_drawn_as_its_skeleton_in_a_colour_for_each_body():
    mechanism = load_mechanism(RSSR)
    colours = body_colours(mechanism)
    moving = [colours[body] for body in range(1, mechanism.model.nbody)]
    assert len(set(moving)) == len(moving) == 3


def test_an_efforts_colour_runs_from_grey_to_red_as_it_nears_its_limit():
    def redness(share: float) -> float:
        red, green, blue, _ = load_colour(share)
        return red - 0.5 * (green + blue)

    at = [redness(share) for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    assert at[0] == pytest.approx(0.0, abs=1e-12)
    assert np.all(np.diff(at) > 0.1)
    assert load_colour(-0.5) == load_colour(0.5)
    assert load_colour(3.0) == load_colour(1.0)


def test_an_effort_is_a_share_of_the_limit_on_its_own_side_or_of_its_peak_without_one():
    limit = np.array([[-10.0, 20.0], [-np.inf, np.inf], [0.0, 5.0]])
    shares = load_shares(np.array([[-5.0, 3.0, 5.0], [5.0, -6.0, 0.0]]), limit, np.array([5.0, 6.0, 5.0]))
    assert shares == pytest.approx(np.array([[-0.5, 0.5, 1.0], [0.25, -1.0, 0.0]]))


def drawn_effort(mechanism, share: float, pose: np.ndarray | None = None, actuator: int = 0):
    """Return the shapes of an actuator's effort, seen along y, and MuJoCo's data at the pose."""
    data = mujoco.MjData(mechanism.model)
    place_bodies(mechanism.model, data, mechanism.qpos_of(mechanism.home if pose is None else pose))
    seen = np.array([0.0, -1.0, 0.0])
    return effort_shapes(mechanism.model, data, mechanism.actuators[actuator], share, 1.0, seen), data


@pytest.mark.parametrize("share", [-1.0, -0.4, 0.2, 0.9])
def test_an_arc_goes_round_the_axis_as_far_as_the_share_of_the_limit_and_to_its_side(share):
    mechanism = load_mechanism("optimus-knee")
    shapes, data = drawn_effort(mechanism, share)
    joint = int(mechanism.model.dof_jntid[mechanism.actuators[0].joint])
    points = np.array([shapes[0].start, *[shape.end for shape in shapes]]) - data.xanchor[joint]
    axis = np.array([0.0, 1.0, 0.0])
    flat = points - np.outer(points @ axis, axis)
    turned = [np.arctan2(np.cross(a, b) @ axis, a @ b) for a, b in itertools.pairwise(flat)]
    assert np.sum(turned) == pytest.approx(share * np.radians(270.0), rel=1e-9)


def test_no_effort_is_no_arrow():
    assert drawn_effort(load_mechanism("optimus-knee"), 0.0)[0] == ()


def test_a_force_on_a_slide_is_a_straight_arrow_along_it_from_the_body():
    mechanism = load_mechanism("cart-pole")
    pose = mechanism.home.copy()
    pose[0] = 0.7
    shapes, _ = drawn_effort(mechanism, -0.5, pose)
    way = shapes[-1].end - shapes[0].start
    assert way == pytest.approx([-0.225, 0.0, 0.0])
    assert shapes[0].start[0] == pytest.approx(0.7)


def test_a_fixed_tendons_pull_turns_each_of_its_joints_to_its_own_side():
    mechanism = load_mechanism(GRIPPER)
    (pull,) = (k for k, actuator in enumerate(mechanism.actuators) if actuator.joint is None)
    shapes, _ = drawn_effort(mechanism, 0.5, actuator=pull)
    halves = [np.array([shape.end for shape in shapes[k : k + len(shapes) // 2]]) for k in (0, len(shapes) // 2)]
    sides = [np.sign(half[-1, 0] - half[0, 0]) for half in halves]
    assert sides[0] == -sides[1] != 0


ACTED_ON = {
    "ball joint": ('<joint name="j" type="ball"/>', '<motor joint="j" gear="0 0 1 0 0 0" ctrlrange="-1 1"/>'),
    "free joint": ('<freejoint name="j"/>', '<motor joint="j" gear="0 2 0 0 0 0" ctrlrange="-1 1"/>'),
    "site": ('<joint axis="0 1 0"/>', '<motor site="tip" gear="1 0 0 0 1 0" ctrlrange="-1 1"/>'),
    "slider-crank": (
        '<joint axis="0 1 0"/>',
        '<motor cranksite="tip" slidersite="rail" cranklength="1.3" ctrlrange="-1 1"/>',
    ),
    "tendon": ('<joint axis="0 1 0"/>', '<motor tendon="rope" ctrlrange="-1 1"/>'),
}


@pytest.mark.parametrize("kind", ACTED_ON)
def test_every_kind_of_actuator_is_drawn_in_its_loads_colour_and_otherwise_for_the_other_side(kind):
    joint, motor = ACTED_ON[kind]
    mechanism = load_mechanism(
        f"""<mujoco><compiler autolimits="true"/><worldbody><site name="rail" pos="1 0 0" euler="0 90 0"/>
        <body>{joint}<geom type="capsule" fromto="0 0 0 0 0 1" size=".1"/><site name="tip" pos="0 0 1"/></body></worldbody>
        <tendon><spatial name="rope"><site site="tip"/><site site="rail"/></spatial></tendon>
        <actuator>{motor}</actuator></mujoco>"""
    )
    one, other = (drawn_effort(mechanism, share)[0] for share in (0.8, -0.8))
    assert {shape.rgba for shape in (*one, *other)} == {load_colour(0.8)}
    assert np.all(np.isfinite([[shape.start, shape.end] for shape in one]))
    assert kind == "tendon" or np.abs(one[-1].end - other[-1].end).max() > 0.05


def test_a_tendon_over_a_pulley_is_drawn_between_its_sites_only():
    mechanism = load_mechanism(
        """<mujoco><worldbody><site name="hook" pos="1 0 1"/><site name="eye" pos="1 0.5 1"/><body pos="2 0 0"><joint
        axis="0 1 0"/><geom size="0.1"/><site name="end" pos="0 0 1"/></body></worldbody><tendon><spatial name="rope">
        <site site="hook"/><site site="end"/><pulley divisor="2"/><site site="eye"/><site site="end"/></spatial></tendon>
        <actuator><motor tendon="rope" ctrlrange="-1 0"/></actuator></mujoco>"""
    )
    shapes, _ = drawn_effort(mechanism, -0.5)
    ends = [[*shape.start, *shape.end] for shape in shapes]
    np.testing.assert_allclose(ends, [[1, 0, 1, 2, 0, 1], [1, 0.5, 1, 2, 0, 1]])


def test_several_instants_in_one_picture_grow_stronger_and_the_last_is_whole():
    motion = waved("optimus-knee")
    scene = stroboscopic_scene(motion, np.array([0, 10, 20, 40]), (0.0, 0.0))
    alphas = [figure.alpha for figure in scene.figures]
    assert alphas == sorted(alphas)
    assert alphas[-1] == 1.0 > alphas[-2] > alphas[0] > 0


def test_the_picture_holds_all_that_moves_at_every_instant():
    motion = waved("andrews-squeezer", 0.1, 0.1)
    points = all_points(motion, (0.0, -1.0))
    low, high = points.min(axis=0), points.max(axis=0)
    for scene in film_scenes(motion, np.arange(0, N, 3), (0.0, -1.0)):
        for which in (0, -1):
            ends = rods(scene, which).reshape(-1, 3)
            assert np.all((ends >= low - 1e-4) & (ends <= high + 1e-4))


def test_the_payload_hangs_where_its_mass_is():
    mechanism = load_mechanism("optimus-knee", payload="shank")
    poses = np.stack([mechanism.home, mechanism.home])
    (rod,) = (shape for shape in skeletons(mechanism, poses)[1] if shape.rgba == PAYLOAD)
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(mechanism.home)
    mujoco.mj_kinematics(mechanism.model, data)
    np.testing.assert_allclose(0.5 * (rod.start + rod.end), data.body("linkplan_payload").xipos, atol=1e-9)


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
    return [flat(motion)(scene) for scene in scenes]


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
    (image,) = by_matplotlib(motion, [0])
    pins = image[image.max(axis=2) < 150].astype(int)
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
    with pytest.raises(LinkplanError, match=r"MUJOCO_GL must be .* or disable, got 'vulkan'"):
        find_gl("vulkan")
