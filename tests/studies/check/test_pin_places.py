"""Pins given by an anchor, which closes its loop wherever it is."""

import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.studies.check.inspection import inspect

# Hoeken's linkage: the coupler and the rocker meet at (-0.075, 0, -0.1) from the rocker's hinge.
HOEKEN = """<mujoco model="hoeken"><default><joint axis="0 -1 0"/><geom type="capsule" size=".006" contype="0"
conaffinity="0"/></default><worldbody><body name="crank"><joint name="O"/><geom fromto="0 0 0 -.05 0 0"/>
<body name="coupler" pos="-.05 0 0"><joint name="A"/><geom fromto="0 0 0 .15 0 -.2"/><site name="c" pos=".075 0 -.1"/>
</body></body>
<body name="rocker" pos=".1 0 0"><joint name="C"/><geom fromto="0 0 0 -.075 0 -.1"/><site name="r" pos="-.075 0 -.1"/></body>
</worldbody><equality><connect name="B" {pin}/></equality>
<actuator><motor name="m" joint="O" ctrlrange="-1 1"/></actuator></mujoco>"""
ANCHOR = 'body1="coupler" body2="rocker" anchor="{}"'


@pytest.mark.parametrize(
    ("pin", "is_noted"),
    [
        (ANCHOR.format(".075 0 -.1"), False),
        (ANCHOR.format(".075 0 -.107"), False),  # within a capsule's radius
        (ANCHOR.format(".075 0 -.16"), True),
        (ANCHOR.format(".095 0 -.26"), True),
        (ANCHOR.format(".075 .05 -.1"), True),
        ('site1="c" site2="r"', False),
    ],
)
def test_a_pin_off_both_its_bodies_is_noted(pin, is_noted):
    notes = [note for note in inspect(load_mechanism(HOEKEN.format(pin=pin)), []).notes if note.startswith("pin B lies")]
    assert len(notes) == is_noted
    assert all("off the shapes of both its bodies, coupler and rocker" in note for note in notes)
