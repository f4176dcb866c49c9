"""Bodies and drives of the page's animations."""

import mujoco
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.studies.output.animation import animation, drives_of
from linkplan.studies.output.body_colours import BODY_SERIES, body_colours
from linkplan.studies.output.document import Animation, Drive
from linkplan.studies.output.draw_bodies import draw_bodies
from tests.support.linkages import GRIPPER, loaded
from tests.support.mechanisms import replaced

# Rounding of a page's numbers, of a mechanism of about a metre [m].
SHOWN = 2e-5
TILTED = """<mujoco><worldbody><body name="arm"><joint name="J" axis="0 1 0"/><geom type="box" size="0.1 0.02 0.01"/>
<body name="rod"><joint name="S" type="hinge" axis="1 0 0"/><geom type="box" size="0.3 0.02 0.01"/></body></body></worldbody>
<actuator><motor joint="J" ctrlrange="-1 1"/><motor joint="S" ctrlrange="-1 1"/></actuator></mujoco>"""


def moved(mechanism: Mechanism, swing: float) -> tuple[Animation, np.ndarray]:
    """Return the animation of a swing [rad] of every independent joint from home, and its poses (n, n_q)."""
    time = np.linspace(0.0, 1.0, 21)
    wave = swing * np.sin(2 * np.pi * time)[:, None]
    poses = follow(mechanism, mechanism.home[mechanism.independent] + wave, mechanism.home)
    return animation(mechanism, "", "", time, poses), poses


def middles(mechanism: Mechanism, poses: np.ndarray, body: str) -> np.ndarray:
    """Return the mean position (n, 3) of the centres of a body's geoms, by MuJoCo."""
    model, found = mechanism.model, []
    data = mujoco.MjData(model)
    own = np.flatnonzero(model.geom_bodyid == model.body(body).id)
    for qpos in mechanism.qpos_of(poses):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        found.append(data.geom_xpos[own].mean(axis=0))
    return np.array(found)


def test_flat_shapes_follow_their_bodies():
    mechanism = load_mechanism("optimus-knee")
    shown, poses = moved(mechanism, 0.4)
    assert shown.dimension == 2
    for name in ("crank", "coupler", "rocker"):
        (body,) = (one for one in shown.bodies if one.name == name)
        centres = np.array([np.reshape(shape.points, (-1, 2)).mean(axis=0) for shape in body.shapes]).mean(axis=0)
        rows = np.array(body.places)
        x = rows[:, 0] + rows[:, 2] * centres[0] - rows[:, 3] * centres[1]
        z = rows[:, 1] + rows[:, 3] * centres[0] + rows[:, 2] * centres[1]
        np.testing.assert_allclose(np.stack([x, z], axis=1), middles(mechanism, poses, name)[:, [0, 2]], atol=SHOWN)


def test_shapes_in_space_follow_their_bodies():
    mechanism = loaded("rssr")
    shown, poses = moved(mechanism, 0.3)
    assert shown.dimension == 3
    for name in ("crank", "rod", "rocker"):
        (body,) = (one for one in shown.bodies if one.name == name)
        centres = np.array([np.reshape(shape.points, (-1, 3)).mean(axis=0) for shape in body.shapes]).mean(axis=0)
        turned = np.zeros((len(poses), 3))
        for k, row in enumerate(body.places):
            mujoco.mju_rotVecQuat(turned[k], centres, np.array(row[3:]))
        places = np.array(body.places)[:, :3] + turned
        np.testing.assert_allclose(places, middles(mechanism, poses, name), atol=SHOWN)


def test_quaternions_do_not_jump_between_frames():
    shown, _ = moved(load_mechanism(TILTED), 3.0)
    for body in shown.bodies:
        rows = np.array(body.places)[:, 3:]
        assert (np.sum(rows[1:] * rows[:-1], axis=1) > 0).all()


def test_a_body_that_rolls_about_a_line_of_the_plane_is_drawn_in_space():
    assert moved(load_mechanism(TILTED), 0.3)[0].dimension == 3


def test_every_pin_has_a_name_once():
    shown, _ = moved(load_mechanism("optimus-knee"), 0.2)
    assert [name for name, _ in shown.labels] == ["O", "A", "C", "B"]


def test_sites_at_pins_are_not_drawn_twice():
    shown, _ = moved(load_mechanism("optimus-knee"), 0.2)
    assert [(body.name, [name for name, _ in body.sites]) for body in shown.bodies if body.sites] == [("ground", ["D"])]


def test_the_floor_is_at_its_height():
    assert moved(load_mechanism("optimus-knee"), 0.2)[0].floors == [0.0]


def test_the_body_at_rest_has_one_place():
    shown, _ = moved(load_mechanism("optimus-knee"), 0.2)
    (ground,) = (body for body in shown.bodies if body.fixed)
    assert len(ground.places) == 1
    assert ground.depth == pytest.approx(-0.011, abs=1e-3)  # the thigh, a capsule behind the links, and the ball D


