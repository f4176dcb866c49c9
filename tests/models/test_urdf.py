"""A URDF goes through MuJoCo's converter: what that makes is planned with, what it leaves out is named."""

import numpy as np
import pytest

from linkplan.models.foreign.conversion import conversion_notes
from linkplan.models.foreign.model_text import urdf_root
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.reach import reach

LINK = (
    '<link name="{}"><inertial><mass value="1"/><origin xyz="0 0 -0.1"/>'
    '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz="0 0 -0.2"/><axis xyz="0 1 0"/>'
    '<limit lower="-1" upper="1" effort="5" {}/>{}</joint>'
)


def urdf(inside: str = "", beside: str = "", velocity: str = "") -> str:
    joints = JOINT.format("hip", "base", "a", velocity, '<dynamics damping="0.1"/>')
    joints += JOINT.format("knee", "a", "b", velocity, '<mimic joint="hip" multiplier="-2"/>')
    links = '<link name="base"/>' + LINK.format("a") + LINK.format("b")
    return f'<robot name="leg"><mujoco>{inside}</mujoco>{links}{joints}{beside}</robot>'


ATTACHED = """<mujoco><asset><model name="leg" file="leg.urdf"/></asset><worldbody><frame><attach model="leg" prefix="l_"/>
</frame></worldbody><actuator><motor name="drive" joint="l_hip" ctrlrange="-9 9"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (urdf(velocity='velocity="3"'), ["speed limits", "hip 3, knee 3", "limits.speed_deg_s"]),
        (urdf(beside='<transmission name="t"/><gazebo/>'), ["ignores", "elements gazebo"]),
        (urdf(inside='<option timestep="1e-3"/><actuator><motor joint="hip"/></actuator>'), ["ignores actuator in"]),
        (urdf(), ["no actuators", "<attach"]),
    ],
)
def test_what_the_converter_leaves_out_is_a_note(text, said):
    notes = load_mechanism(text).notes
    assert any(all(words in note for words in said) for note in notes), notes


def test_what_a_urdf_does_not_say_is_not_told_of():
    root = urdf_root(urdf(inside='<compiler fusestatic="true"/>'))
    assert root is not None
    (only,) = conversion_notes(root)
    assert "no actuators" in only


def test_a_model_in_mjcf_is_no_urdf():
    assert urdf_root("<mujoco><actuator/></mujoco>") is None
    assert urdf_root("optimus-knee") is None


@pytest.mark.parametrize(("limit", "said"), [('lower="0.2" upper="0"', "0.2 to 0"), ('lower="-1e16" upper="1e16"', "1e+16")])
def test_a_range_that_limits_nothing_is_left_out_and_named(limit, said):
    """MuJoCo and Bullet read one that ends below its beginning as no limits; Gazebo's default is 1e16."""
    mechanism = load_mechanism(urdf().replace('lower="-1" upper="1"', limit, 1))
    (note,) = [note for note in mechanism.notes if "impose no limit" in note]
    assert "hip (" in note
    assert said in note
    assert "knee" not in note
    assert [bool(limited) for limited in mechanism.model.jnt_limited] == [False, True]


@pytest.mark.parametrize(("lower", "kept"), [(0, False), (-2, True)])
def test_the_range_of_a_follower_that_would_hold_its_leader_still_is_left_out_and_named(lower, kept):
    """The fingers of Robotiq's grippers have ranges that begin at 0, whether they follow forwards or backwards."""
    there = urdf().replace('lower="-1" upper="1"', 'lower="0" upper="1"', 1)
    mechanism = load_mechanism(there.replace('lower="-1" upper="1"', f'lower="{lower}" upper="{lower + 2}"'))
    named = [note for note in mechanism.notes if "knee (0 to 2) of hip" in note]
    assert len(named) == (not kept)
    hip = [joint.name for joint in mechanism.joints].index("hip")
    assert np.sort(reach(mechanism, 0).poses[[0, -1], hip]) == pytest.approx([0, 1])


def test_a_file_named_in_capitals_is_read(tmp_path):
    (tmp_path / "LEG.URDF").write_text(urdf())
    assert load_mechanism(tmp_path / "LEG.URDF").dof == 1


def test_a_mesh_of_a_package_that_is_not_found_is_left_out_and_said(tmp_path):
    shape = '<collision><geometry><mesh filename="package:///link.stl"/></geometry></collision></link>'
    (tmp_path / "leg.urdf").write_text(urdf().replace('<link name="base"/>', '<link name="base">' + shape))
    (note,) = [note for note in load_mechanism(tmp_path / "leg.urdf").notes if "link.stl" in note]
    assert "ignored" in note
    assert 'meshdir="FOLDER"' in note


@pytest.mark.parametrize("package", ["leg", "other"])
def test_a_mesh_of_a_package_is_found_above_the_folder_of_the_urdf(package, tmp_path):
    """ROS has PACKAGE/urdf beside PACKAGE/meshes, wherever the package lies; clones of it have other names."""
    for folder in ("leg/urdf", "leg/meshes"):
        (tmp_path / folder).mkdir(parents=True)
    corners = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1]], dtype="<f4")
    faces = b"".join(
        bytes(12) + corners[[i, j, k]].tobytes() + bytes(2) for i, j, k in ((0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2))
    )
    (tmp_path / "leg/meshes/link.stl").write_bytes(bytes(80) + (4).to_bytes(4, "little") + faces)
    shape = f'<collision><geometry><mesh filename="package://{package}/meshes/link.stl"/></geometry></collision></link>'
    text = urdf().replace('<link name="base"/>', '<link name="base">' + shape)
    (tmp_path / "leg/urdf/leg.urdf").write_text(text)
    mechanism = load_mechanism(tmp_path / "leg/urdf/leg.urdf")
    assert mechanism.model.nmesh == 1
    assert not any("link.stl" in note for note in mechanism.notes)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        (
            "link.stl",
            b"solid link\n" + bytes(90),
            "MuJoCo does not read (it reads binary .stl, .obj, .msh) are ignored: link.stl",
        ),
        ("link.stl", bytes(84), "does not read"),
        (
            "link.obj",
            b"version https://git-lfs.github.com/spec/v1\n",
            "Git LFS pointers are ignored: link.obj; git lfs pull",
        ),
    ],
    ids=["text", "no triangles", "a pointer"],
)
def test_a_mesh_that_mujoco_refuses_is_left_out_and_said(name, content, said, tmp_path):
    (tmp_path / name).write_bytes(content)
    shape = f'<collision><geometry><mesh filename="{name}"/></geometry></collision></link>'
    (tmp_path / "leg.urdf").write_text(urdf().replace('<link name="base"/>', '<link name="base">' + shape))
    assert any(said in note for note in load_mechanism(tmp_path / "leg.urdf").notes)


def test_an_mjcf_that_attaches_a_urdf_gives_it_a_motor_and_keeps_its_coupling_and_effort_limit(tmp_path):
    (tmp_path / "leg.urdf").write_text(urdf())
    (tmp_path / "leg.xml").write_text(ATTACHED)
    mechanism = load_mechanism(tmp_path / "leg.xml")
    (motor,) = mechanism.actuators
    assert (mechanism.dof, motor.lower, motor.upper) == (1, -5.0, 5.0)
    assert np.array(mechanism.dynamics.velocity_map(mechanism.home))[:, 0] == pytest.approx([1.0, -2.0])
