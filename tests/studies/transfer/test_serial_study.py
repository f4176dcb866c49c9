"""The serial equivalent in `transfer`: its file, its errors along a plan and along samples, refusals."""

import json
import re
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest
import scipy.interpolate

import linkplan
from linkplan.cli.main import main
from linkplan.models.errors import LinkplanError
from linkplan.models.transfer.rest import OutputMotion
from linkplan.studies.handover.transfer.serial_study import motion_of_plan
from linkplan.studies.handover.transfer.serial_urdf import reductions, urdf_notes, urdf_text
from tests.support import parallel_ankle
from tests.support.plans import optimal

ANKLE = ["ankle_pitch", "ankle_roll"]


@pytest.fixture(scope="module")
def ankle():
    return linkplan.transfer(linkplan.load_mechanism(parallel_ankle.ankle_text()), ANKLE, tolerance=0.02)


@pytest.fixture(scope="module")
def knee():
    plan = optimal("knee-reach")
    return linkplan.transfer(plan.problem, ["C"], tolerance=0.01, along=plan)


def test_the_serial_equivalent_is_a_model_without_loops_with_the_outputs(ankle):
    model = mujoco.MjModel.from_xml_string(ankle.serial_mjcf)
    assert (model.neq, model.nu, [model.joint(j).name for j in range(model.njnt)]) == (0, 2, ANKLE)
    record = ankle.to_dict()["serial"]
    assert record["welded"][0] == "motor_left"
    assert record["errors"] is None
    np.testing.assert_allclose(model.dof_armature, record["armature"], rtol=1e-5)


def test_errors_along_samples_shrink_from_the_static_map_to_the_table(ankle):
    time = np.linspace(0, 1, 400)
    path = np.column_stack([0.3 * np.sin(6 * time), 0.2 * np.cos(5 * time)])
    errors = ankle.errors_along(time, path)
    rms = {name: np.sqrt(np.mean(off**2, axis=0)) for name, off in errors.items()}
    assert rms["static map"][0] > 2 * rms["serial equivalent"][0]  # of roll, dry friction of both motors cancels in part
    assert np.all(rms["serial equivalent"] > 5 * rms["serial with table"])


def test_the_rest_is_what_the_errors_with_and_without_the_table_differ_by(ankle):
    time = np.linspace(0, 1, 200)
    path = np.column_stack([0.3 * np.sin(6 * time), 0.2 * np.cos(5 * time)])
    errors = ankle.errors_along(time, path)
    spline = scipy.interpolate.make_interp_spline(time, path, k=5)
    rest = ankle.rest_effort(path, spline.derivative(1)(time), spline.derivative(2)(time))
    np.testing.assert_allclose(errors["serial equivalent"] - rest, errors["serial with table"], atol=1e-12)
    with pytest.raises(LinkplanError, match=r"must be \(n, 2\)"):
        ankle.rest_effort(path, path, path[:, :1])


def test_a_plan_s_motion_of_the_output_has_the_slopes_of_its_positions(knee):
    motion = motion_of_plan(optimal("knee-reach"), knee.transfer.outputs)
    assert isinstance(motion, OutputMotion)
    inside = slice(20, -20)
    velocity = np.gradient(motion.position[:, 0], motion.time_s)
    assert np.abs(velocity - motion.velocity[:, 0])[inside].max() < 1e-2 * np.abs(velocity).max()
    slope = np.gradient(motion.velocity[:, 0], motion.time_s)
    assert np.median(np.abs(slope - motion.acceleration[:, 0])[inside]) < 1e-2 * np.abs(slope).max()


def test_the_effort_needed_along_a_plan_is_the_plan_s_effort_carried_across(knee):
    plan = optimal("knee-reach")
    motion = knee.transfer.serial.errors
    u = np.array([plan.trajectory.effort_at(np.array([t]))[0, 0] for t in motion.motion.time_s])
    q = np.degrees(motion.motion.position[:, 0])
    (G,) = np.array([knee.transfer.table.grid.at("ratio", motion.motion.position)[:, 0, 0]])
    assert np.ptp(q) > 30
    off = np.abs(motion.effort[:, 0] - G * u)
    assert np.median(off) < 1e-2 * np.abs(motion.effort).max()  # the table's interpolation; efforts jump at switches


