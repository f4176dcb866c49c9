"""Loops, drives and joint types of a URDF that MuJoCo's converter leaves out, on a four-bar in several dialects."""

import numpy as np
import pytest

import linkplan
from linkplan.cli.main import main
from linkplan.models.errors import LinkplanError
from tests.support.four_bar_urdf import CUT, FOUR_BAR, FRAMES, LOOP_JOINT, TRANSMISSION, YAML, joint, link, robot, written
from tests.support.refusals import assert_refused


def assert_four_bar(mechanism) -> None:
    """The loop is closed at the points of the links, one motor drives one degree of freedom, and both can move."""
    assert (mechanism.dof, mechanism.n_u) == (1, 1)
    assert mechanism.effort_limit[0].tolist() == [-7.0, 7.0]
    assert mechanism.gap_m(mechanism.home) < 1e-12
    q = dict(zip((one.name for one in mechanism.joints), mechanism.home, strict=True))

    def turned(angle: float, x: float, z: float) -> np.ndarray:
        return np.array([np.cos(angle) * x + np.sin(angle) * z, -np.sin(angle) * x + np.cos(angle) * z])

    end_of_coupler = turned(q["motor"], 0, 0.1) + turned(q["motor"] + q["A"], 0.2, 0.05)
    end_of_rocker = np.array([0.2, 0.0]) + turned(q["C"], 0, 0.15)
    np.testing.assert_allclose(end_of_coupler, end_of_rocker, atol=1e-10)


# The rocker's frame turned by a quarter turn about y: its own z is the root's x, and its x the root's -z.
TURNED = FOUR_BAR.replace('<origin xyz="0.2 0 0"/>', '<origin xyz="0.2 0 0" rpy="0 1.5707963267948966 0"/>')


def assert_tied_in_turned_frames(mechanism) -> np.ndarray:
    """Fail unless the loop is closed at the points of the links; return both points (2, 3)."""
    assert (mechanism.dof, mechanism.n_u) == (1, 1)
    ends = np.array([mechanism.model.site(f"coupler-rocker {end}").pos for end in (1, 2)])
    np.testing.assert_allclose(ends, [[0.2, 0, 0.05], [-0.15, 0, 0]], atol=1e-12)
    return ends


@pytest.mark.parametrize("folder", ["", "package/urdf"])
def test_a_hinge_that_the_solidworks_exporter_cut_is_closed(tmp_path, folder):
    """Its point is in the root link's frame; the exporter writes the file beside the folder of the URDF."""
    (tmp_path / folder).mkdir(parents=True, exist_ok=True)
    beside = tmp_path / ("package" if folder else "") / "loop_closures.yaml"
    beside.write_text(CUT, encoding="utf-8")
    mechanism = linkplan.load_mechanism(written(tmp_path / folder, robot(FOUR_BAR)))
    assert_four_bar(mechanism)
    assert "closures from loop_closures.yaml: coupler-rocker" in mechanism.notes
    assert "motors from loop_closures.yaml: motor" in mechanism.notes


def test_check_writes_a_urdf_with_its_loops_as_mjcf(tmp_path, capsys):
    main(["check", written(tmp_path, robot(FOUR_BAR, FRAMES), YAML), "-o", str(tmp_path / "out")])
    capsys.readouterr()
    assert_four_bar(linkplan.load_mechanism(tmp_path / "out" / "model.xml"))


def test_a_cut_hinge_is_found_through_turned_frames(tmp_path):
    (tmp_path / "loop_closures.yaml").write_text(CUT, encoding="utf-8")
    assert_tied_in_turned_frames(linkplan.load_mechanism(written(tmp_path, robot(TURNED))))


def test_the_only_yaml_file_beside_the_only_urdf_is_read(tmp_path):
    urdf = tmp_path / "full.urdf"
    urdf.write_text(robot(FOUR_BAR, FRAMES), encoding="utf-8")
    (tmp_path / "robot.yaml").write_text(YAML, encoding="utf-8")
    assert_four_bar(linkplan.load_mechanism(str(urdf)))
    (tmp_path / "other.urdf").write_text(robot(FOUR_BAR), encoding="utf-8")
    assert linkplan.load_mechanism(str(tmp_path / "other.urdf")).dof == 3  # whose file it is is not known


CLOSING_PINS = FRAMES.replace("end_A", "closing_pin_1").replace("end_B", "closing_pin_2")
NAMED_BY_JOINTS = YAML.replace("end_A", "end_A_frame").replace("end_B", "end_B_frame")
BESIDE = "the YAML file beside the URDF"


