"""Actuators through every transmission: moments, limits, servos inverted, and what a plan cannot use named."""

import mujoco
import numpy as np
import pytest

from linkplan.models.actuation.actuators import Actuator, unusable_reason
from linkplan.models.audit import audit
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import control_excess, needed_controls
from tests.support.linkages import GRIPPER
from tests.support.mechanisms import replaced, simulated
from tests.support.servos import ctrl_of
from tests.support.tolerances import ACTION, MOMENT, TREE, relative_error
from tests.support.tolerances_planner import ROUNDING

# A crank and rod with all that an actuator can act through.
BENCH = """
<mujoco model="bench"><compiler angle="radian" autolimits="true"/>
  <default><geom contype="0" conaffinity="0" size="0.02"/><joint axis="0 1 0"/></default>
  <worldbody><site name="ground" pos="0.3 0.1 0.2" euler="0.2 0.3 1"/>
    <geom name="drum" type="sphere" size="0.05" pos="0.2 0 0"/><site name="inside" pos="0.2 0 0"/>
    <body name="crank"><joint name="crank" %(crank)s/><geom type="capsule" fromto="0 0 0 0.1 0 0.05"/>
      <site name="knee" pos="0.1 0 0.05" euler="1 0.2 0.3"/>
      <body name="rod" pos="0.1 0 0.05"><joint name="rod" %(rod)s/><geom type="capsule" fromto="0 0 0 0.2 0 0"/>
        <site name="end" pos="0.2 0 0" euler="1 -0.2 0.3"/></body></body>
    <body name="cart" pos="0 0.3 0"><joint name="cart" type="slide" axis="1 0 0"/><geom size="0.05"/></body>
  </worldbody>
  <tendon><fixed name="belt" %(belt)s><joint joint="crank" coef="0.5"/><joint joint="cart" coef="-2"/></fixed>
    <spatial name="rope"><site site="ground"/><site site="knee"/><pulley divisor="2"/><site site="end"/><site site="ground"/>
    </spatial>
    <spatial name="wrapped"><site site="ground"/><geom geom="drum" sidesite="inside"/><site site="end"/></spatial></tendon>
  <actuator>%(actuator)s</actuator>
</mujoco>"""


def bench(actuator: str, **extras: str) -> Mechanism:
    return load_mechanism(BENCH % ({"crank": "", "rod": "", "belt": "", "actuator": actuator} | extras))


def only(actuator: str, **extras: str) -> Actuator:
    (found,) = bench(actuator, **extras).actuators
    return found


TRANSMISSIONS = {
    "joint": 'joint="crank" gear="-3"',
    "joint in parent": 'jointinparent="rod" gear="2"',
    "slide": 'joint="cart" gear="2"',
    "fixed tendon": 'tendon="belt" gear="3"',
    "spatial tendon": 'tendon="rope" gear="-1.5"',
    "slider-crank": 'cranksite="end" slidersite="ground" cranklength="0.6" gear="2"',
    "slider-crank on a body": 'cranksite="end" slidersite="knee" cranklength="0.6" gear="2"',
    "slider-crank too short": 'cranksite="end" slidersite="ground" cranklength="0.01"',
    "site": 'site="end" gear="1 2 3 4 5 6"',
    "site force": 'site="end" gear="1 0 -2 0 0 0"',
    "site to ground": 'site="end" refsite="ground" gear="1 2 3 4 5 6"',
    "site to its own chain": 'site="end" refsite="knee" gear="1 2 3 4 5 6"',
}


@pytest.mark.slow
@pytest.mark.parametrize("transmission", TRANSMISSIONS.values(), ids=TRANSMISSIONS)
def test_a_moment_is_mujocos_wherever_the_mechanism_stands(transmission):
    mechanism = bench(f"<motor {transmission}/>")
    for q in np.random.default_rng(0).uniform(-1.5, 1.5, (20, 3)):
        expected = simulated(mechanism.model, q, np.zeros(3)).moment.T
        assert np.abs(expected).max() > 1e-3, "it acts"
        assert relative_error(np.array(mechanism.dynamics.effort_matrix(q)), expected) < MOMENT


