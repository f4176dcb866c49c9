"""The ground pushes, within the friction cone: rows, margins, proofs and refusals."""

import numpy as np
import pytest

from linkplan.models.errors import LinkplanError
from linkplan.models.poses.joint_forces import closure_rows_along
from linkplan.planner.limits.ground import GroundForceLimit
from linkplan.planner.limits.kinds import margins_along
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion

# A body of 2 kg on a leg of 1 kg that turns about its foot; the foot stands on the ground.
LEG = """<mujoco model="leg"><option gravity="0 0 -9.81"/><worldbody><site name="spot"/>
<body name="shin" pos="0 0 0.5"><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<joint name="pitch" axis="0 1 0"/><inertial pos="0 0 -.25" mass="1" diaginertia=".02 .02 .002"/>
<site name="foot" pos="0 0 -.5"/>
<body name="body"><joint name="hip" axis="0 1 0"/><inertial pos="0 0 .1" mass="2" diaginertia=".05 .05 .05"/></body></body>
</worldbody><actuator><motor name="hip" joint="hip" ctrlrange="-20 20" ctrllimited="true"/></actuator></mujoco>"""
# A cart of 2 kg that two motors push along a base of 1 kg, which stands on a foot and would slip in any direction.
CART = """<mujoco model="cart on a foot"><option gravity="0 0 -9.81"/><worldbody><body name="base">
<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
<joint name="z" type="slide" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/><site name="foot"/>
<body name="cart">
<joint name="u" type="slide" axis="1 0 0"/><joint name="w" type="slide" axis="0 1 0"/>
<inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/></body></body></worldbody>
<actuator><motor name="u" joint="u" ctrlrange="-100 100"/>
<motor name="w" joint="w" ctrlrange="-100 100"/></actuator></mujoco>"""
ARGUMENTS = {
    "start_deg": {"pitch": 0.0, "hip": 0.0},
    "goal_deg": {"pitch": 4.0, "hip": 20.0},
    "goal_speed_deg_s": {"pitch": 30.0, "hip": 0.0},
    "duration_s": 0.6,
}


def on_the_ground(friction=None, **more):
    mechanism = {"model": LEG, "stand": {"foot": [0.0, 0.0, 0.0]}, "independent": ["pitch", "hip"], **more}
    limits = {} if friction is None else {"friction": {"foot": friction}}
    return Problem.from_tables("leg", {"mechanism": mechanism, "motion": {"kind": "reach", **ARGUMENTS}, "limits": limits})


def forces(plan):
    at = samples_of(plan.problem, plan.trajectory)
    return closure_rows_along(plan.problem.mechanism, at.q, at.v, at.a, at.u)


def test_a_site_that_stands_is_one_more_closure():
    mechanism = on_the_ground().mechanism
    assert (mechanism.dof, mechanism.closure_names) == (2, ("foot",))


def test_the_ground_carries_the_weight_at_rest_and_its_force_is_mass_times_acceleration():
    plan = plan_motion(on_the_ground())
    force = forces(plan)
    assert np.all(np.abs(force[:, 1]) < 1e-9)
    assert np.mean(force[:, 2]) == pytest.approx(3 * 9.81, rel=0.2)


def test_a_planar_contact_has_two_sides_of_its_cone_and_one_without_friction_none():
    assert len(GroundForceLimit.of(on_the_ground(0.5))) == 3
    assert len(GroundForceLimit.of(on_the_ground(np.inf))) == 1
    assert not GroundForceLimit.of(on_the_ground())


def test_a_motion_keeps_the_friction_cone_that_it_left_without_the_limit():
    free = forces(plan_motion(on_the_ground()))
    needed = float(np.max(np.abs(free[:, 0]) / free[:, 2]))
    plan = plan_motion(on_the_ground(0.8 * needed))
    assert plan.passed
    force = forces(plan)
    assert np.max(np.abs(force[:, 0]) - 0.8 * needed * force[:, 2]) < 1e-6
    assert plan.with_proof().proof.passed
    tight = [margin for margin in margins_along(samples_of(plan.problem, plan.trajectory)) if margin.what == "friction"]
    assert min(margin.left for margin in tight) == pytest.approx(0.0, abs=1e-4)


def test_in_space_the_cone_is_round_and_a_least_time_along_it_is_the_closed_form():
    tables = {
        "mechanism": {"model": CART, "stand": {"foot": [0.0, 0.0, 0.0]}, "independent": ["u", "w"]},
        "motion": {"kind": "reach", "start_m": {"u": 0.0, "w": 0.0}, "goal_m": {"u": 0.3, "w": 0.4}},
        "objective": {"minimize": "time"},
        "limits": {"friction": {"foot": 0.5}},
    }
    problem = Problem.from_tables("cart", tables)
    assert [row.conic for row in GroundForceLimit.of(problem)] == [False, True]
    plan = plan_motion(problem)
    assert plan.status == "optimal"
    most = 0.5 * 3.0 * 9.81 / 2.0  # the acceleration of the cart at which the foot slips
    assert plan.duration_s == pytest.approx(2.0 * np.sqrt(0.5 / most), rel=1e-6)
    force = forces(plan)
    assert np.max(np.hypot(force[:, 0], force[:, 1]) - 0.5 * force[:, 2]) < 1e-6
    assert plan.with_proof().proof.passed


def test_on_a_slope_the_normal_is_that_of_the_ground():
    tilted = on_the_ground(0.5, stand={"foot": [0.0, 0.0, 0.0, 0.1, 0.0, 1.0]})
    push, *sides = GroundForceLimit.of(tilted)
    normal = np.array([0.1, 0.0, 1.0]) / np.linalg.norm([0.1, 0.0, 1.0])
    assert push.normal == pytest.approx(tuple(normal), abs=1e-12)
    assert all(abs(np.dot(side.tangent, normal)) < 1e-9 for side in sides)


@pytest.mark.parametrize(
    ("more", "friction", "says"),
    [
        ({"stand": {"heel": [0, 0, 0]}}, None, "unknown site in mechanism.stand"),
        ({"stand": {"spot": [0, 0, 0]}}, None, "belongs to the world"),
        ({"open": ["lock"]}, None, "closure in mechanism.open"),
        ({"stand": {}}, 0.5, "limits.friction.foot"),
        ({}, -0.5, "limits.friction.foot"),
    ],
)
def test_what_cannot_stand_is_refused_in_one_line(more, friction, says):
    with pytest.raises(LinkplanError, match=says) as refused:
        on_the_ground(friction, **more)
    assert "\n" not in str(refused.value)