@pytest.mark.parametrize(
    ("parts", "yaml", "notes"),
    [
        ([FRAMES], YAML, [f"closures from {BESIDE}: end_A-end_B", f"motors from {BESIDE}: motor"]),
        ([FRAMES], NAMED_BY_JOINTS, []),
        ([LOOP_JOINT, TRANSMISSION], None, ["closures from the URDF: B", "motors from transmissions of the URDF: motor"]),
        ([CLOSING_PINS, TRANSMISSION], None, ["closures from the URDF: closing_pin_1-closing_pin_2"]),
    ],
    ids=["frames in a YAML file", "joints of frames in a YAML file", "loop joint and transmission", "frames in pairs"],
)
def test_loops_are_closed_and_joints_driven_and_both_are_said(tmp_path, parts, yaml, notes):
    mechanism = linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR, *parts), *([yaml] if yaml else [])))
    assert_four_bar(mechanism)
    assert set(notes) <= set(mechanism.notes)


def test_a_weld_of_two_frames_of_a_plane_linkage_keeps_its_freedom_if_one_can_turn(tmp_path):
    frames = FRAMES.replace('<joint name="end_B_frame" type="fixed">', '<joint name="end_B_frame" type="continuous">')
    yaml = YAML.replace("3d", "6d")
    mechanism = linkplan.load_mechanism(
        written(tmp_path, robot(FOUR_BAR, frames.replace(link("end_B", 0.0), link("end_B", 0.1))), yaml)
    )
    assert (mechanism.dof, mechanism.n_u) == (1, 1)


def test_a_joint_that_has_a_motor_gets_no_second_one(tmp_path):
    path = written(tmp_path, robot(FOUR_BAR, LOOP_JOINT, TRANSMISSION))
    mechanism = linkplan.load_mechanism(path, drive=["motor"])
    assert [actuator.target for actuator in mechanism.actuators] == ["joint motor"]
    assert "motors that the model has already (mechanism.drive): motor on motor" in mechanism.notes


def test_missing_meshes_are_left_out_and_named(tmp_path):
    visual = '<collision><geometry><mesh filename="package://robot/meshes/shell.stl"/></geometry></collision>'
    text = robot(FOUR_BAR.replace(link("crank"), link("crank", visual=visual)), FRAMES)
    mechanism = linkplan.load_mechanism(written(tmp_path, text, YAML))
    assert_four_bar(mechanism)
    assert any(note.startswith("missing meshes are ignored: shell.stl") for note in mechanism.notes)


def test_joints_become_balls_and_universal_joints(tmp_path):
    spherical = YAML + "joint_name: ['A', 'C']\njoint_type: ['SPHERICAL', 'UJOINT_YZ']\n"
    mechanism = linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR, FRAMES), spherical))
    names = [one.name for one in mechanism.joints]
    assert {"motor", "C_Y", "C_Z"} <= set(names)
    assert [name for name in names if name.startswith("A_r")] == ["A_rx", "A_ry", "A_rz"]
    assert mechanism.dof == 3  # 1 + 3 + 2 coordinates, and three equations


def test_a_link_without_mass_gets_a_little_and_is_named(tmp_path):
    dummy = joint("A", "crank", "dummy", "0 0 0.1") + joint("A2", "dummy", "coupler", "0 0 0", axis="0 0 1")
    text = robot(FOUR_BAR.replace(joint("A", "crank", "coupler", "0 0 0.1"), dummy), link("dummy", 0.0), FRAMES)
    mechanism = linkplan.load_mechanism(written(tmp_path, text, YAML))
    assert any("links without mass get 1e-06 kg" in note and "dummy" in note for note in mechanism.notes)


@pytest.mark.parametrize(
    ("yaml", "words"),
    [
        (YAML.replace("end_B", "end_C"), ["link in closure end_A-end_C", "did you mean 'end_B'", "rocker"]),
        (YAML.replace("'motor'", "'moter'"), ["joint in the YAML file beside the URDF 'moter'", "legal: motor"]),
        (YAML + "joint_name: ['Q']\njoint_type: ['FIXED']\n", ["joint in the YAML file beside the URDF 'Q'"]),
        ("closed_loop: [", ["not YAML"]),
        (YAML + "joint_name: ['A']\njoint_type: ['SCREW']\n", ["SCREW", "SPHERICAL"]),
        (YAML.replace("3d", "4d"), ["type of closure in the YAML file beside the URDF '4d'", "legal: 3d, 6d"]),
        (YAML.replace("['3d']", "['3d', '6d']"), ["closed_loop", "type"]),
        ("closed_loop: 3\nname_mot: []\n", ["closed_loop"]),
    ],
)
def test_a_wrong_yaml_file_is_refused_in_one_line(tmp_path, yaml, words):
    assert_refused(lambda: linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR, FRAMES), yaml)), *words)


