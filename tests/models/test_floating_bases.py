"""Bodies that float: what falls along a rail, what loops tie together, and what holds them."""

import mujoco
import pytest

from linkplan.models.errors import LinkplanError, ModelError
from linkplan.models.foreign.floating import MAX_LOOSE_BODIES, floating_joints, floating_sentence
from linkplan.models.mechanism import load_mechanism
from linkplan.models.selection import Selection
from tests.support.mechanisms import replaced

# A leg on a vertical rail, which stands by contact alone.
ON_A_RAIL = """<mujoco><compiler autolimits="true"/><option/><worldbody><site name="roof" pos="0 0 2"/>
<body name="trunk"><joint name="rail" type="slide" axis="0 0 1"/><geom size=".1" mass="2"/><site name="hook"/>
<body name="thigh"><joint name="hip" axis="0 1 0"/><geom size=".05" pos="0 0 -.2" mass="1"/></body></body></worldbody>
<actuator><motor joint="hip" ctrlrange="-9 9"/></actuator></mujoco>"""


def test_a_base_that_falls_along_a_rail_floats_and_is_fixed():
    mechanism = load_mechanism(ON_A_RAIL)
    assert floating_joints(mechanism.model) == {0}
    assert "nothing drives its 1 degree of freedom" in str(floating_sentence(mechanism.model))
    fixed = load_mechanism(ON_A_RAIL, selection=Selection(fix_base=True))
    assert [joint.name for joint in fixed.joints] == ["hip"]


def test_a_base_between_the_stops_of_a_rail_on_a_frame_that_stands_still_floats():
    framed = replaced(ON_A_RAIL, '<body name="trunk">', '<body euler="0 90 0"><geom size=".1"/><body name="trunk">')
    upright = replaced(replaced(framed, 'axis="0 0 1"', 'axis="1 0 0" range="-1 1"'), "</worldbody>", "</body></worldbody>")
    assert floating_joints(mujoco.MjModel.from_xml_string(upright)) == {0}
    level = replaced(upright, 'axis="1 0 0" range', 'axis="0 0 1" range')
    assert floating_joints(mujoco.MjModel.from_xml_string(level)) == set()
    assert [joint.name for joint in load_mechanism(upright, selection=Selection(fix_base=True)).joints] == ["hip"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('axis="0 0 1"', 'axis="1 0 0"'),
        ('axis="0 0 1"', 'axis="0 0 1" stiffness="50"'),
        ('axis="0 0 1"', 'axis="0 0 1" frictionloss="40"'),
        ('<body name="trunk">', '<body name="trunk" gravcomp="1">'),
        ("<option/>", '<option gravity="0 0 0"/>'),
        ("<actuator>", '<equality><joint joint1="rail"/></equality><actuator>'),
        ("<actuator>", '<actuator><motor joint="rail"/>'),
        ("<actuator>", '<actuator><motor site="hook" gear="0 0 1 0 0 0"/>'),
        (
            "<actuator>",
            '<tendon><spatial name="rope"><site site="roof"/><site site="hook"/></spatial></tendon>'
            '<actuator><motor tendon="rope"/>',
        ),
    ],
)
def test_a_base_that_something_holds_on_its_rail_does_not_float(old, new):
    assert floating_joints(mujoco.MjModel.from_xml_string(replaced(ON_A_RAIL, old, new))) == set()


def test_a_scene_with_too_many_loose_bodies_is_refused():
    loose = "".join(f'<body name="b{k}"><freejoint/><geom size=".1"/></body>' for k in range(MAX_LOOSE_BODIES + 1))
    with pytest.raises(ModelError, match="nothing drives these 21 bodies, and a mechanism has at most 20 of them"):
        load_mechanism(replaced(ON_A_RAIL, "<worldbody>", f"<worldbody>{loose}"))


# A free body that hangs on a cable.
HUNG = """<mujoco><worldbody><site name="roof" pos="0 0 1"/>
<body name="platform"><freejoint/><geom type="box" size=".1 .1 .01" mass="1"/><site name="hook"/></body></worldbody>
<tendon><spatial name="A"><site site="roof"/><site site="hook"/></spatial></tendon><actuator>{}</actuator></mujoco>"""


@pytest.mark.parametrize(
    ("motors", "floats"),
    [('<motor tendon="A"/>', set()), ('<motor site="hook" gear="0 0 1 0 0 0"/>', set()), ("", {0})],
    ids=["cable", "rotor", "nothing"],
)
def test_a_free_body_that_cables_or_rotors_move_does_not_float(motors, floats):
    assert floating_joints(mujoco.MjModel.from_xml_string(HUNG.format(motors))) == floats


# A chassis of two plates, both free in the file, with a leg on the upper one.
PLATES = """<mujoco><worldbody>
<body name="lower"><freejoint name="low"/><geom size=".1" mass="1"/></body>
<body name="upper" pos="0 0 .1"><freejoint name="high"/><geom size=".1" mass="2"/>
<body name="leg"><joint name="hip" axis="0 1 0"/><geom size=".05" pos="0 0 -.2" mass="1"/></body></body></worldbody>
<equality><weld body1="lower" body2="upper"/></equality>
<actuator><motor joint="hip" ctrlrange="-9 9"/></actuator></mujoco>"""


def test_of_bases_that_float_tied_to_one_another_the_heaviest_is_fixed_and_holds_the_others():
    fixed = load_mechanism(PLATES, selection=Selection(fix_base=True))
    assert floating_joints(load_mechanism(PLATES).model) == {1}
    assert fixed.notes[0] == "locked: high at home"
    assert [joint.name for joint in fixed.independent_joints] == ["hip"]


def test_of_rods_that_actuated_cables_tie_together_the_heaviest_floats():
    rods = replaced(PLATES, '<geom size=".1" mass="1"/>', '<geom size=".1" mass="1"/><site name="low"/>')
    rods = replaced(rods, '<geom size=".1" mass="2"/>', '<geom size=".1" mass="2"/><site name="high"/>')
    loose = replaced(rods, '<equality><weld body1="lower" body2="upper"/></equality>', "")
    assert floating_joints(mujoco.MjModel.from_xml_string(loose)) == {0, 1}
    cable = '<tendon><spatial name="cable"><site site="low"/><site site="high"/></spatial></tendon><actuator>'
    tied = replaced(loose, "<actuator>", cable + '<motor tendon="cable"/>')
    assert floating_joints(mujoco.MjModel.from_xml_string(tied)) == {1}


def test_bases_that_float_tied_to_what_stands_on_the_world_do_not_float():
    tied = replaced(PLATES, "<equality>", '<equality><connect body1="lower" anchor="0 0 0"/>')
    assert floating_joints(mujoco.MjModel.from_xml_string(tied)) == set()


def test_a_joint_that_is_driven_and_locked_gets_no_motor():
    undriven = ON_A_RAIL[: ON_A_RAIL.index("<actuator>")] + "</mujoco>"
    leg = load_mechanism(undriven, selection=Selection(drive=["rail", "hip"], lock={"rail": 0.1}))
    assert [actuator.name for actuator in leg.actuators] == ["hip"]
    with pytest.raises(LinkplanError, match=r"unknown joint 'rails' \(did you mean 'rail'\?\)"):
        load_mechanism(undriven, selection=Selection(drive=["rails"]))
