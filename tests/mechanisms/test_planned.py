"""Built-in mechanisms' problems: each plan passes its certificate within its limits, and LQR tracks it in MuJoCo."""

import numpy as np
import pytest

from tests.support.mechanism_checks import plan_of, tracked
from tests.support.tolerances_planner import BOUNDARY, CLOSURE_M, LQR_IN_A_FAST_TURN_DEG, LQR_M, ROLLOUT_GAP_M

# Largest errors of LQR [rad or m].
ERRORS = {
    "squeezer-turn": np.radians(LQR_IN_A_FAST_TURN_DEG),
    "gripper-close": np.radians(LQR_IN_A_FAST_TURN_DEG),
    "five-bar-reach": np.radians(1.0),
    "five-bar-swing-up": np.radians(1.0),
    "slider-crank-turn": np.radians(1.0),
    "knee-linear-reach": LQR_M,
}


@pytest.mark.slow
@pytest.mark.parametrize("problem", ERRORS)
def test_a_plan_passes_its_certificate_and_lqr_tracks_it_in_mujoco(problem):
    plan, rollout = plan_of(problem), tracked(problem, "lqr")
    effort, limit = plan.trajectory.effort, plan.problem.limits.effort
    assert plan.certificate.failures == ()
    assert plan.certificate.closure_gap_m < CLOSURE_M
    assert np.all((limit[:, 0] <= effort) & (effort <= limit[:, 1]))
    ends = plan.trajectory.position_at(np.array([0.0, plan.trajectory.duration_s]))
    assert np.abs(ends - [plan.problem.motion.start, plan.problem.motion.goal]).max() < BOUNDARY
    assert rollout.stable
    assert np.abs(rollout.error_rad).max() < ERRORS[problem]
    assert rollout.gap_m.max() < ROLLOUT_GAP_M


@pytest.mark.slow
def test_the_swing_up_of_the_five_bar_gathers_way_before_it_goes_over():
    """The torques cannot lift the links: a straight way up is closed, and the load swings at least once."""
    trajectory = plan_of("five-bar-swing-up").trajectory
    mean = trajectory.position_at(np.linspace(0, trajectory.duration_s, 400)).mean(axis=1)
    assert np.sum(np.diff(np.sign(np.diff(mean))) != 0) >= 1
    assert np.degrees(mean.min()) < -100.0
