"""Rows of a goal that is a place of a site and of limits on the pose; the smoothing of efforts among an interval's costs."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.formulate import _exact_costs, _is_given_with_pose, site_endpoint
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.mechanics import _row_kind
from linkplan.planner.closed_chain.transcribe import choose_scales
from linkplan.planner.limits.kinds import limits_of
from linkplan.planner.problem.problem import load_problem
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem
from tests.support.sites import arm_of, site_problem


def test_a_motion_ends_where_the_site_is_at_the_place_asked_for():
    motion = {"start_deg": {"J1": 60.0, "J2": 40.0, "J3": 20.0}, "goal_at": {"foot": [0.2, 0.0, -0.3]}, "duration_s": 0.5}
    problem, unit = site_problem(arm_of(0.25, 0.2, 0.15), motion), np.array([2.0, 0.5, 3.0])
    ends, given = site_endpoint(problem, unit, 0)

    def rows(position: np.ndarray) -> np.ndarray:
        last = np.concatenate([position / unit, np.zeros(3)])
        return np.array(ends.function(np.zeros(6), last, 1.0, given)).ravel()

    assert rows(problem.motion.goal) == pytest.approx(np.zeros(len(given) + 1), abs=1e-9)
    assert np.abs(rows(problem.motion.goal + 0.1)).max() > 1e-2


def test_smoothing_adds_to_the_cost_of_efforts_that_change():
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n")
    scales = choose_scales(problem, first_guess(problem, problem.start_pose()))
    assert set(_exact_costs(problem, scales, None, 2.0, 0.0)) == {"effort"}
    smoothed = _exact_costs(problem, scales, 0.3, 2.0, 0.0)
    assert smoothed["effort_rate"] == pytest.approx([0.3])
    assert smoothed["effort"] == pytest.approx(scales.effort**2 * scales.time_s / 2.0)


def test_a_singular_margin_is_a_row_of_given_poses_too_and_ranges_are_not():
    limits = limits_of(load_problem("knee-reach", ["limits.singular_margin=0.1", "limits.power_w.act_O=500"]))
    given = {limit.key: _is_given_with_pose(limit) for limit in limits}
    assert given == {"effort": False, "position": True, "power": False, "singular_margin": False}
    kinds = {limit.key: _row_kind(limit.facts) for limit in limits}
    assert kinds == {"effort": "effort", "position": "path", "power": "power", "singular_margin": "path"}
