"""Soft loops and couplings: the gap that MuJoCo leaves, and what to write."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from linkplan.models.library import built_in_text
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.selected_model import whole_model_text
from linkplan.studies.check.inspection import inspect
from linkplan.studies.check.new.first_motion import first_motion
from linkplan.studies.check.softness import home_gap, soft_closures, softness_note
from tests.support.tolerances_loops import SETTLED_SPEED

STIFF = built_in_text("optimus-knee")
SOFT = re.sub(r' solref="[^"]*" solimp="[^"]*"', "", STIFF)
# A heavier rocker, whose weight passes through the pin, and a crank that comes to rest.
HEAVY = SOFT.replace('<geom name="B" class="rocker"', '<geom name="B" class="rocker" mass="0.8"').replace(
    '<joint name="O"', '<joint name="O" damping="0.2"'
)
# MuJoCo's own settled gap beside the law's: the pose gives way with the loop.
SETTLED = 0.03
# A stiff spring that holds the crank, and a run of many time constants of the loop [N.m/rad, s].
KP, RUN_S = 2e3, 0.6


def settled_gap(mechanism: Mechanism, effort: float) -> float:
    """Return the gap [m] at which MuJoCo settles with the crank held at home and a torque on it beside."""
    model = mechanism.model
    data = mujoco.MjData(model)
    home = mechanism.qpos_of(mechanism.home)
    data.qpos[:] = home
    for _ in range(round(RUN_S / model.opt.timestep)):
        data.ctrl[0] = effort - KP * (data.qpos[0] - home[0])
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < SETTLED_SPEED
    return mechanism.gap_m(mechanism.q_of(data.qpos))


def hold(mechanism: Mechanism) -> float:
    still = np.zeros((1, 1))
    return needed_effort(mechanism, mechanism.home[None], still, still)[0].item()


# The second begins at impedance 0, which MuJoCo clips, and gets stiff within a millimetre.
@pytest.mark.parametrize("connect", ["<connect ", '<connect solimp="0 1 0.001 0.5 2" '])
def test_mujoco_settles_with_the_gap_that_is_told_for_the_weight(connect):
    mechanism = load_mechanism(HEAVY.replace("<connect ", connect))
    (soft,) = soft_closures(mechanism, 0.0)
    found = settled_gap(mechanism, hold(mechanism))
    assert found > 1e-4
    assert soft.weight_gap_m == pytest.approx(found, rel=SETTLED)
    assert home_gap(mechanism) * mechanism.extent_m == pytest.approx(found, rel=SETTLED)


def test_check_notes_a_soft_loop_and_what_to_write():
    mechanism = load_mechanism(SOFT)
    (note,) = (note for note in inspect(mechanism, []).notes if "opens by" in note)
    assert note == softness_note(mechanism)
    assert "in MuJoCo loop B opens by" in note
    assert 'mechanism.solref = "stiff" leaves' in note
    assert "act_O at its limit" in note


def test_a_stiff_loop_is_not_noted():
    assert softness_note(load_mechanism(STIFF)) is None


def test_a_model_without_a_connect_or_weld_has_nothing_soft():
    assert soft_closures(load_mechanism("cart-pole"), 0.0) == ()


def test_a_gap_that_is_as_wide_as_the_mechanism_is_not_given_in_millimetres():
    mechanism = load_mechanism(SOFT)
    strong = replace(mechanism, actuators=(replace(mechanism.actuators[0], lower=-1e4, upper=1e4),))
    note = softness_note(strong)
    assert note is not None
    assert f"more than {10 * mechanism.extent_m:.2g} mm with act_O at its limit" in note


def test_a_gap_that_is_rounding_is_zero():
    weightless = SOFT.replace("<worldbody>", '<option gravity="0 0 -1e-30"/><worldbody>')
    note = softness_note(load_mechanism(weightless))
    assert note is not None
    assert "opens by 0 mm at rest at home and by" in note


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
