"""Switches of a model that change what acts: the dynamics are the simulator's with each of them, or the switch is named."""

import mujoco
import numpy as np
import pytest

from linkplan.models.audit import audit
from linkplan.models.mechanism import load_mechanism
from linkplan.models.selection import Selection
from tests.support.mechanisms import simulated
from tests.support.refusals import assert_names
from tests.support.tolerances import TREE_ACCELERATION, relative_error

Q, V = np.array([0.3, -0.2]), np.array([1.0, 2.0])


def arm(*, option: str = "", upper: str = "", shoulder: str = "", more: str = "", actuator: str = "") -> str:
    """Return two links with attributes of the upper one and of its joint, options, elements, and actuators."""
    return f"""<mujoco model="arm"><compiler angle="radian"/>{option}<worldbody>
  <body name="upper" {upper}><joint name="shoulder" axis="0 1 0" {shoulder}/><geom size="0.05" pos="0.3 0 0"/>
    <body name="lower" pos="0.4 0 0.1"><joint name="elbow" axis="0 1 0"/><geom size="0.04" pos="0.2 0 0.1"/>
      <site name="hand" pos="0.3 0 0"/></body></body></worldbody>
  {more}<actuator>{actuator}</actuator></mujoco>"""


def flag(*switches: str) -> str:
    return f"<option><flag {' '.join(switches)}/></option>"


SPRUNG = 'stiffness="3" damping="0.4" frictionloss="0.5" range="-0.1 0.1"'
MOTOR = '<motor name="m" joint="elbow"/>'
TIED = '<equality><joint name="gears" joint1="shoulder" joint2="elbow"/></equality>'
HONOURED = {
    "springs off": arm(option=flag('spring="disable"', 'constraint="disable"'), shoulder=SPRUNG, actuator=MOTOR),
    "dampers off": arm(option=flag('damper="disable"', 'constraint="disable"'), shoulder=SPRUNG, actuator=MOTOR),
    "springs and dampers off, which takes gravity compensation along": arm(
        option=flag('spring="disable"', 'damper="disable"'), upper='gravcomp="1"', actuator=MOTOR
    ),
    "gravity compensation below zero, which the simulator passes over": arm(upper='gravcomp="-0.5"', actuator=MOTOR),
    "friction off": arm(option=flag('frictionloss="disable"'), shoulder='frictionloss="0.5"', actuator=MOTOR),
    "constraints off": arm(option=flag('constraint="disable"'), shoulder=SPRUNG, actuator=MOTOR),
    "wind in an empty space": arm(option='<option wind="1 0 0"/>', actuator=MOTOR),
    "a servo of a group that is off": arm(
        option='<option actuatorgroupdisable="1"/>', actuator='<position joint="shoulder" group="1" kp="9"/>' + MOTOR
    ),
    "equalities off": arm(option=flag('equality="disable"'), actuator=MOTOR, more=TIED),
    "a sensor that is a plugin": arm(
        option='<extension><plugin plugin="mujoco.sensor.touch_grid"><instance name="skin"><config key="size" value="2 2"/>'
        '<config key="fov" value="9 9"/><config key="gamma" value="0"/><config key="nchannel" value="1"/>'
        "</instance></plugin></extension>",
        more='<sensor><plugin plugin="mujoco.sensor.touch_grid" instance="skin" objtype="site" objname="hand"/></sensor>',
        actuator=MOTOR,
    ),
}


@pytest.mark.parametrize("text", HONOURED.values(), ids=HONOURED)
def test_the_dynamics_are_the_simulators_with_a_switch_and_nothing_is_called_false(text):
    mechanism = load_mechanism(text)
    actual = np.array(mechanism.dynamics.acceleration(Q, V, np.zeros(mechanism.n_u))).ravel()
    assert relative_error(actual, simulated(mechanism.model, Q, V).acceleration) < TREE_ACCELERATION
    assert not [item.text for item in audit(mechanism.model) if item.falsifies]


