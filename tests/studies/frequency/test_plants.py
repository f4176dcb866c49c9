"""Plants with fewer or more actuators than freedoms: against transfer functions in closed form, and measured in MuJoCo."""

import numpy as np
import pytest

import linkplan
from linkplan.studies.feedback.frequency.transfer_function import plant_modes

MOTOR, LOAD, STIFFNESS, DAMPING, AT_MOTOR, AT_LOAD = 0.02, 0.01, 200.0, 0.1, 0.01, 0.02  # SI units
TWO_MASSES = f"""
<mujoco model="two-mass">
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="motor"><joint name="m" axis="0 1 0" damping="{AT_MOTOR}"/><inertial pos="0 0 0" mass="1"
      diaginertia="{MOTOR} {MOTOR} {MOTOR}"/></body>
    <body name="load" pos="0 0.2 0"><joint name="l" axis="0 1 0" damping="{AT_LOAD}"/><inertial pos="0 0 0" mass="1"
      diaginertia="{LOAD} {LOAD} {LOAD}"/></body>
  </worldbody>
  <tendon><fixed name="spring" stiffness="{STIFFNESS}" damping="{DAMPING}"><joint joint="m" coef="1"/><joint joint="l"
    coef="-1"/></fixed></tendon>
  <actuator><motor name="drive" joint="m" ctrlrange="-20 20"/></actuator>
</mujoco>
"""
LINK = """
<mujoco model="link">
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody><body><joint name="k" axis="0 1 0" armature="0.02" damping="0.05" range="-90 90"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body></worldbody>
  <actuator>MOTORS</actuator>
</mujoco>
"""
ONE = '<motor name="a" joint="k" ctrlrange="-20 20"/>'
TWO = ONE + '<motor name="b" joint="k" gear="3" ctrlrange="-5 5"/>'


def motor_and_load(s):
    """Return the transfer functions from the motor's torque to both angles: two masses, spring and damper between them."""
    between = STIFFNESS + DAMPING * s
    motor, load = MOTOR * s**2 + AT_MOTOR * s + between, LOAD * s**2 + AT_LOAD * s + between
    determinant = motor * load - between**2
    return load / determinant, between / determinant


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    model = tmp_path_factory.mktemp("plants") / "two.xml"
    model.write_text(TWO_MASSES)
    return linkplan.bode(str(model), kp=20.0, kd=0.5, frequency_hz=[2.0, 10.0, 22.0, 28.0, 60.0])


def test_the_plant_to_motor_and_load_is_that_of_two_masses(study):
    (entry,) = study.points
    frequency = np.array([0.5, 5.0, 22.0, 22.6, 27.0, 80.0])
    own, other = motor_and_load(2j * np.pi * frequency)
    assert entry.ideal.gains("plant", frequency, 0) == pytest.approx(own, rel=1e-9)
    assert entry.ideal.gains("plant", frequency, 0, 1) == pytest.approx(other, rel=1e-9)


def test_a_motor_behind_a_spring_stands_still_at_the_frequency_of_the_load_alone(study):
    (entry,) = study.points
    load = np.roots([LOAD, AT_LOAD + DAMPING, STIFFNESS])
    both = np.roots(np.polysub(
        np.polymul([MOTOR, AT_MOTOR + DAMPING, STIFFNESS], [LOAD, AT_LOAD + DAMPING, STIFFNESS]),
        np.polymul([DAMPING, STIFFNESS], [DAMPING, STIFFNESS]),
    ))  # fmt: skip
    swings = max(both, key=lambda root: root.imag)
    for root, modes in ((load[0], entry.plant["m"].anti_resonances), (swings, entry.plant["m"].resonances)):
        (mode,) = modes
        assert mode.frequency_hz == pytest.approx(abs(root) / (2 * np.pi), rel=1e-9)
        assert mode.damping_ratio == pytest.approx(-root.real / abs(root), rel=1e-7)
    assert entry.plant["l"].anti_resonances == ()
    assert entry.plant["l"].resonances == entry.plant["m"].resonances


def test_mujoco_moves_motor_and_load_as_predicted(study):
    (entry,) = study.points
    assert study.stable
    for name in ("plant", "plant to l", "loop"):
        measured = entry.responses[name]
        assert measured.coherence.min() > 0.9999
        assert np.abs(measured.less_predicted_db).max() < 0.01, name
        assert np.abs(measured.less_predicted_deg).max() < 0.1, name
    far = entry.responses["plant to l"]
    low = far.frequency_hz < 50.0  # at 60 Hz the simulator's steps of 0.5 ms err by 2 %
    _, other = motor_and_load(2j * np.pi * far.frequency_hz[low])  # without a hold: the phase is half a period behind
    assert np.abs(far.gain[low]) == pytest.approx(np.abs(other), rel=5e-3)


def test_two_motors_on_one_joint_share_the_effort_of_one_loop(tmp_path):
    margins = []
    for name, motors in (("one", ONE), ("two", TWO)):
        model = tmp_path / f"{name}.xml"
        model.write_text(LINK.replace("MOTORS", motors))
        found = linkplan.bode(str(model), kp=20.0, kd=0.5, at_deg=[{"k": 30.0}], frequency_hz=[3.0, 30.0])
        assert found.stable
        (entry,) = found.points
        assert entry.settles_in_mujoco
        assert np.abs(entry.responses["loop"].less_predicted_db).max() < 0.01
        margins.append([entry.phase_margin_deg, entry.gain_margin_db, entry.crossover_hz, entry.disk_margin])
    assert margins[0] == pytest.approx(margins[1], rel=1e-9)


def test_a_hanging_pole_stills_its_cart_at_its_own_frequency():
    found = linkplan.bode("cart-pole", tracker="lqr", measure=False)
    (entry,) = found.points
    mechanism = entry.point.mechanism
    model = mechanism.model
    pole = model.body("pole").id
    arm = np.linalg.norm(model.body_ipos[pole])
    inertia = model.body_inertia[pole].max() + model.body_mass[pole] * arm**2
    alone = np.sqrt(model.body_mass[pole] * 9.81 * arm / inertia) / (2 * np.pi)
    (mode,) = plant_modes(entry.point, entry.channel)["cart"].anti_resonances
    assert mode.frequency_hz == pytest.approx(alone, rel=1e-3)
    assert mode.damping_ratio == 0.0


def test_a_pose_that_does_not_rest_on_its_spring_is_taken_where_it_does(study):
    spring = linkplan.bode(study.mechanism, kp=20.0, kd=0.5, at_deg=[{"m": 40.0}], measure=False).points[0]
    assert np.degrees(spring.point.pose) == pytest.approx([40.0, 40.0], abs=1e-6)


def test_tune_says_up_to_which_frequency_a_load_follows(study):
    told = linkplan.tune(study.mechanism, bandwidth_hz=5.0, phase_margin_deg=45.0, damping_ratio=0.2)
    (mode,) = study.points[0].plant["m"].anti_resonances
    assert told.found
    assert f"swing at {mode.frequency_hz:.4g} Hz" in told.note
