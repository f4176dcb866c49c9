"""The periodic step of a five-link walker with heel strike, against an independent collocation (parameters of RABBIT)."""

import functools

import numpy as np
import pytest

from linkplan.models.poses.joint_forces import closure_rows_along
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.search.phases import plan_phases

_SHIN = '<inertial pos="0 0 -.128" mass="3.2" diaginertia=".93 .93 .93"/>'
_THIGH = '<inertial pos="0 0 -.163" mass="6.8" diaginertia="1.08 1.08 1.08"/>'


def _leg(side):
    return (
        f'<body name="{side}_femur"><joint name="{side}_hip" axis="0 -1 0"/>{_THIGH}'
        f'<body name="{side}_tibia" pos="0 0 -.4"><joint name="{side}_knee" axis="0 -1 0"/>{_SHIN}'
        f'<site name="{side}_foot" pos="0 0 -.4"/></body></body>'
    )


def _motor(joint):
    return f'<motor name="{joint}" joint="{joint}" ctrlrange="-100 100" ctrllimited="true"/>'


WALKER = f"""<mujoco model="rabbit"><compiler balanceinertia="false" boundmass="0"/><option gravity="0 0 -9.81"/><worldbody>
<body name="torso"><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<joint name="pitch" axis="0 -1 0"/><inertial pos="0 0 .2" mass="20" diaginertia="2.22 2.22 2.22"/>{_leg("st")}{_leg("sw")}
</body></worldbody><actuator>{"".join(map(_motor, ("st_knee", "st_hip", "sw_hip", "sw_knee")))}</actuator><keyframe>
<key name="home" qpos="-.22 .75 -.23 .73 -.43 -.123 -.011"/></keyframe></mujoco>"""
MIRROR = {"st_hip": "sw_hip", "st_knee": "sw_knee"}


# A point of 1 kg on two legs of 1 m with next to nothing at their feet, on a slope of 0.009 rad.
SLOPE = f"{9.81 * np.sin(0.009):.12f} 0 {-9.81 * np.cos(0.009):.12f}"
_FEET = "".join(
    f'<body name="{leg}"><joint name="{leg}" axis="0 1 0"/><inertial pos="0 0 -1" mass="1e-5" diaginertia="1e-9 1e-9 1e-9"/>'
    f'<site name="{leg}_foot" pos="0 0 -1"/></body>'
    for leg in ("st", "sw")
)
SIMPLEST = f"""<mujoco model="simplest walker"><option gravity="{SLOPE}"/><worldbody><body name="hip" pos="0 0 1">
<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="1e-7 1e-7 1e-7"/>{_FEET}</body></worldbody>
<actuator><motor name="hip" joint="sw" ctrlrange="-1 1" ctrllimited="true"/></actuator>
<keyframe><key name="home" qpos="-0.2 -0.02 -0.2 0.2"/></keyframe></mujoco>"""


@functools.cache
def step(friction, **motion):
    tables = {
        "contacts": {"foot": {"site": "st_foot", "friction": friction}},
        "motion": {"repeat": True, "mirror": MIRROR, "duration_s": 0.7, **motion},
    }
    return plan_phases(PhasedProblem.of(WALKER, [{"name": "step", "on": ["foot"]}], tables))


def needed_friction(plan):
    one = plan.plans[0]
    at, mechanism = samples_of(one.problem, one.trajectory), one.problem.mechanism
    force = closure_rows_along(mechanism, at.q, at.v, at.a, at.u)[:, mechanism.closure_slice(0)]
    return float(np.max(np.abs(force[:, 0]) / force[:, 2]))


def test_a_step_costs_what_an_independent_collocation_says():
    plan = step(0.8, distance_m=0.5)
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(390.7905381708, rel=1e-9)
    assert plan.junctions[0].energy_lost_j == pytest.approx(25.7956, abs=1e-4)
    assert needed_friction(plan) == pytest.approx(0.366, abs=5e-4)
    assert plan.body.distance_m == pytest.approx(0.5, abs=1e-9)


def test_a_given_speed_of_travel_gives_the_same_step():
    assert step(0.8, speed_m_s=0.5 / 0.7).objective == pytest.approx(390.7905381708, rel=1e-8)


def test_on_slippery_ground_a_step_changes_and_stays_in_the_friction_cone():
    plan = step(0.3, distance_m=0.5)
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(392.53798, rel=1e-6)
    assert needed_friction(plan) == pytest.approx(0.3, abs=1e-6)
    assert "slips" in plan.verdict.sentence  # of the heel strike, whose impulse needs more


def test_the_simplest_walker_walks_down_its_slope_without_effort_as_printed():
    # Garcia, Chatterjee, Ruina & Coleman, J. Biomech. Eng. 120 (1998).
    angle, rate = 0.200310900544287, 0.199832473004977 * np.sqrt(9.81)
    tables = {
        "contacts": {"foot": {"site": "st_foot", "friction": 2.0}},
        "motion": {"repeat": True, "mirror": {"st": "sw"}, "distance_m": 2.0 * np.sin(angle)},
    }
    tables["mechanism"] = {"model": SIMPLEST, "independent": ["st", "sw"]}
    plan = plan_phases(PhasedProblem.from_tables("simplest", tables | {"phases": [{"name": "step", "on": ["foot"]}]}))
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(0.0, abs=1e-12)
    first = plan.plans[0].trajectory
    assert abs(first.velocity_at(np.zeros(1))[0, 0]) == pytest.approx(rate, rel=1e-4)  # for feet without any mass
