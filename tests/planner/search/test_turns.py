"""Whole turns whose first solves fail: the cheapest legs of the phase plane, and the smooth path itself."""

import numpy as np
import pytest

from linkplan.planner.phase_plane.cheapest_legs import cheapest_legs
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import SEARCH_METHODS, plan_motion

# A rotor of 0.25 kg m2, whose weight has a lever of 0.5 m.
ROTOR = """<mujoco><option gravity="0 0 {gravity}"/><worldbody><body name="rod">
<joint name="J" axis="0 1 0" damping="{damping}"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-20 20"/></actuator></mujoco>"""


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


def test_a_turn_with_any_objective_may_follow_the_smooth_path():
    plan = plan_motion(turning(1, minimize="work"), methods=())
    assert plan.status == "feasible"
    assert plan.trajectory is not None
    assert plan.trajectory.periodic
    assert plan.trajectory.velocity_at(np.array([0.3]))[0, 0] == pytest.approx(2 * np.pi / 0.8)
