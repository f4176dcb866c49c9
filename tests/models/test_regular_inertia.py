"""Motions that move no mass are refused, and named, where a mechanism is loaded."""

import numpy as np
import pytest

from linkplan.models.coordinate_choice import is_regular, without_inertia
from linkplan.models.errors import InertiaError
from linkplan.models.mechanism import load_mechanism

BOX = '<geom type="box" size="0.1 0.2 0.3" contype="0" conaffinity="0"/>'


def with_joints(*joints: str) -> str:
    """Return a model of one body on joints."""
    return f"<mujoco><worldbody><body>{''.join(f'<joint {joint}/>' for joint in joints)}{BOX}</body></worldbody></mujoco>"


SINGULAR = {
    "two hinges on one axis": (['name="a" axis="0 1 0"', 'name="b" axis="0 1 0"'], "joints a and b move together"),
    "parallel slides": (['name="a" type="slide" axis="1 0 0"', 'name="b" type="slide" axis="1 0 0"'], "joints a and b move"),
    "three slides in a plane": (
        ['name="a" type="slide" axis="1 0 0"', 'name="b" type="slide" axis="0 1 0"', 'name="c" type="slide" axis="1 1 0"'],
        "joints a, b and c move together",
    ),
    "gimbal lock": (
        ['name="a" axis="0 0 1"', 'name="b" axis="0 1 0"', 'name="c" axis="0 0 1"'],
        "joints a and c move together",
    ),
    "four hinges on a body": (
        ['name="a" axis="1 0 0"', 'name="b" axis="0 1 0"', 'name="c" axis="0 0 1"', 'name="d" axis="1 1 1"'],
        "joints a, b, c and d move together",
    ),
}


@pytest.mark.filterwarnings("ignore:.*too close to singular")
@pytest.mark.parametrize(("joints", "said"), SINGULAR.values(), ids=SINGULAR)
def test_joints_that_move_no_mass_together_are_refused_by_name_and_pose(joints, said):
    with pytest.raises(InertiaError, match=said) as refused:
        load_mechanism(with_joints(*joints))
    assert "singular inertia at home (a = 0 " in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_armature_makes_two_hinges_on_one_axis_a_mechanism():
    found = load_mechanism(with_joints('name="a" axis="0 1 0"', 'name="b" axis="0 1 0" armature="0.01"'))
    assert is_regular(np.array(found.dynamics.reduced_inertia(found.home)))


def test_small_inertias_are_regular_and_cancelling_ones_are_not():
    assert is_regular(np.diag([1e-12, 1.0, 1e6]))
    assert not is_regular(np.array([[1.0, 1e-6], [1e-6, 1e-12]]))
    assert is_regular(np.array([np.eye(2), np.ones((2, 2)), np.full((2, 2), np.nan)])).tolist() == [True, False, False]
    assert without_inertia(np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 1.0]])) == [0, 2]
    assert without_inertia(np.diag([1.0, 0.0, 1.0])) == [1]
