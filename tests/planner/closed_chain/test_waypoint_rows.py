"""Rows of the program on sites' coordinates that waypoints prescribe: each at the instant of its own waypoint."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.formulate import formulate
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.transcribe import choose_scales
from tests.support.arms import LOWER, UPPER, foot_of
from tests.support.sites import ABOVE, BELOW, arm_of, site_problem


def test_a_coordinate_is_prescribed_at_the_phase_boundary_of_its_waypoint():
    waypoints = [{"at": {"foot": {"x": 0.4}}, "time_s": 0.2}, {"at": {"foot": {"z": -0.1}}, "time_s": 0.5}]
    motion = {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}, "waypoints": waypoints, "duration_s": 0.6}
    problem = site_problem(arm_of(UPPER, LOWER), motion)
    scales = choose_scales(problem, first_guess(problem, problem.start_pose()))
    formulation = formulate(problem, scales)
    at_home = foot_of(problem.mechanism.home)[0]
    times = [float(formulation.boundaries[boundary].time[0]) * scales.time_s for boundary, _, _ in formulation.passed]
    moves = [value * problem.mechanism.extent_m for _, _, value in formulation.passed]
    assert times == pytest.approx([0.2, 0.5], rel=1e-12)
    assert moves == pytest.approx(np.array([0.4, -0.1]) - at_home[[0, 2]], rel=1e-9)
    assert len({row for _, row, _ in formulation.passed}) == 2