@pytest.mark.parametrize("name", ["optimus-knee", "slider-crank", "andrews-squeezer", "rssr"])
def test_a_body_has_the_same_colour_on_a_page_in_a_figure_and_in_a_film(name):
    mechanism = loaded(name) if name == "rssr" else load_mechanism(name)
    shown, _ = moved(mechanism, 0.05)
    in_film = {mechanism.model.body(k).name: rgba[:3] for k, rgba in body_colours(mechanism).items()}
    axes = Figure().subplots()
    draw_bodies(axes, mechanism, mechanism.home[None], np.ones(1), named=True)
    in_figure = {line.get_label(): to_rgb(line.get_color()) for line in axes.lines if not line.get_label().startswith("_")}
    bodies = [body for body in shown.bodies if not body.fixed]
    assert len(bodies) > 2
    for body in bodies:
        on_page = BODY_SERIES[int(body.colour[1:])] if body.colour.startswith("c") else body.colour
        assert to_rgb(on_page) == pytest.approx(in_film[body.name], abs=0.02), body.name
        assert in_figure[body.name] == pytest.approx(in_film[body.name], abs=0.005), body.name


PLANE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
# Two links with a rope along them by way of a pulley's other branch, and a thruster at the tip, tilted with its link.
ROPED = """<mujoco><compiler angle="degree"/><option gravity="0 0 0"/><worldbody><site name="reel" pos="0 0 0.2"/>
<body name="upper"><joint name="a" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
<site name="guide" pos="0.1 0 0.1"/><body name="lower" pos="0.3 0 0"><joint name="b" axis="0 -1 0"/>
<geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/><site name="tip" pos="0.2 0 0"/></body></body></worldbody>
<tendon><spatial name="rope"><site site="reel"/><site site="guide"/><site site="tip"/></spatial></tendon>
<actuator><motor name="pull" tendon="rope" ctrlrange="-9 0"/><motor name="thrust" site="tip" gear="0 0 -2 0 0 0"
ctrlrange="-3 3"/></actuator></mujoco>"""
POSES = np.radians([[0.0, 0.0], [30.0, -20.0], [60.0, 40.0]])


def drawn(model: str, poses: np.ndarray, frame: np.ndarray = PLANE) -> dict[str, Drive]:
    mechanism = load_mechanism(model)
    effort = np.ones((len(poses), mechanism.n_u))
    return {drive.name: drive for drive in drives_of(mechanism, poses, effort, None, frame)}


def places(model: str, name: str) -> np.ndarray:
    """Return where a site stands at the poses, by MuJoCo (n, 3) [m]."""
    found, data = [], mujoco.MjData(compiled := mujoco.MjModel.from_xml_string(model))
    for pose in POSES:
        data.qpos[:] = pose
        mujoco.mj_kinematics(compiled, data)
        found.append(np.array(data.site(name).xpos))
    return np.array(found)


def test_a_tendon_is_a_line_through_its_sites():
    (mark,) = drawn(ROPED, POSES)["pull"].marks
    assert mark.shape == "line"
    points = np.array(mark.at, dtype=float).reshape(len(POSES), 3, 2)
    for k, name in enumerate(("reel", "guide", "tip")):
        np.testing.assert_allclose(points[:, k], places(ROPED, name) @ PLANE.T, atol=SHOWN)


def test_a_tendon_over_a_pulley_is_a_line_for_each_branch():
    branches = replaced(
        ROPED, '<site site="reel"/><site site="guide"/>', '<site site="reel"/><site site="guide"/><pulley divisor="2"/>'
    ).replace('<pulley divisor="2"/>', '<pulley divisor="2"/><site site="reel"/>')
    marks = drawn(branches, POSES)["pull"].marks
    assert [mark.shape for mark in marks] == ["line", "line"]
    assert [len(mark.at[0]) for mark in marks] == [4, 4]


def test_a_tendon_that_touches_a_geom_on_the_way_is_one_line_with_as_many_points_at_every_pose():
    drum = '<geom name="drum" type="cylinder" size="0.05 0.05" zaxis="0 1 0" contype="0" conaffinity="0"/><site name="reel"'
    around = replaced(ROPED, '<site name="reel"', drum).replace('<site site="guide"/>', '<geom geom="drum"/>')
    straight, touching = np.array([[0.0, 0.0], [-1.5, 0.0]])  # at the second pose the drum lies between the reel and the tip
    (mark,) = drawn(around, np.array([straight, touching]))["pull"].marks
    points = np.array(mark.at, dtype=float).reshape(2, 4, 2)
    np.testing.assert_allclose(points[0], [[0, 0.2], [0.5, 0], [0.5, 0], [0.5, 0]], atol=SHOWN)
    np.testing.assert_allclose(np.linalg.norm(points[1, 1:3], axis=1), 0.05, atol=SHOWN)


def test_a_site_s_force_is_an_arrow_there_that_turns_with_its_link():
    (mark,) = drawn(ROPED, POSES)["thrust"].marks
    assert mark.shape == "arrow"
    np.testing.assert_allclose(np.array(mark.at, dtype=float), places(ROPED, "tip") @ PLANE.T, atol=SHOWN)
    angle = POSES.sum(axis=1)
    np.testing.assert_allclose(mark.axis, np.stack([np.sin(angle), -np.cos(angle)], axis=1), atol=5 * SHOWN)


def test_a_fixed_tendon_turns_each_of_its_joints_its_own_way():
    marks = drawn(GRIPPER, load_mechanism(GRIPPER).home[None])["grip"].marks
    assert [mark.shape for mark in marks] == ["arc", "arc"]
    right, left = (mark.axis[0][0] for mark in marks)
    assert right == pytest.approx(-left)
    assert abs(right) == 1


def test_an_arc_that_the_drawing_sees_from_its_side_is_left_out():
    across = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert drawn(GRIPPER, load_mechanism(GRIPPER).home[None], across)["grip"].marks == []
    assert len(drawn(GRIPPER, load_mechanism(GRIPPER).home[None], np.eye(3))["grip"].marks) == 2
