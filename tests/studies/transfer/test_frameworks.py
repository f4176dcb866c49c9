"""The file of actuators for training frameworks: a calf behind a coupling, and its look-up at many poses."""

import runpy
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import linkplan

# A calf whose motor turns 1.9169 times as far.
CALF = """<mujoco><worldbody><body name="rotor"><joint name="m" axis="0 1 0" armature="0.004"/>
<inertial pos="0 0 0" mass="0.1" diaginertia="1e-5 1e-5 1e-5"/></body><body name="calf"><joint name="calf" axis="0 1 0"
range="-60 60"/><inertial pos="0 0 -0.1" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody>
<equality><joint joint1="m" joint2="calf" polycoef="0 1.9169 0 0 0"/></equality>
<actuator><motor name="motor" joint="m" ctrlrange="-23.7 23.7"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calf")
    linkplan.transfer(CALF, ["calf"], motor_speed=30.1, motor_kp=20.0, motor_kd=0.5).save(folder / "calf")
    return folder / "calf"


def test_a_calf_has_the_limits_of_its_motor_behind_the_coupling(written, monkeypatch):
    found = runpy.run_path(str(written / "actuators.py"))
    calf = found["ACTUATORS"]["calf"]
    assert (calf["effort_limit"], calf["velocity_limit"]) == (pytest.approx(45.43, abs=5e-3), pytest.approx(15.70, abs=5e-3))
    assert calf["saturation_effort"] == calf["effort_limit"]  # without a torque-speed line
    assert calf["stiffness"] == pytest.approx(20 * 1.9169**2, rel=1e-5)
    assert calf["armature"] == pytest.approx(0.004 * 1.9169**2, rel=1e-5)
    made = SimpleNamespace(DCMotorCfg=lambda **values: values)
    monkeypatch.setitem(sys.modules, "isaaclab", SimpleNamespace(actuators=made))
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", made)
    assert found["isaac_lab"]() == {"calf": {"joint_names_expr": ["calf"], **calf}}


def test_the_look_up_interpolates_the_table_at_many_poses_at_once(tmp_path):
    table = linkplan.transfer("five-bar", ["O1", "O2"], range_deg={"O1": [-125.0, -85.0], "O2": [-105.0, -75.0]})
    table.save(tmp_path / "arm")
    at = runpy.run_path(str(tmp_path / "arm" / "actuators.py"))["at"]
    poses = np.radians(np.random.default_rng(0).uniform([-120.0, -100.0], [-90.0, -80.0], (4096, 2)))
    np.testing.assert_allclose(at("inertia", poses), table.at("inertia", poses), rtol=1e-12)
