"""Gears and rotors of motors against MuJoCo's own mass matrix and inverse dynamics, and their refusals."""

import mujoco
import numpy as np
import pytest

import linkplan

GEAR, ROTOR = 9.0, 2e-4
# A bar on a hinge and a mass that slides along it, both driven, and a cable over both.
MODEL = """<mujoco><option gravity="0 0 -9.81"/><worldbody>
<body><joint name="bar" axis="0 1 0" damping="0.1"/><inertial pos="0.3 0 0" mass="2" diaginertia="0.01 0.02 0.03"/>
  <site name="tip" pos="0.6 0 0"/>
  <body pos="0.5 0 0"><joint name="mass" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/>
  </body></body>
</worldbody><tendon><fixed name="cable"><joint joint="bar" coef="0.2"/><joint joint="mass" coef="1"/></fixed></tendon>
<actuator><motor name="act" joint="bar" gear="2" ctrlrange="-9 9"/><motor name="pull" tendon="cable" ctrlrange="-9 9"/>
<motor joint="mass"/><motor name="push" site="tip" gear="0 0 1 0 0 0"/></actuator></mujoco>"""


def geared(**of):
    return linkplan.load_mechanism(MODEL, **of)


def by_hand(act: str = "", pull: str = "") -> mujoco.MjModel:
    """Return the model with the attributes of two of its motors written by hand."""
    text = MODEL.replace('gear="2"', act) if act else MODEL
    return mujoco.MjModel.from_xml_string(text.replace('tendon="cable" ctrl', f'tendon="cable" {pull} ctrl'))


@pytest.mark.parametrize(
    ("name", "hand"),
    [("act", {"act": f'gear="{GEAR}" armature="{ROTOR}"'}), ("pull", {"pull": f'gear="{GEAR}" armature="{ROTOR}"'})],
)
def test_efforts_with_a_gear_and_a_rotor_are_those_of_the_simulator_s_inverse_dynamics(name, hand):
    mechanism, model = geared(gear={name: GEAR}, rotor_inertia={name: ROTOR}), by_hand(**hand)
    rng = np.random.default_rng(3)
    q, v, a = rng.uniform(-1, 1, (3, 2))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
    mujoco.mj_inverse(model, data)
    tau = np.array(mechanism.dynamics.inverse_dynamics(q, v, a)).ravel()
    np.testing.assert_allclose(tau, data.qfrc_inverse, rtol=1e-10)
    bare = np.array(geared().dynamics.inverse_dynamics(q, v, a)).ravel()
    assert abs(tau - bare).max() > 1e-3  # the rotor is felt
    column = [one.name for one in mechanism.actuators].index(name)
    arms = {"act": [GEAR, 0.0], "pull": [0.2 * GEAR, GEAR]}[name]
    np.testing.assert_allclose(np.array(mechanism.dynamics.effort_map(q))[:, column], arms, rtol=1e-12)


def test_an_armature_of_the_joint_itself_stays_and_is_said():
    model = MODEL.replace('name="bar" axis', 'name="bar" armature="0.5" axis')
    mechanism = linkplan.load_mechanism(model, rotor_inertia={"act": ROTOR})
    assert "joint bar has an armature of 0.5 in the model, which is added to the rotor of act" in mechanism.notes
    inertia = np.array(mechanism.dynamics.reduced_inertia(np.zeros(2)))[0, 0]
    assert inertia == pytest.approx(0.02 + 2 * 0.3**2 + 1 + 3 * 0.5**2 + 0.5 + 2**2 * ROTOR, rel=1e-12)


def test_a_motor_without_a_name_is_named_as_in_messages():
    # On a slide a gear other than 1 belongs to a rotary motor, so that its effort is a torque.
    mechanism = geared(gear={"actuator 2": 50.0})
    assert [one.unit for one in mechanism.actuators if one.target == "joint mass"] == ["N.m"]


@pytest.mark.parametrize(
    ("of", "said"),
    [
        ({"gear": {"act": 0.0}}, "mechanism.gear.act is a number other than 0, got 0"),
        ({"gear": {"acr": 2.0}}, "unknown actuator in mechanism.gear 'acr' (did you mean 'act'?)"),
        ({"gear": {"push": 2.0}}, "mechanism.gear.push: the actuator acts on site 'tip', which no single gear moves"),
        ({"rotor_inertia": {"push": 1.0}}, "mechanism.rotor_inertia.push: the actuator acts on site 'tip'; a rotor turns"),
        ({"rotor_inertia": {"act": -1.0}}, "mechanism.rotor_inertia.act is a number of at least 0, got -1"),
        ({"rotor_inertia": {"act": "big"}}, "mechanism.rotor_inertia.act is a number of at least 0, got 'big'"),
    ],
)
def test_gears_and_rotors_that_cannot_be_are_refused_in_one_line(of, said):
    with pytest.raises(linkplan.LinkplanError) as error:
        geared(**of)
    assert str(error.value).startswith(said)


def test_a_problem_with_a_gear_and_a_rotor_is_written_and_read_back():
    problem = linkplan.Problem.from_file("knee-reach", {"mechanism.gear.act_O": 2.0, "mechanism.rotor_inertia.act_O": 1e-3})
    again = linkplan.Problem.from_file(problem.to_toml())
    assert again.mechanism.fingerprint() == problem.mechanism.fingerprint()
    assert again.mechanism.actuators[0].gear == 2.0
