"""The solid shapes of bodies against MuJoCo's own places and against closed forms."""

import mujoco
import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.solids import body_frames, cut_pins, faces, geom_solids, outline, payload_rod, solids
from tests.support.linkages import loaded

# Rounding of double precision, in metres or cubic metres.
ROUNDING = 1e-12
SHAPES = """<mujoco><asset><mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 1  0.1 0.1 0.1"/></asset><worldbody>
<body name="arm"><joint name="J" axis="0 1 0"/><geom type="box" size="0.1 0.2 0.3" pos="0.5 0 0" euler="10 20 30"/>
<geom type="mesh" mesh="wedge"/><geom type="sphere" size="0.05" group="3"/><geom type="ellipsoid" size="0.1 0.1 0.3"/>
<geom type="cylinder" size="0.1 0.2"/><body name="welded" pos="0 0 -1" quat="0 1 0 0">
<geom type="capsule" size="0.02 0.2" pos="0 0.1 0"/></body></body></worldbody>
<actuator><motor joint="J" ctrlrange="-1 1"/></actuator></mujoco>"""
BARE = """<mujoco><worldbody><body name="leg"><joint name="knee" axis="0 1 0"/>
<inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.01"/><site name="foot" pos="0.1 0 -0.4"/></body></worldbody>
<actuator><motor joint="knee" ctrlrange="-9 9"/></actuator></mujoco>"""


def volume(points: np.ndarray, corners: list[list[int]]) -> float:
    """Return the volume within faces, by the divergence theorem; it is positive if all are seen from outside."""
    fans = [(face[0], face[k], face[k + 1]) for face in corners for k in range(1, len(face) - 1)]
    return sum(float(np.linalg.det(points[list(fan)])) for fan in fans) / 6


def test_geoms_are_where_mujoco_has_them_at_another_pose():
    mechanism = load_mechanism(SHAPES)
    pose = np.array([[0.7]])
    places, turns = body_frames(mechanism, pose)
    found = geom_solids(mechanism)
    assert len(found) == 5  # without the hidden sphere
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = pose[0]
    mujoco.mj_kinematics(mechanism.model, data)
    for k, geom in ((0, 0), (3, 4), (4, 5)):  # box, cylinder, welded capsule
        solid = found[k]
        middle = places[0, solid.body] + turns[0, solid.body] @ solid.points.mean(axis=0)
        np.testing.assert_allclose(middle, data.geom_xpos[geom], atol=ROUNDING)


def test_the_faces_of_a_box_are_six_and_hold_its_volume():
    box = geom_solids(load_mechanism(SHAPES))[0].points
    found = faces(box)
    assert sorted(map(len, found)) == [4] * 6
    assert volume(box, found) == pytest.approx(0.2 * 0.4 * 0.6)


def test_a_mesh_is_its_hull_and_an_ellipsoid_nearly_fills_its_volume():
    _, mesh, ellipsoid, cylinder, _ = (solid.points for solid in geom_solids(load_mechanism(SHAPES)))
    assert len(mesh) == 4  # the vertex within the wedge is left out
    assert volume(mesh, faces(mesh)) == pytest.approx(1 / 6, rel=1e-6)  # MuJoCo keeps vertices in single precision
    assert 0.85 < volume(ellipsoid, faces(ellipsoid)) / (4 / 3 * np.pi * 0.1 * 0.1 * 0.3) < 1.0
    assert 0.95 < volume(cylinder, faces(cylinder)) / (np.pi * 0.01 * 0.4) < 1.0
    assert len(faces(cylinder)) == 26  # 24 sides and two ends


def test_an_outline_keeps_the_corners_in_their_order():
    square = np.array([[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.5]])
    found = outline(square)
    x, y = found.T
    assert abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2 == pytest.approx(1.0)
    assert outline(np.array([[0.0, 0.0], [2.0, 2.0], [1.0, 1.0]])).tolist() == [[0.0, 0.0], [2.0, 2.0]]
    assert len(outline(np.ones((3, 2)))) == 1


def test_a_payload_is_the_uniform_rod_of_its_mass_and_inertia():
    mechanism = load_mechanism("optimus-knee", payload="shank")
    rod, payload = payload_rod(mechanism), mechanism.payload
    np.testing.assert_allclose(rod.points.mean(axis=0), payload.com_m, atol=ROUNDING)
    length = np.linalg.norm(rod.points[1] - rod.points[0]) + 2 * rod.radius
    assert payload.mass_kg * length**2 / 12 == pytest.approx(payload.inertia_kgm2.max())
    assert payload_rod(load_mechanism("optimus-knee")) is None


def test_a_payload_without_inertia_is_a_ball_and_hangs_on_an_arm():
    held = {"body": "crank", "mass_kg": 1.0, "com_m": [0.0, 0.0, -0.3]}
    ball, arm = (solid for solid in solids(load_mechanism("optimus-knee", payload=held)) if solid.kind != "geom")
    assert ball.points.tolist() == [[0.0, 0.0, -0.3]]
    assert (arm.kind, arm.points.tolist()) == ("arm", [[0.0, 0.0, 0.0], [0.0, 0.0, -0.3]])


def test_a_foot_without_a_geom_hangs_on_its_leg():
    (arm,) = solids(load_mechanism(BARE))
    assert arm.kind == "arm"
    assert arm.points[1].tolist() == [0.1, 0.0, -0.4]


def test_a_cut_pin_has_the_name_of_its_closure_and_lies_on_both_bodies():
    mechanism = loaded("rssr")
    (pin,) = cut_pins(mechanism)
    places, turns = body_frames(mechanism, mechanism.home[None])
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(mechanism.home)
    mujoco.mj_kinematics(mechanism.model, data)
    assert pin.name == "ball"
    np.testing.assert_allclose(places[0, pin.body] + turns[0, pin.body] @ pin.point, data.site("socket").xpos, atol=1e-9)