def test_sdf_is_refused_with_its_converter(tmp_path):
    model = tmp_path / "robot.sdf"
    model.write_text('<?xml version="1.0"?><sdf version="1.7"><model name="a"/></sdf>', encoding="utf-8")
    for source in (model, model.read_text(encoding="utf-8")):
        with pytest.raises(LinkplanError, match="is SDF, and models are MJCF or URDF: sdf2mjcf"):
            linkplan.load_mechanism(source)


@pytest.mark.parametrize(
    ("given", "diagonal", "said"),
    [
        ((0.005, 0.005, 0.05), (0.0183333333, 0.0183333333, 0.0366666667), "largest moment): crank (36 %)"),
        ((-0.004, 0.005, 0.005), (1e-9, 0.005, 0.005), "largest moment): crank (80 %)"),
        ((0, 0, 0), (1e-9, 1e-9, 1e-9), "links without inertia get 1e-09 kg.m^2: crank"),
        ((0.002, 0.003, 0.005), (0.002, 0.003, 0.005), None),  # a flat plate's, to rounding
    ],
)
def test_an_inertia_that_no_body_has_becomes_the_nearest_one(tmp_path, given, diagonal, said):
    """The triangle's excess e = c - a - b goes by thirds: (a + e/3, b + e/3, c - e/3)."""
    old, new = ('ixx="{}" iyy="{}" izz="{}"'.format(*moments) for moments in ((0.005,) * 3, given))
    crank = link("crank")
    assert old in crank
    text = robot(FOUR_BAR.replace(crank, crank.replace(old, new)), LOOP_JOINT, TRANSMISSION)
    mechanism = linkplan.load_mechanism(written(tmp_path, text))
    assert_four_bar(mechanism)
    np.testing.assert_allclose(np.sort(mechanism.model.body("crank").inertia), diagonal, rtol=1e-8)
    found = [note for note in mechanism.notes if "inertia" in note]
    assert (found == []) if said is None else found[0].endswith(said)


def test_what_other_simulators_read_is_left_out_and_named(tmp_path):
    """Placeholders without size, meshes of other formats, transmissions of joints that do not move."""
    shapes = '<box size="0 0 0"/>', '<sphere radius="0"/>', '<mesh filename="shell.dae"/>', '<box size="0.1 0.1 0.1"/>'
    collisions = "".join(f"<collision><geometry>{shape}</geometry></collision>" for shape in shapes)
    (tmp_path / "shell.dae").write_text("<COLLADA/>", encoding="utf-8")
    text = FOUR_BAR.replace(link("crank"), link("crank", visual=collisions))
    lidar = TRANSMISSION.replace('"motor"', '"lidar"') + joint("lidar", "base", "scanner", "0 0 1", kind="fixed")
    mechanism = linkplan.load_mechanism(written(tmp_path, robot(text, link("scanner"), LOOP_JOINT, lidar, TRANSMISSION)))
    assert_four_bar(mechanism)
    assert mechanism.model.ngeom == 1
    assert {
        "shapes without size are ignored: of crank",
        "meshes that MuJoCo does not read (it reads binary .stl, .obj, .msh) are ignored: shell.dae",
        "transmissions of missing or immovable joints are ignored: lidar",
    } <= set(mechanism.notes)


def test_an_inertia_that_no_body_has_is_refused_in_mjcf_with_the_remedy():
    body = '<body><inertial pos="0 0 0" mass="1" diaginertia="1 1 3"/><joint/></body>'
    with pytest.raises(LinkplanError, match=r'B >= C.*: <compiler balanceinertia="true"/>$'):
        linkplan.load_mechanism(f"<mujoco><worldbody>{body}</worldbody></mujoco>")