def test_ranges_are_off_where_all_constraints_are():
    ranged = {"shoulder": 'range="-0.1 0.1"', "actuator": MOTOR}
    assert load_mechanism(arm(**ranged)).joints[0].upper == 0.1
    assert load_mechanism(arm(option=flag('constraint="disable"'), **ranged)).joints[0].upper == np.inf


def test_a_loop_that_a_flag_opens_is_named():
    (found,) = audit(load_mechanism(HONOURED["equalities off"]).model)
    assert_names(found.text, "gears", "switched off")


# name: (model, words); the simulator's acceleration is another with each of them
NAMED = {
    "compensation that no actuator carries": (
        arm(upper='gravcomp="0.7"', shoulder='actuatorgravcomp="true"'),
        ["gravcomp", "shoulder", "no actuator acts"],
    ),
    "compensation by actuators that are off": (
        arm(option=flag('actuation="disable"'), upper='gravcomp="0.7"', shoulder='actuatorgravcomp="true"', actuator=MOTOR),
        ["gravcomp", "shoulder", "no actuator acts"],
    ),
    "an actuator that is a plugin": (
        arm(
            option='<extension><plugin plugin="mujoco.pid"><instance name="gains"><config key="kp" value="20"/></instance>'
            "</plugin></extension>",
            actuator='<plugin name="hold" joint="elbow" plugin="mujoco.pid" instance="gains" actdim="0"/>',
        ),
        ["hold", "plugin", "acts at zero control"],
    ),
}


@pytest.mark.parametrize(("text", "words"), NAMED.values(), ids=NAMED)
def test_what_makes_the_dynamics_others_than_the_simulators_is_named(text, words):
    mechanism = load_mechanism(text)
    actual = np.array(mechanism.dynamics.acceleration(Q, V, np.zeros(mechanism.n_u))).ravel()
    assert relative_error(actual, simulated(mechanism.model, Q, V).acceleration) > 0.01, "the effect is there"
    (found,) = [item for item in audit(mechanism.model) if item.falsifies]
    assert_names(found.text, *words)


def test_a_body_that_the_simulator_leaves_asleep_is_named():
    text = arm(option=flag('sleep="enable"', 'gravity="disable"'), upper='sleep="init"', actuator=MOTOR)
    mechanism = load_mechanism(text)
    assert not np.any(stepped(mechanism.model)), "no effort moves it"
    (found,) = [item for item in audit(mechanism.model) if item.falsifies]
    assert_names(found.text, "sleep", "upper")
    assert np.all(stepped(load_mechanism(text.replace('sleep="init"', "")).model))


def stepped(model) -> np.ndarray:
    """Return the speeds (nv,) after a few steps from rest with every control at one."""
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    for _ in range(5):
        mujoco.mj_step(model, data)
    return data.qvel.copy()


def test_a_motor_asked_for_replaces_a_plugin_and_its_sensor():
    text, _ = NAMED["an actuator that is a plugin"]
    text = text.replace("</mujoco>", '<sensor><actuatorfrc actuator="hold"/></sensor></mujoco>')
    mechanism = load_mechanism(text, selection=Selection(drive=["elbow"]))
    assert [actuator.name for actuator in mechanism.actuators] == ["elbow"]
    assert "actuators replaced by motors, with their sensors: hold on elbow" in mechanism.notes
    assert not [item for item in audit(mechanism.model) if item.falsifies]


def test_an_actuator_with_a_filter_acts_without_it_where_a_motor_is_asked_for():
    text = arm(actuator='<cylinder name="ram" joint="elbow" timeconst="0.1" area="0.5" ctrlrange="-8 8"/>')
    (left_out,) = [item.text for item in audit(load_mechanism(text).model)]
    assert "filter dynamics, which mechanism.drive with its joint omits" in left_out
    mechanism = load_mechanism(text, selection=Selection(drive=["elbow"]))
    assert [(a.name, a.lower, a.upper) for a in mechanism.actuators] == [("ram", -4.0, 4.0)]
    assert "actuators without their filters, in simulation too (mechanism.drive): ram on elbow" in mechanism.notes
    assert mechanism.model.na == 0
