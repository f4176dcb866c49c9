"""Whole turns whose first solves fail: the cheapest legs of the phase plane, and the smooth path itself."""

import numpy as np
import pytest

from linkplan.planner.phase_plane.cheapest_legs import cheapest_legs
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import failed
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.methods import SHORT_BUDGET
from linkplan.planner.search.planning import SEARCH_METHODS, plan_motion, search_for
from linkplan.planner.search.starts import from_the_phase_plane

# A rotor of 0.25 kg m2, whose weight has a lever of 0.5 m.
ROTOR = """<mujoco><option gravity="0 0 {gravity}"/><worldbody><body name="rod">
<joint name="J" axis="0 1 0" damping="{damping}"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-20 20"/></actuator></mujoco>"""


# A crank that bends a toggle twice per turn: its inertia varies by thirty, and even meshes step over the fast parts.
PRESS = """<mujoco><default><joint axis="0 -1 0" damping="0.05"/><geom type="capsule" size="0.012" density="7800" contype="0"
 conaffinity="0"/></default><worldbody><body pos="-0.255 0 0.62"><joint name="crank"/><geom fromto="0 0 0 0.05 0 0"/>
<body pos="0.05 0 0"><joint/><geom fromto="0 0 0 0.2 0 -0.04"/><site name="rod" pos="0.2 0 -0.04"/></body></body>
<body pos="0 0 0.8"><joint/><geom fromto="0 0 0 -0.05 0 -0.22"/><site name="knee" pos="-0.05 0 -0.22"/>
<body name="lower" pos="-0.05 0 -0.22"><joint/><geom fromto="0 0 0 0.05 0 -0.22"/></body></body>
<body name="ram" pos="0 0 0.36"><joint type="slide" axis="0 0 1" damping="20"/>
<geom type="sphere" size="0.1" mass="28"/></body></worldbody><equality><connect site1="rod" site2="knee"/>
<connect body1="lower" body2="ram" anchor="0.05 0 -0.22"/></equality>
<actuator><motor joint="crank" ctrlrange="-60 60"/></actuator><keyframe>
<key name="home" qpos="0.003908191541 -0.03259270887 0.1958596344 -0.3917192687 -0.01104850559"/></keyframe></mujoco>"""


def turning(turns: int, *, gravity: float = -9.81, damping: float = 0.3, minimize: str = "effort") -> Problem:
    rotor = ROTOR.format(gravity=gravity, damping=damping)
    return Problem.periodic(rotor, turns={"J": turns}, duration_s=0.8, minimize=minimize)


@pytest.mark.parametrize("turns", [1, -2])
def test_the_cheapest_legs_of_damped_turns_have_constant_speed(turns):
    problem = turning(turns, gravity=0.0)
    legs = next(cheapest_legs(problem, problem.start_pose(), None))
    speed = 2 * np.pi * turns / 0.8
    assert legs.cost == pytest.approx((0.3 * speed) ** 2 * 0.8, rel=1e-4)
    np.testing.assert_allclose(legs.v, speed, rtol=1e-3)


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_legs_of_a_turn_with_weight_cost_as_much_as_the_solver_finds(damping):
    problem = turning(1, damping=damping)
    plan = plan_motion(problem)
    legs = next(cheapest_legs(problem, problem.start_pose(), None))
    assert plan.status == "optimal"
    assert legs.cost == pytest.approx(plan.objective, rel=2e-3, abs=1e-4)


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_a_turn_whose_first_solves_fail_is_found(damping):
    later = [method for method in SEARCH_METHODS if "smooth path" not in method.name]
    assert plan_motion(turning(1, damping=damping), methods=later).passed


@pytest.mark.slow
def test_the_cheapest_legs_lead_to_the_optimum_where_even_meshes_have_false_motions():
    problem = Problem.periodic(PRESS, turns={"crank": 1}, duration_s=0.6, minimize="effort")
    search = search_for(problem.varied(solver=problem.solver.begun()))
    search.plans.append(Plan(problem=problem, verdict=failed("a false motion")))
    plan = from_the_phase_plane(search, SHORT_BUDGET)
    assert plan is not None
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(4.81747, rel=1e-5)  # that of 300 even intervals


def test_a_turn_with_any_objective_may_follow_the_smooth_path():
    plan = plan_motion(turning(1, minimize="work"), methods=())
    assert plan.status == "feasible"
    assert plan.trajectory is not None
    assert plan.trajectory.periodic
    assert plan.trajectory.velocity_at(np.array([0.3]))[0, 0] == pytest.approx(2 * np.pi / 0.8)