def test_xacro_is_refused_with_what_expands_it(tmp_path):
    text = robot(FOUR_BAR, '<xacro:include filename="arm.xacro"/>', LOOP_JOINT, TRANSMISSION)
    for name in ("robot.urdf", "robot.urdf.xacro"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        with pytest.raises(LinkplanError, match=r"is xacro, which makes a URDF: .* xacro FILE > robot.urdf"):
            linkplan.load_mechanism(tmp_path / name)
    expanded = text.replace("<xacro:", "<!-- <xacro:").replace('.xacro"/>', '.xacro"/> -->')
    assert_four_bar(linkplan.load_mechanism(written(tmp_path, expanded)))


def test_a_urdf_without_motors_gets_those_that_the_problem_names(tmp_path, capsys):
    """Exporters write every joint with an effort limit, passive ones too."""
    path = written(tmp_path, robot(FOUR_BAR, CLOSING_PINS))
    assert main(["check", path]) == 1
    said = capsys.readouterr().out
    assert 'mechanism.drive = ["motor"] puts motors' in said
    asked = said.split("--drive ")[1].split(" ")[0]
    mechanism = linkplan.load_mechanism(path, drive=asked.split(","))
    assert_four_bar(mechanism)
    assert "motors added (mechanism.drive): motor" in mechanism.notes
    assert not any("names no actuators" in note for note in mechanism.notes)
    main(["check", path, "--drive", asked])
    said = capsys.readouterr().out
    assert "no actuator" not in said
    assert f"--drive {asked} -o problem.toml" in said
    with pytest.raises(LinkplanError, match=r"unknown joint 'moter' \(did you mean 'motor'\?\); legal: motor, A, C"):
        linkplan.load_mechanism(path, drive=["moter"])


GAZEBO = """<gazebo><joint name="B" type="{kind}"><parent>coupler</parent><child>rocker</child><pose>{pose}</pose>
<axis><xyz>{axis}</xyz>{frame}</axis></joint></gazebo>"""
ROS2 = """<ros2_control name="hardware" type="system"><joint name="motor"><command_interface name="effort"/></joint>
<joint name="A"><state_interface name="position"/></joint>
<joint name="end_A_frame"><command_interface name="effort"/></joint></ros2_control>"""


@pytest.mark.parametrize(
    ("pose", "axis", "frame"),
    [
        ("-0.15 0 0 0 0 0", "0 2 0", ""),
        ("-0.15 0 0 1.5707963267948966 0 0", "0 0 -1", ""),
        ("-0.15 0 0 1.5707963267948966 0 0", "0 1 0", "<use_parent_model_frame>1</use_parent_model_frame>"),
    ],
)
def test_a_hinge_of_gazebo_is_closed_and_joints_that_ros2_control_commands_are_driven(tmp_path, pose, axis, frame):
    """Its pose is in the child, and its axis in that pose or in the root link."""
    text = robot(TURNED, FRAMES, GAZEBO.format(kind="revolute", pose=pose, axis=axis, frame=frame), ROS2)
    mechanism = linkplan.load_mechanism(written(tmp_path, text))
    ends = assert_tied_in_turned_frames(mechanism)
    along = np.array([mechanism.model.site(f"coupler-rocker axis {end}").pos for end in (1, 2)]) - ends
    np.testing.assert_allclose(np.abs(along), [[0, 0.05, 0], [0, 0.05, 0]], atol=1e-12)
    assert "closures from the URDF's <gazebo>: B" in mechanism.notes
    assert "motors from ros2_control of the URDF: motor" in mechanism.notes
    assert not any("elements gazebo" in note or "ros2_control," in note for note in mechanism.notes)


def test_a_ball_of_gazebo_ties_points_and_a_detachable_joint_holds_links_where_they_are(tmp_path):
    ball = GAZEBO.format(kind="ball", pose="0 0 0.15 0 0 0", axis="0 1 0", frame="")
    assert_four_bar(linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR, ball, TRANSMISSION))))
    tip = link("tip", 0.1) + joint("tip_hinge", "rocker", "tip", "0 0 0.15")  # its axes are not the coupler's
    turned = tip.replace('<origin xyz="0 0 0.15"/>', '<origin xyz="0 0 0.15" rpy="0 1 0"/>')
    plugin = """<gazebo><plugin filename="gz" name="gz::sim::systems::DetachableJoint"><parent_link>coupler</parent_link>
    <child_model>four-bar</child_model><child_link>{}</child_link></plugin></gazebo>"""
    held = linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR, turned, plugin.format("tip"), TRANSMISSION)))
    assert held.dof == 1
    assert held.gap_m(held.home) < 1e-12
    np.testing.assert_allclose(held.home, 0.0, atol=1e-9)  # Gazebo fixes links as they stand
    elsewhere = linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR, plugin.format("box"), TRANSMISSION)))
    assert elsewhere.dof == 3