@pytest.mark.slow
@pytest.mark.parametrize("transmission", TRANSMISSIONS.values(), ids=TRANSMISSIONS)
def test_an_effort_acts_as_in_mujoco(transmission):
    mechanism = bench(f"<motor {transmission}/>")
    rng = np.random.default_rng(1)
    for q, v in rng.uniform(-1, 1, (10, 2, 3)):
        expected = simulated(mechanism.model, q, v, np.array([0.7])).acceleration
        actual = np.array(mechanism.dynamics.acceleration(q, v, [0.7])).ravel()
        assert relative_error(actual, expected) < ACTION


@pytest.mark.parametrize(
    ("transmission", "target", "joint", "unit"),
    [
        ('joint="crank"', "joint crank", 0, "N.m"),
        ('joint="cart"', "joint cart", 2, "N"),
        ('tendon="belt"', "tendon belt", None, "N"),
        ('cranksite="end" slidersite="ground" cranklength="0.6"', "slider-crank end-ground", None, "N"),
        ('site="end" gear="0 0 0 1 0 0"', "site end", None, "N.m"),
        ('site="end" gear="0 1 0 0 0 0"', "site end", None, "N"),
    ],
)
def test_an_actuator_says_on_what_it_acts(transmission, target, joint, unit):
    actuator = only(f"<motor {transmission}/>")
    assert (actuator.target, actuator.joint, actuator.unit) == (target, joint, unit)


def test_a_joint_that_an_actuator_turns_is_no_dependent_one():
    mechanism = load_mechanism(GRIPPER)
    driven = {actuator.joint for actuator in mechanism.actuators if actuator.joint is not None}
    assert driven <= set(mechanism.independent.tolist())


# Limits

LIMITS = {
    "ctrlrange": ('<motor joint="crank" ctrlrange="-2 3"/>', {}, (-2, 3)),
    "ctrlrange and bias": (
        '<general joint="crank" gainprm="2" biastype="affine" biasprm="0.5 0 0" ctrlrange="-2 3"/>',
        {},
        (-3.5, 6.5),
    ),
    "not limited": ('<motor joint="crank" ctrlrange="-2 3" ctrllimited="false"/>', {}, (-np.inf, np.inf)),
    "forcerange": ('<motor joint="crank" ctrlrange="-2 3" forcerange="-1 1"/>', {}, (-1, 1)),
    "forcerange off": ('<motor joint="crank" ctrlrange="-2 3" forcerange="-1 1" forcelimited="false"/>', {}, (-2, 3)),
    "servo": ('<position joint="crank" kp="5" ctrlrange="-2 3" forcerange="-4 6"/>', {}, (-4, 6)),
    "servo without limits": ('<position joint="crank" kp="5" ctrlrange="-2 3"/>', {}, (-np.inf, np.inf)),
    "joint's range": ('<motor joint="crank" gear="-2"/>', {"crank": 'actuatorfrcrange="-1 3"'}, (-1.5, 0.5)),
    "servo and joint's range": ('<velocity joint="crank" gear="2"/>', {"crank": 'actuatorfrcrange="-1 3"'}, (-0.5, 1.5)),
    "tendon's joint's range": ('<motor tendon="belt" gear="2"/>', {"crank": 'actuatorfrcrange="-1 3"'}, (-1, 3)),
    "tendon's range": ('<motor tendon="belt" gear="2"/>', {"belt": 'actuatorfrcrange="-1 3"'}, (-1, 3)),
}


@pytest.mark.slow
@pytest.mark.parametrize(("actuator", "extras", "limits"), LIMITS.values(), ids=LIMITS)
def test_effort_limits_are_the_narrowest_that_the_model_sets(actuator, extras, limits):
    found = only(actuator, **extras)
    assert relative_error([np.nan_to_num(found.lower), np.nan_to_num(found.upper)], np.nan_to_num(limits)) < TREE


@pytest.mark.parametrize(
    ("actuator", "extras"),
    [(a, e) for name, (a, e, limits) in LIMITS.items() if np.all(np.isfinite(limits))],
    ids=[name for name, (_, _, limits) in LIMITS.items() if np.all(np.isfinite(limits))],
)
def test_mujoco_gives_no_more_than_the_limits_and_all_that_they_allow(actuator, extras):
    mechanism = bench(actuator, **extras)
    (found,) = mechanism.actuators
    moment = simulated(mechanism.model, np.zeros(3), np.zeros(3)).moment[0]
    column = int(np.argmax(np.abs(moment[:2])))  # the joint whose clamp is in question
    for ctrl, end in ((-1e6, found.lower), (1e6, found.upper)):
        data = mujoco.MjData(mechanism.model)
        data.ctrl[:] = ctrl
        mujoco.mj_forward(mechanism.model, data)
        assert abs(data.qfrc_actuator[column] - moment[column] * end) < ROUNDING * max(1.0, abs(end))