@pytest.mark.slow
def test_the_command_states_the_errors_along_a_plan(saved_reach, tmp_path, capsys):
    words = ["transfer", "knee-reach", "--joints", "C", "--tolerance", "0.02", "--along", str(saved_reach), "--json"]
    assert main([*words, "-o", str(tmp_path / "out")]) == 0
    errors = json.loads(capsys.readouterr().out)["serial"]["errors"]
    assert 0 < errors["serial with table"]["max"]["C"] < 0.05 * errors["static map"]["max"]["C"]
    assert errors["largest_effort"]["C"] > 100
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"serial.xml", "along.csv"} <= names


def test_a_plan_of_another_payload_is_refused(saved_reach, capsys):
    assert main(["transfer", "optimus-knee", "--joints", "C", "--along", str(saved_reach)]) == 2
    assert "has another model or payload than the table" in capsys.readouterr().err.strip().splitlines()[-1]


def test_a_linkage_without_a_serial_equivalent_says_why():
    found = linkplan.transfer("five-bar", ["O1", "P"], tolerance=0.5, range_deg={"O1": [-110, -70], "P": [35, 60]})
    with pytest.raises(LinkplanError, match="joint P moves on a part of the linkage"):
        assert found.serial_mjcf
    assert found.to_dict()["serial"] is None


@pytest.mark.parametrize(
    ("time", "path", "said"),
    [
        (np.linspace(0, 1, 20), np.full((20, 2), 3.0), "the table goes"),
        (np.linspace(0, 1, 5), np.zeros((5, 2)), "with n of at least 10"),
        (np.zeros(20), np.zeros((20, 2)), "times must increase"),
        (np.linspace(0, 1, 20), np.zeros((20, 3)), r"positions \(n, 2\)"),
    ],
)
def test_a_motion_that_cannot_be_followed_is_refused(ankle, time, path, said):
    with pytest.raises(LinkplanError, match=said):
        ankle.errors_along(time, path)


# A crank moves a lever of the same length by a rod, so that both turn alike. The gear of the motor is -3. The joint of the
# lever is off the origin of its body, the body is turned, and it carries another joint.
PARALLELOGRAM = """<mujoco model="parallelogram"><compiler angle="radian" autolimits="true"/><worldbody><body name="crank">
<joint name="O" axis="0 1 0" range="-1 1" armature="0.002" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.01" mass="0.2"/>
<body name="rod" pos="0 0 0.1"><joint name="A" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.01" mass="0.3"/></body></body>
<body name="lever" pos="0.3 0.02 0.1" quat="0 1 0 0"><joint name="B" axis="0 -1 0" pos="0 0.02 0.1"
range="-0.9 0.9" damping="0.2" frictionloss="0.3"/>
<geom type="box" size="0.02 0.03 0.08" pos="0.01 0 0.02" quat="1 0.2 0 0.1" mass="0.5"/>
<body name="tip" pos="0 0 -0.1"><joint name="T" axis="1 0 0" range="-0.5 0.5"/><joint name="S" axis="0 0 1"
type="slide" range="-0.05 0.05"/><geom type="sphere" size="0.02" mass="0.1"/></body></body></worldbody><equality>
<connect body1="rod" body2="lever" anchor="0.3 0 0"/></equality><actuator><motor name="drive" joint="O" gear="-3"
ctrlrange="-2 2"/><motor name="push" joint="S" gear="1" ctrlrange="-5 5"/><motor name="tilt" joint="T" ctrlrange="-1 1"/>
</actuator></mujoco>"""


@pytest.fixture(scope="module")
def lever():
    mechanism = linkplan.load_mechanism(PARALLELOGRAM)
    return linkplan.transfer(mechanism, ["B"], motor_speed=[30.0]).transfer


@pytest.fixture(scope="module")
def loaded_ankle():
    mechanism = linkplan.load_mechanism(parallel_ankle.ankle_text())
    return linkplan.transfer(mechanism, ["ankle_pitch", "ankle_roll"], tolerance=0.05).transfer


