"""Gas springs, gears and rotors: their forces and inertia are those of MuJoCo's model."""

import casadi as ca
import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import simulate_one
from linkplan.models.audit import audit
from linkplan.models.mechanism import load_mechanism
from linkplan.models.tree.dynamics import build_tree
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import build_tracker, tracking_reference
from tests.support.tolerances_planner import ROUNDING

LAW = 'gaintype="fixed" gainprm="0" biastype="affine"'
STRUT = f'<general name="gas" tendon="strut" gear="1.5" {LAW} biasprm="-40 30 -3" forcerange="-30 -25" forcelimited="true"/>'
TORSION = f'<general name="torsion" joint="rod" gear="-2" {LAW} biasprm="0.2 -0.5 -0.1"/>'
# An arm and a rod on motors; a strut between the arm and the wall.
ARM = """<mujoco><option timestep="2e-4"/><default><geom contype="0" conaffinity="0"/></default>
  <worldbody><site name="wall" pos="-0.1 0 0.1"/>
    <body name="arm"><joint name="arm" axis="0 -1 0" range="-80 80"/>
      <geom type="capsule" fromto="0 0 0 0.4 0 0" size=".02" mass="2"/><site name="eye" pos="0.2 0 0"/>
      <body name="rod" pos="0.4 0 0"><joint name="rod" axis="0 -1 0" %s/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size=".02" mass="1"/></body></body></worldbody>
  <tendon><spatial name="strut"><site site="wall"/><site site="eye"/></spatial></tendon>
  <actuator><motor name="a" joint="arm" ctrlrange="-30 30"/><motor name="r" joint="rod" ctrlrange="-9 9"/>%s</actuator>
</mujoco>"""


def test_their_forces_are_mujocos_within_and_at_their_range():
    mechanism, clamped = load_mechanism(ARM % ("", STRUT + TORSION)), []
    assert [actuator.name for actuator in mechanism.actuators] == ["a", "r"]
    data, rng = mujoco.MjData(mechanism.model), np.random.default_rng(0)
    for _ in range(100):
        q, v = rng.uniform(-1.2, 1.2, 2), rng.normal(size=2) * 4
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(mechanism.model, data)
        own = np.array(mechanism.dynamics.passive(q, v)).ravel()
        np.testing.assert_allclose(own, data.qfrc_passive + data.qfrc_actuator, atol=ROUNDING)
        clamped.append(float(data.actuator_force[2]) in (-30.0, -25.0))
    assert 10 < sum(clamped) < 90


def test_their_energy_is_the_work_of_their_force_at_rest():
    tree = build_tree(load_mechanism(ARM % ("", STRUT + TORSION)).model)
    balance = ca.jacobian(tree.potential_energy, tree.q).T - tree.gravity + tree.passive
    at_rest = ca.Function("balance", [tree.q], [ca.substitute(balance, tree.qd, 0)])
    for q in np.random.default_rng(1).uniform(-1.2, 1.2, (50, 2)):
        np.testing.assert_allclose(np.array(at_rest(q)), 0.0, atol=ROUNDING)


def test_a_planned_motion_counts_them_and_is_followed_in_mujoco():
    mechanism = load_mechanism(ARM % ("", STRUT + TORSION))
    (strut, torsion) = audit(mechanism.model)
    assert strut.text.endswith("it has no gain: a passive force, such as a gas spring's; plans include it")
    assert not any(one.falsifies for one in (strut, torsion))
    ends = {"start_deg": {"arm": 0.0, "rod": 0.0}, "goal_deg": {"arm": 40.0, "rod": -30.0}}
    plan = plan_motion(Problem.reach(mechanism, **ends, duration_s=0.5)).require()
    plant = MujocoPlant(mechanism=mechanism, loop=ControlLoop(effort_limit=plan.problem.limits.effort))
    reference = tracking_reference(plan)
    run = simulate_one(plant, build_tracker("pd+ff", plan, reference), reference)
    assert np.degrees(np.abs(run.error_rad).max()) < 0.1


@pytest.mark.parametrize(
    ("range_of_joint", "law"),
    [('actuatorfrcrange="-1 1" actuatorfrclimited="true"', LAW), ("", 'gaintype="affine" gainprm="0 1" biastype="affine"')],
    ids=["a clamp of the joint's whole effort", "a gain that vanishes at zero length only"],
)
def test_forces_that_a_clamp_or_a_control_changes_are_not_among_them(range_of_joint, law):
    actuator = f'<general name="torsion" joint="rod" {law} biasprm="0.2 -0.5 -0.1"/>'
    found = [one for one in audit(load_mechanism(ARM % (range_of_joint, actuator)).model) if "torsion" in one.text]
    assert any(one.falsifies and "its gain vanishes at rest" in one.text for one in found)


def test_forces_on_a_tendon_whose_length_is_not_known_are_not_among_them():
    """A side site within the sphere: the cord wraps around its inside."""
    drum = '<geom name="drum" type="sphere" size=".05" pos="0.05 0 0.1"/><site name="in" pos="0.05 0 0.1"/>'
    inside = ARM.replace('<site name="wall"', f'{drum}<site name="wall"').replace(
        '<site site="wall"/>', '<site site="wall"/><geom geom="drum" sidesite="in"/>'
    )
    (found,) = [one for one in audit(load_mechanism(inside % ("", STRUT)).model) if "actuator gas" in one.text]
    assert found.falsifies
    assert "plans leave it out, though it acts at zero control too" in found.text


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
        ({"gear": {"act": 0.0}}, "mechanism.gear.act must be a number other than 0, got 0"),
        ({"gear": {"acr": 2.0}}, "unknown actuator in mechanism.gear 'acr' (did you mean 'act'?)"),
        ({"gear": {"push": 2.0}}, "mechanism.gear.push: the actuator acts on site 'tip', which no single gear moves"),
        ({"rotor_inertia": {"push": 1.0}}, "mechanism.rotor_inertia.push: the actuator acts on site 'tip'; a rotor turns"),
        ({"rotor_inertia": {"act": -1.0}}, "mechanism.rotor_inertia.act must be a number of at least 0, got -1"),
        ({"rotor_inertia": {"act": "big"}}, "mechanism.rotor_inertia.act must be a number of at least 0, got 'big'"),
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