def test_a_clamp_on_a_sum_that_no_single_limit_stands_for_falsifies():
    pair = '<motor name="one" joint="crank"/><motor name="two" joint="crank"/>'
    (found,) = audit(bench(pair, crank='actuatorfrcrange="-1 1"').model)
    assert found.falsifies
    assert all(word in found.text for word in ("actuatorfrcrange", "joint crank", "one", "two"))
    (found,) = audit(bench('<motor name="pull" tendon="rope"/>', crank='actuatorfrcrange="-1 1"').model)
    assert found.falsifies
    assert "pull" in found.text
    belt = '<motor name="one" tendon="belt"/><motor name="two" tendon="belt"/>'
    (found,) = audit(bench(belt, belt='actuatorfrcrange="-1 1"').model)
    assert "tendon belt" in found.text
    assert audit(bench(pair).model) == ()


# Servos

SERVOS = {
    "position": '<position joint="crank" kp="5" kv="0.3" gear="2"/>',
    "velocity": '<velocity joint="rod" kv="0.7"/>',
    "position of a tendon": '<position tendon="rope" kp="30" kv="1" gear="-2"/>',
    "position of a slider-crank": '<position cranksite="end" slidersite="ground" cranklength="0.6" kp="20"/>',
    "position of a site": '<position site="end" refsite="ground" gear="1 2 3 0 0 0" kp="20" kv="2"/>',
    "DC motor": '<dcmotor joint="crank" motorconst="0.1 0.12" resistance="2" gear="3"/>',
    "affine gain": '<general joint="crank" gaintype="affine" gainprm="3 0.5 -0.2" biastype="affine" biasprm="1 -2 0.1"/>',
}


@pytest.mark.parametrize("servo", SERVOS.values(), ids=SERVOS)
def test_a_servos_ctrl_for_an_effort_gives_that_effort_in_mujoco(servo):
    mechanism = bench(servo)
    (actuator,) = mechanism.actuators
    assert actuator.is_servo
    for q, v in np.random.default_rng(3).uniform(-1, 1, (10, 2, 3)):
        data = mujoco.MjData(mechanism.model)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(mechanism.model, data)
        length, velocity = float(data.actuator_length[0]), float(data.actuator_velocity[0])
        data.ctrl[0] = ctrl_of(actuator, 0.8, length, velocity)
        mujoco.mj_forward(mechanism.model, data)
        assert abs(data.actuator_force[0] - 0.8) < ROUNDING * max(1.0, abs(data.ctrl[0]))


@pytest.mark.parametrize(
    ("further", "why"),
    [('inductance="0.01"', "state of its own"), ('cogging="0.1 6 0"', "a torque-speed line has no cogging"), ("", None)],
)
def test_a_dc_motor_is_a_torque_speed_line_if_nothing_else_acts_in_it(further, why):
    text = f'<dcmotor name="m" joint="crank" motorconst="0.1" resistance="2" {further}/>'
    model = bench(text + '<motor joint="rod" ctrlrange="-3 3"/>').model
    found = unusable_reason(model, 0)
    assert found is None if why is None else why in found


def test_the_ctrl_that_efforts_need_is_mujocos_and_its_excess_is_counted():
    limited = '<position joint="crank" kp="5" kv="0.3" ctrlrange="-0.4 0.4"/><motor joint="rod" ctrlrange="-3 3"/>'
    mechanism = bench(limited)
    rng = np.random.default_rng(0)
    q, v, u = rng.uniform(-0.5, 0.5, (10, 3)), rng.normal(size=(10, 3)), rng.uniform(-4, 4, (10, 2))
    controls = needed_controls(mechanism, q, v, u)
    assert np.abs(controls[:, 0] - (u[:, 0] + 5 * q[:, 0] + 0.3 * v[:, 0]) / 5).max() < ROUNDING
    assert np.abs(controls[:, 1] - u[:, 1]).max() < ROUNDING
    excess = control_excess(mechanism, q, v, u)
    assert np.abs(excess - (np.abs(controls) - [0.4, 3.0])).max() < ROUNDING
    assert np.any(excess > 0)
    assert np.any(excess < 0)


