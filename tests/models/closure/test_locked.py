"""Locked mechanisms: the closures that lock them, by what would move without them."""

import pytest

from linkplan.models.errors import LockedError, UnassembledError
from linkplan.models.mechanism import load_mechanism
from tests.support.mechanisms import TRUSS, replaced
from tests.support.refusals import TWO_BODIES

# A four-bar of pins O, A, C closed at B.
FOUR_BAR = """<mujoco model="bar"><worldbody>
<body name="crank"><joint name="O" axis="0 1 0"/><geom size=".01" pos="0 0 .05"/>
<body name="coupler" pos="0 0 .1"><joint name="A" axis="0 1 0"/><geom size=".01" pos=".15 0 .05"/></body></body>
<body name="rocker" pos=".3 0 0"><joint name="C" axis="0 1 0"/><geom size=".01" pos="0 0 .1"/></body></worldbody>
<equality>%s</equality><actuator><motor joint="O" ctrlrange="-1 1"/></actuator></mujoco>"""
PIN = '<connect name="B" body1="coupler" body2="rocker" anchor=".3 0 .1"/>'


def freed(text: str) -> dict[str, int]:
    with pytest.raises(LockedError) as refused:
        load_mechanism(text)
    for part, more in refused.value.freed.items():
        assert f"{part} ({more}" in str(refused.value)
    return refused.value.freed


def test_every_closure_without_which_it_moves_is_named_with_what_it_gains():
    assert load_mechanism(FOUR_BAR % PIN).dof == 1
    assert freed(FOUR_BAR % (PIN + '<joint name="brake" joint1="O"/>')) == {"B": 2, "brake": 1}


def test_a_weld_where_a_pin_was_meant_is_named_by_its_orientation():
    weld = '<weld name="B" body1="coupler" body2="rocker" anchor=".3 0 .1"/>'
    assert freed(FOUR_BAR % weld) == {"B": 3, "weld B's orientation": 1}


def test_two_brakes_are_named_together_where_none_alone_locks():
    brakes = '<joint name="first" joint1="O"/><joint name="second" joint1="C"/>'
    found = freed(FOUR_BAR % (PIN + brakes))
    assert found["first and second"] == 1
    assert "first" not in found
    assert found["B"] == 1  # without the pin the coupler hangs free


def test_a_truss_in_a_line_is_said_to_be_held_by_its_pin():
    assert list(freed(replaced(TRUSS, "0.1 0 0.1", "0.1 0 0")).values()) == [1]


def test_couplings_that_lock_two_bodies_are_named():
    text = TWO_BODIES % '<equality><joint name="left" joint1="ja"/><joint name="right" joint1="jb"/></equality>'
    assert freed(text) == {"left": 1, "right": 1}


def test_a_loop_that_locks_its_nearest_closed_pose_offers_no_pose():
    shafts = "".join(
        f'<body name="{name}" pos="{place}"><joint name="{name}" axis="0 0 1"/><geom size=".1"/></body>'
        for name, place in (("in", "0 0 0"), ("out", ".5 0 .4"))
    )
    text = f"""<mujoco><worldbody>{shafts}<body name="disc" pos="0 0 .2"><freejoint name="disc"/><geom size=".1"/></body>
    </worldbody><equality><weld body1="in" body2="disc" relpose="0 0 .2 1 0 0 0"/>
    <weld body1="disc" body2="out" relpose="-.5 0 .2 1 0 0 0"/></equality></mujoco>"""
    with pytest.raises(UnassembledError, match="at the nearest closed pose found, the loops lock every joint") as refused:
        load_mechanism(text)
    assert not refused.value.home


# A crank of a centimetre below a rocker of a metre, drawn in the middle of the rocker's swing of 0.01 rad each way.
SMALL_CRANK = """<mujoco><default><geom contype="0" conaffinity="0" size=".01"/><joint axis="0 1 0"/></default><worldbody>
<body pos="0 0 1"><joint name="crank"/><geom/><body pos="0 0 .01"><joint name="pin"/>
<geom type="capsule" fromto="0 0 0 1 0 -.01"/><site name="tip" pos="1 0 -.01"/></body></body>
<body pos="1 0 0"><joint name="rocker"/><geom type="capsule" fromto="0 0 0 0 0 1"/><site name="end" pos="0 0 1"/></body>
</worldbody><equality><connect site1="tip" site2="end"/></equality>
<actuator><motor joint="rocker" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_a_joint_that_turns_by_a_hundredth_of_a_radian_each_way_is_not_locked():
    assert [joint.name for joint in load_mechanism(SMALL_CRANK).independent_joints] == ["rocker"]
