"""The serial equivalent as URDF: the tree of the MJCF, a transmission where the ratio is constant, else a reason."""

import re
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.models.errors import LinkplanError
from linkplan.studies.handover.transfer.serial_urdf import reductions, urdf_notes, urdf_text
from tests.support import parallel_ankle

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
    return linkplan.transfer(mechanism, ["B"], motor_speed=[30.0]).found


@pytest.fixture(scope="module")
def ankle():
    mechanism = linkplan.load_mechanism(parallel_ankle.ankle_text())
    return linkplan.transfer(mechanism, ["ankle_pitch", "ankle_roll"], tolerance=0.05).found


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


@pytest.mark.parametrize("of", ["lever", "ankle"])
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


def test_a_changing_ratio_has_no_transmission_and_a_reason(ankle):
    assert reductions(ankle) == []
    text = urdf_text(ankle)
    assert "<transmission " not in text
    (note,) = [note for note in urdf_notes(ankle) if "transmission" in note]
    assert "G changes by" in note
    assert "transmission.hpp" in note
    assert note in text  # the file says so itself
    assert any("speed limits are 1000" in one for one in urdf_notes(ankle))
