"""Legs of least effort over the way: against closed forms, and past a dead centre where programs over time are false."""

import numpy as np
import pytest

from linkplan.planner.phase_plane.cheapest_legs import cheapest_legs
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_problem

# The legs' cost against a closed form: cells, and a reserve of a hundredth of the limits.
CELLS = 1e-3
# A leg with a wheel that a gear beside it folds away: it flies past a dead centre.
OVER_CENTRE = """
<mujoco><option timestep="2e-4"/>
  <default><joint axis="0 -1 0" damping="2"/><geom type="capsule" size="0.02" contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="leg"><joint name="leg" range="-100 100"/><geom fromto="0 0 0 0 0 -0.9" mass="12"/>
      <geom type="cylinder" pos="0 0 -0.95" size="0.18 0.06" euler="90 0 0" mass="15"/></body>
    <body name="upper" pos="0.55 0 0.05"><joint name="upper"/>
      <geom fromto="0 0 0 -0.276988483312 0 -0.288578204500" mass="2"/>
      <body name="lower" pos="-0.276988483312 0 -0.288578204500"><joint name="elbow"/>
        <geom fromto="0 0 0 -0.273011516688 0 -0.211421795500" mass="2"/></body></body></worldbody>
  <equality><connect name="brace" body1="lower" body2="leg" anchor="-0.273011516688 0 -0.211421795500"/></equality>
  <actuator><motor name="act" joint="upper" ctrlrange="-900 900"/></actuator></mujoco>
"""


def test_legs_of_an_inertia_alone_cost_what_the_cubic_does():
    """The least integral of u^2 from rest to rest is 12 (I turn)^2 / T^3."""
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 1.5\n")
    legs = next(cheapest_legs(problem, problem.start_pose(), None))
    assert legs.time[-1] == pytest.approx(1.5, rel=CELLS)
    assert legs.cost == pytest.approx(12 * (HINGE_INERTIA * TURN) ** 2 / 1.5**3, rel=CELLS)


def test_a_rest_takes_what_is_left_of_the_time_where_it_costs_less_than_moving():
    """A rest that pays for itself, 1 N2 m2 less than nothing, is as long as the efforts' limits leave it."""
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 3.0\n")
    slow = next(cheapest_legs(problem, problem.start_pose(), 0.0))
    assert slow.time[-1] == pytest.approx(3.0, rel=1e-2)
    dear = next(cheapest_legs(problem, problem.start_pose(), -1.0))
    # d/dT of 12 (I turn)^2 / T^3 is -1 there.
    assert dear.time[-1] == pytest.approx((36 * (HINGE_INERTIA * TURN) ** 2) ** 0.25, rel=1e-2)


@pytest.mark.long
def test_a_leg_that_flies_past_a_dead_centre_is_folded_in_three_seconds():
    """The least effort of one second, 15,478, and two seconds of rest at 5.4345 N.m cost 15,537; a swing costs less."""
    problem = Problem.reach(OVER_CENTRE, start_deg={"upper": 0.0}, goal_deg={"upper": -85.0}, duration_s=3.0)
    plan = plan_motion(problem)
    assert plan.passed, plan.message
    assert plan.trajectory.duration_s == pytest.approx(3.0, rel=1e-9)
    assert plan.objective < 15537
    assert np.abs(plan.trajectory.effort).max() <= 900