@pytest.mark.parametrize("ends", ["", "<parent>base</parent><child>rocker</child>"])
def test_what_gazebo_adds_to_a_joint_of_the_tree_closes_no_loop(tmp_path, ends):
    sensor = f'<gazebo><joint name="C" type="revolute">{ends}<sensor name="force" type="force_torque"/></joint></gazebo>'
    mechanism = linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR, sensor, LOOP_JOINT, TRANSMISSION)))
    assert_four_bar(mechanism)
    assert not any("in <gazebo>" in note or "without mass" in note for note in mechanism.notes)
    assert any("ignores the URDF's elements gazebo" in note for note in mechanism.notes)


def test_a_joint_of_gazebo_that_closes_no_loop_is_named(tmp_path):
    rail = GAZEBO.format(kind="prismatic", pose="0 0 0 0 0 0", axis="0 1 0", frame="")
    ground = '<gazebo><joint name="stand" type="fixed"><parent>world</parent><child>base</child></joint></gazebo>'
    mechanism = linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR, rail, ground, TRANSMISSION)))
    assert mechanism.dof == 3
    said = "joints in <gazebo> close no loop here: B (type prismatic, coupler to rocker), stand (type fixed, world to base)"
    assert any(note.startswith(said) for note in mechanism.notes)
    wrong = GAZEBO.format(kind="ball", pose="0 0 up", axis="0 1 0", frame="")
    with pytest.raises(LinkplanError, match="joint 'B' in <gazebo> has pose = '0 0 up'; it takes 6 numbers"):
        linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR, wrong)))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('rpy="0 0 0"/><link2', 'rpy="0 0"/><link2', "loop_joint 'B' has link1 rpy = '0 0'; it takes 3 numbers"),
        ('xyz="0 0 0.15"', 'xyz="0 0 nan"', "loop_joint 'B' has link2 xyz = '0 0 nan'"),
        ('xyz="0 1 0"', 'xyz="0 1 a"', "loop_joint 'B' has axis xyz = '0 1 a'"),
        ('xyz="0 1 0"', 'xyz="0 0 0"', "loop_joint 'B' has axis xyz = '0 0 0', which has no direction"),
        ('type="continuous"', 'type="prismatic"', "unknown type of loop_joint 'B' 'prismatic'; legal: revolute"),
        ("<axis", "<axis/><axis", "loop_joint 'B' has 2 <axis>"),
        ("<link2", "<link1/><link2", "loop_joint 'B' has 2 <link1>"),
        ("<axis", '<origin xyz="0 0 1"/><axis', "loop_joint 'B' has an <origin>; its points are the attributes xyz and rpy"),
        ("<link2", "<link3", "loop_joint 'B' has no <link2>"),
        ('link="rocker"', 'link="coupler"', "loop_joint 'B' has link1 and link2 = 'coupler'"),
    ],
)
def test_a_loop_joint_that_closes_no_loop_is_refused_by_name_and_attribute(old, new, said):
    assert old in LOOP_JOINT
    assert_refused(lambda: linkplan.load_mechanism(robot(FOUR_BAR, LOOP_JOINT.replace(old, new))), said)


def test_what_is_not_read_of_a_loop_joint_is_named():
    loop = LOOP_JOINT.replace("<axis", '<limit lower="0"/><axis').replace('rpy="0 0 0"/><link2', 'rpx="1"/><link2')
    mechanism = linkplan.load_mechanism(robot(FOUR_BAR, loop))
    assert "ignored in loop_joint 'B': <limit>, rpx of <link1>" in mechanism.notes


def test_the_length_of_a_loop_joints_axis_does_not_matter():
    first, *others = (
        linkplan.load_mechanism(robot(FOUR_BAR, LOOP_JOINT.replace('xyz="0 1 0"', f'xyz="0 {length} 0"')))
        for length in ("1", "1e-200", "1e200")
    )
    for other in others:
        np.testing.assert_allclose(other.model.site_pos, first.model.site_pos, atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new"), [("[0, 2, 0]", "[0, 0, 0]"), ("[0, 2, 0]", "[0, .inf, 0]"), ("[0.2, 0", "[.nan, 0")]
)
def test_a_cut_hinge_without_an_axis_or_a_point_is_refused(tmp_path, old, new):
    assert old in CUT
    (tmp_path / "loop_closures.yaml").write_text(CUT.replace(old, new), encoding="utf-8")
    with pytest.raises(LinkplanError, match=r"closure coupler-rocker has (axis|point) = "):
        linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR)))


def test_a_closing_frame_without_its_other_half_is_refused(tmp_path):
    frames = FRAMES.replace("end_A", "lonely").replace("end_B", "closing_pin_2")
    assert_refused(lambda: linkplan.load_mechanism(written(tmp_path, robot(FOUR_BAR, frames))), "'closing_pin_1'")