def test_a_servo_is_named_with_what_its_ctrl_is_for():
    (found,) = audit(bench('<position name="hip" joint="crank" kp="5" ctrlrange="-0.4 0.4" forcerange="-2 2"/>').model)
    assert not found.falsifies
    assert all(word in found.text for word in ("hip", "servo", "effort", "ctrlrange -0.4 to 0.4"))


# What a plan cannot use

UNUSABLE = {
    "filtered servo": ('<position name="x" joint="crank" kp="5" timeconst="0.1"/>', "state", True),
    "filtered motor": ('<general name="x" joint="crank" dyntype="filter" dynprm="0.1"/>', "filter", False),
    "damper": ('<damper name="x" joint="crank" kv="2" ctrlrange="0 1"/>', "vanishes at rest", False),
    "muscle": ('<muscle name="x" tendon="rope" lengthrange="0.1 2"/>', "muscle", True),
    "cylinder": ('<cylinder name="x" joint="cart" timeconst="0.1"/>', "filter", False),
    "adhesion": ('<adhesion name="x" body="rod" ctrlrange="0 1"/>', "transmissions", False),
    "tendon through a geom": ('<motor name="x" tendon="wrapped"/>', "inside", False),
    "servo on a rotation": ('<position name="x" site="end" refsite="ground" gear="0 0 0 0 1 0"/>', "one turn", True),
    "pid": ('<pid name="x" joint="crank" kp="3"/>', "2 controls", True),
    "delayed": ('<motor name="x" joint="crank" delay="0.01" nsample="4"/>', "delayed", False),
    "no gear": ('<motor name="x" joint="crank" gear="0"/>', "gear is zero", False),
    "gear on an axis that a hinge has not": ('<motor name="x" joint="crank" gear="0 1 0 0 0 0"/>', "first number", False),
    "no gain": ('<general name="x" joint="crank" gainprm="0"/>', "vanishes", False),
}


@pytest.mark.slow
@pytest.mark.parametrize(("actuator", "word", "falsifies"), UNUSABLE.values(), ids=UNUSABLE)
def test_an_actuator_that_a_plan_cannot_use_is_named_with_the_reason(actuator, word, falsifies):
    mechanism = bench(actuator)
    assert mechanism.n_u == 0
    (found,) = audit(mechanism.model)
    assert "actuator x" in found.text
    assert word in found.text
    assert len(found.text.splitlines()) == 1
    assert found.falsifies is falsifies


def test_an_actuator_beside_one_of_many_inputs_keeps_its_own_channel():
    mechanism = bench('<pid name="first" joint="rod"/><motor name="second" joint="crank" ctrlrange="-2 3"/>')
    (actuator,) = mechanism.actuators
    assert (actuator.name, actuator.channel, actuator.lower, actuator.upper) == ("second", 2, -2.0, 3.0)
    data = mujoco.MjData(mechanism.model)
    data.ctrl[actuator.channel] = 1.5
    mujoco.mj_forward(mechanism.model, data)
    assert data.actuator_force[actuator.output] == 1.5


@pytest.mark.parametrize(
    ("element", "words"),
    [('stiffness="1" springyield="0.1"', ["springyield", "belt"]), ('armature="0.5"', ["armature", "belt", "branches"])],
)
def test_what_a_tendon_does_beyond_springs_and_dampers_falsifies(element, words):
    (found,) = audit(bench('<motor joint="crank"/>', belt=element).model)
    assert found.falsifies
    assert all(word in found.text for word in words)


def test_a_spring_of_a_tendon_through_a_geom_falsifies():
    text = BENCH % {"crank": "", "rod": "", "belt": "", "actuator": ""}
    text = replaced(
        text, '<spatial name="wrapped">', '<spatial name="wrapped" stiffness="3" damping="1" frictionloss="0.1">'
    )
    found = audit(load_mechanism(text).model)
    assert all(item.falsifies and "inside of a geom" in item.text for item in found)
    assert len(found) == 3
