"""Effort short of gravity's: a motion that gathers way first is found, and is not called impossible."""

import numpy as np
import pytest

from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import PENDULUM
from tests.support.tolerances_planner import BOUNDARY_DEG

PROBLEM = """[mechanism]
model = "pendulum.xml"
[motion]
kind = "reach"
start_deg = {{ J = 0.0 }}
goal_deg = {{ J = {goal} }}
duration_s = "free"
[objective]
minimize = "time"
"""
WEIGHT = 0.5 * 9.81  # [N.m] of the rod held level


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0.7 * WEIGHT, 0.6 * WEIGHT])
def test_a_pendulum_too_heavy_for_its_motor_swings_back_first(tmp_path, limit):
    (tmp_path / "pendulum.xml").write_text(PENDULUM.format(limit=limit))
    (tmp_path / "problem.toml").write_text(PROBLEM.format(goal=120.0))
    plan = plan_motion(load_problem(tmp_path / "problem.toml"))
    turn = np.radians(120.0)
    assert limit * turn < WEIGHT * (1 - np.cos(turn)), "straight there, the motor's work falls short of the weight's"
    assert plan.status == "optimal", plan.message
    assert plan.certificate.passed
    angles = np.degrees(plan.trajectory.position_at(plan.trajectory.dense_times(20))[:, 0])
    assert angles[0] == pytest.approx(0.0, abs=BOUNDARY_DEG)
    assert angles[-1] == pytest.approx(120.0, abs=BOUNDARY_DEG)
    assert angles.min() < -5.0, "it swings back before it goes up"
