"""Couplings with a small coefficient, as of lead screws: soft in MuJoCo, named by check, stiff with solref = "stiff"."""

import mujoco
import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.selected_model import whole_model_text
from linkplan.studies.check.new.first_motion import first_motion
from linkplan.studies.check.softness import soft_closures, softness_note

LEAD_M_PER_RAD, MASS_KG, OFFSET_M = 0.0016, 3.0, 0.02
# A nut that carries a weight, written as the nut's position over the motor's.
SCREW = f"""<mujoco><option timestep="2e-4"/><worldbody>
  <body><joint name="motor" axis="0 0 1" damping="0.01"/><inertial mass="1" pos="0 0 0" diaginertia="1e-3 1e-3 1e-3"/></body>
  <body pos="0 0 0.5"><joint name="nut" type="slide" axis="0 0 1"/><geom size="0.05" mass="{MASS_KG}"/></body></worldbody>
  <equality><joint name="screw" joint1="nut" joint2="motor" polycoef="{OFFSET_M} {LEAD_M_PER_RAD} 0 0 0" solref="0.001 1"/>
  </equality><actuator><motor name="m" joint="motor" ctrlrange="-0.1 0.1"/></actuator></mujoco>"""


def simulated_gap_m(model: mujoco.MjModel) -> float:
    """Return how far the nut is from where the motor puts it, once the weight rests on it."""
    data = mujoco.MjData(model)
    data.qpos[model.joint("nut").qposadr[0]] = OFFSET_M
    data.ctrl[0] = MASS_KG * 9.81 * LEAD_M_PER_RAD
    mujoco.mj_step(model, data, 20_000)
    motor, nut = (float(data.joint(name).qpos[0]) for name in ("motor", "nut"))
    return abs(nut - OFFSET_M - LEAD_M_PER_RAD * motor)


def test_check_states_the_gap_that_mujoco_leaves_and_the_coupling_written_the_other_way():
    mechanism = load_mechanism(SCREW)
    measured = simulated_gap_m(mechanism.model)
    assert measured > 1e-3  # the effect is there
    (soft,) = soft_closures(mechanism)
    assert soft.weight_gap_m == pytest.approx(measured, rel=0.02)
    note = softness_note(mechanism)
    assert note is not None
    assert 'joint1="motor" joint2="nut" polycoef="-12.5 625 0 0 0"' in note


def test_stiff_loops_write_the_coupling_the_other_way_in_the_simulated_model():
    mechanism = load_mechanism(SCREW, solref="stiff")
    assert simulated_gap_m(mechanism.model) < 1e-7
    assert softness_note(mechanism) is None
    plain = load_mechanism(SCREW)
    pose = np.array(mechanism.home)
    assert np.array(mechanism.dynamics.velocity_map(pose)) == pytest.approx(np.array(plain.dynamics.velocity_map(pose)))
    # The model that linkplan writes is the model that it simulates.
    written = mujoco.MjModel.from_xml_string(whole_model_text(mechanism))
    assert simulated_gap_m(written) < 1e-7


@pytest.mark.parametrize("polycoef", ["0 0.0016 0 0 0", "0 0.0016 0.001 0 0"])
def test_a_gap_is_measured_on_the_nut_however_the_screw_is_written(polycoef):
    mechanism = load_mechanism(SCREW.replace(f"{OFFSET_M} {LEAD_M_PER_RAD} 0 0 0", polycoef))
    turned = SCREW.replace('joint1="nut" joint2="motor"', 'joint1="motor" joint2="nut"')
    other = load_mechanism(turned.replace(f"{OFFSET_M} {LEAD_M_PER_RAD} 0 0 0", "0 625 0 0 0"))
    open_by = np.array([0.0, 3e-4])  # the nut, with the motor at rest
    assert mechanism.gaps_by_unit(open_by[None])["m"] == pytest.approx([3e-4])
    assert other.gaps_by_unit(open_by[None])["m"] == pytest.approx([3e-4])


def test_a_screw_written_with_a_large_coefficient_locks_nothing():
    model = """<mujoco><compiler angle="degree"/>
      <default><joint axis="0 -1 0"/><geom contype="0" conaffinity="0"/></default><worldbody>
      <body><joint name="motor" axis="0 0 1"/><inertial mass="0.2" pos="0 0 0" diaginertia="1e-5 1e-5 2e-5"/></body>
      <body pos="-0.045 0 -0.15"><joint name="nut" type="slide" axis="0 0 1" damping="40"/><geom size="0.01"/>
        <body name="link"><joint name="eye_u"/>
          <geom type="capsule" fromto="0 0 0 -0.005 0 -0.23" size="0.005"/></body></body>
      <body name="shank" pos="0 0 -0.4"><joint name="knee" range="-5 100"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02"/></body></worldbody>
      <equality><connect body1="link" body2="shank" anchor="-0.005 0 -0.23"/>
        <joint name="screw" joint1="motor" joint2="nut" polycoef="0 6283.2 0 0 0"/></equality>
      <actuator><motor joint="motor" ctrlrange="-1 1"/></actuator></mujoco>"""
    mechanism = load_mechanism(model)
    assert mechanism.dof == 1
    assert not any("locked" in note for note in mechanism.notes)


def test_new_makes_a_screw_stiff_that_a_motion_opens(tmp_path):
    text = SCREW.replace("1e-3 1e-3 1e-3", "2e-5 2e-5 2e-5")  # a light rotor makes the row softer
    (tmp_path / "screw.xml").write_text(text.replace('name="nut" type', 'name="nut" range="-0.2 0.2" limited="true" type'))
    found = first_motion({"model": str(tmp_path / "screw.xml")}, lambda _: None)
    assert found.plan is not None
    assert found.tables["mechanism"]["solref"] == "stiff"
