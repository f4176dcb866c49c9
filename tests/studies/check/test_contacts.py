"""Contacts that hold a pose at rest, against closed forms of a block on two edges."""

import numpy as np
import pytest

import linkplan


def block(com_x=0.05, slope_deg=0.0, hill=""):
    g = 9.81 * np.array([np.sin(np.radians(slope_deg)), 0.0, -np.cos(np.radians(slope_deg))])
    return f"""<mujoco model="block"><option gravity="{g[0]} 0 {g[2]}"/><worldbody>{hill}<body name="foot">
    <joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/><joint name="pitch" axis="0 1 0"/>
    <inertial pos="{com_x} 0 0.3" mass="10" diaginertia=".1 .1 .1"/>
    <site name="heel" pos="-0.1 0 0"/><site name="toe" pos="0.1 0 0"/>
    <body name="arm"><joint name="A" axis="0 1 0"/><inertial pos="0 0 0" mass="1e-6" diaginertia="1e-6 1e-6 1e-6"/></body>
    </body></worldbody><actuator><motor joint="A" ctrlrange="-1 1"/></actuator></mujoco>"""


def standing(model, friction, **contact):
    asked = linkplan.Problem.phases(
        model,
        [linkplan.Phase("stand", on=["sole"], goal_deg={"A": 10.0})],
        contacts={"sole": {"site": ["heel", "toe"], **({} if friction is None else {"friction": friction}), **contact}},
    )
    return linkplan.check(asked).contacts_at_rest[0]


def test_a_flat_foot_shares_the_weight_by_the_levers_of_its_edges():
    found = standing(block(), 0.5)
    assert not found.joint
    assert found.force_n["toe"][2] == pytest.approx(98.1 * 0.75, rel=1e-5)
    assert found.force_n["heel"][2] == pytest.approx(98.1 * 0.25, rel=1e-5)


def test_a_centre_of_mass_beyond_the_toe_tips_the_foot_by_its_moment():
    found = standing(block(com_x=0.12), 0.5)
    assert found.joint
    assert found.lacking > 0.5


@pytest.mark.parametrize(("friction", "holds"), [(0.19, True), (0.16, False)])
def test_a_slope_holds_up_to_the_angle_of_friction(friction, holds):
    found = standing(block(com_x=0.0, slope_deg=10.0), friction)  # tan 10 deg = 0.1763
    assert (not found.joint) is holds


@pytest.mark.parametrize(("friction", "holds"), [(0.19, True), (0.16, False), (None, True)])
def test_a_hill_holds_up_to_the_angle_of_friction_about_its_own_normal(friction, holds):
    hill = '<geom name="hill" type="plane" size="1 1 .1" euler="0 10 0" contype="0" conaffinity="0"/>'
    found = standing(block(com_x=0.0, hill=hill), friction, plane="hill")
    assert (not found.joint) is holds
    if holds:
        assert sum(force[2] for force in found.force_n.values()) == pytest.approx(98.1, rel=1e-5)