def converted(found, tmp_path) -> mujoco.MjModel:
    """Return the URDF as MuJoCo's own converter reads it."""
    path = tmp_path / "serial.urdf"
    path.write_text(urdf_text(found))
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    return spec.compile()


def inertia_and_weight(model: mujoco.MjModel, by_name: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mass matrix without armature and the gravity forces at joint positions, sorted by the joints' names."""
    model.dof_armature[:] = 0
    data = mujoco.MjData(model)
    for name, position in by_name.items():
        data.joint(name).qpos[:] = position
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    order = [int(model.joint(name).dofadr[0]) for name in sorted(by_name)]
    return M[np.ix_(order, order)], data.qfrc_bias[order]


@pytest.mark.parametrize("of", ["lever", "loaded_ankle"])
def test_the_urdf_is_the_same_tree_as_the_mjcf(of, request, tmp_path):
    found = request.getfixturevalue(of)
    tree, urdf = mujoco.MjModel.from_xml_string(found.serial.model.text), converted(found, tmp_path)
    names = [tree.joint(j).name for j in range(tree.njnt)]
    random = np.random.default_rng(0)
    for _ in range(5):
        at = dict(zip(names, random.uniform(-0.04, 0.04, len(names)).tolist(), strict=True))
        for mine, theirs in zip(inertia_and_weight(urdf, at), inertia_and_weight(tree, at), strict=True):
            assert np.abs(theirs).max() > 1e-3
            np.testing.assert_allclose(mine, theirs, atol=2e-6 * np.abs(theirs).max())  # the links between joints
    for name in names:
        mine, theirs = urdf.joint(name), tree.joint(name)
        np.testing.assert_allclose(mine.range, theirs.range, atol=1e-6)
        np.testing.assert_allclose(np.ravel(mine.damping)[0], np.ravel(theirs.damping)[0], rtol=1e-5)
        np.testing.assert_allclose(mine.frictionloss, theirs.frictionloss, rtol=1e-5)


def test_a_constant_ratio_is_a_simple_transmission_whose_motor_has_the_joint_s_power(lever):
    ((motor, reduction, offset),) = reductions(lever)
    assert (motor, reduction) == (0, pytest.approx(-3.0, rel=1e-9))  # B turns with O, the gear against it
    places = lever.table.grid.values["motor_position"][:, 0]
    np.testing.assert_allclose(reduction * (lever.table.grid.axes[0] - offset), places, atol=1e-9)
    root = ET.fromstring(urdf_text(lever))
    (tag,) = root.findall("transmission")
    assert tag.findtext("type") == "transmission_interface/SimpleTransmission"
    assert tag.find("joint").get("name") == "B"
    assert float(tag.findtext("actuator/mechanicalReduction")) == reduction
    limit = root.find("joint[@name='B']/limit")
    assert float(limit.get("effort")) == pytest.approx(6.0)
    assert float(limit.get("velocity")) == pytest.approx(10.0)
    assert float(root.find("joint[@name='S']/limit").get("effort")) == 5.0
    assert "no <transmission>" not in " ".join(urdf_notes(lever))


def test_a_ball_joint_has_no_urdf_and_a_reason():
    joints = re.compile(r'<joint name="T".*?range="-0.05 0.05"/>', re.DOTALL)
    text = joints.sub('<joint name="T" type="ball" damping="1"/>', PARALLELOGRAM)
    text = re.sub(r'<motor name="(push|tilt)".*?/>', "", text, flags=re.DOTALL)
    found = linkplan.transfer(linkplan.load_mechanism(text), ["B"])
    assert found.to_dict()["serial_urdf"]["left_out"] == ["there is none: a URDF has no ball joint"]
    with pytest.raises(LinkplanError, match="no ball joint"):
        _ = found.serial_urdf


def test_a_changing_ratio_has_no_transmission_and_a_reason(loaded_ankle):
    assert reductions(loaded_ankle) == []
    text = urdf_text(loaded_ankle)
    assert "<transmission " not in text
    (note,) = [note for note in urdf_notes(loaded_ankle) if "transmission" in note]
    assert "G changes by" in note
    assert note in text  # the file says so itself
    assert any("speed limits are 1000" in one for one in urdf_notes(loaded_ankle))
