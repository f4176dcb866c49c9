"""Ranges of ball joints as limits at every instant: angles as MuJoCo measures them, plans that keep them, refusals."""

import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.limits.joints import BallLimit
from linkplan.planner.problem.problem import Problem
from tests.support.linkages import RSSR

GOAL_DEG = 40.0


def rssr(largest_deg: float) -> linkplan.Mechanism:
    """Return a spatial four-bar whose ball joint has a range."""
    ranged = f'type="ball" limited="true" range="0 {np.radians(largest_deg)}"'
    return linkplan.load_mechanism(RSSR.replace('type="ball"', ranged))


def reach(largest_deg: float, **further) -> Problem:
    """Return a reach of the crank, along which the rod turns about its ball joint."""
    return Problem.reach(
        rssr(largest_deg), start_deg={"crank": 0.0}, goal_deg={"crank": GOAL_DEG}, duration_s=0.5, **further
    )


def angles_deg(mechanism: linkplan.Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return the ball joint's angles as MuJoCo's limits measure them."""
    address = int(mechanism.model.jnt_qposadr[mechanism.model.joint("rod").id])
    found = []
    for qpos in mechanism.qpos_of(poses):
        turn = np.zeros(3)
        quaternion = qpos[address : address + 4] / np.linalg.norm(qpos[address : address + 4])
        mujoco.mju_quat2Vel(turn, quaternion, 1.0)
        found.append(np.degrees(np.linalg.norm(turn)))
    return np.array(found)


def test_its_value_is_the_angle_that_mujoco_limits():
    mechanism = rssr(60.0)
    q = mechanism.home + np.random.default_rng(1).uniform(-0.5, 0.5, (20, mechanism.n_q))
    turns = np.array(mechanism.dynamics.ball_turns.map(20)(q.T)).ravel()
    assert np.degrees(2 * np.arcsin(np.sqrt(turns))) == pytest.approx(angles_deg(mechanism, q), rel=1e-9)
    assert [ball.largest for ball in mechanism.balls] == pytest.approx([np.radians(60.0)])
    assert rssr(200.0).balls == ()  # more than half a turn limits nothing


@pytest.mark.slow
def test_a_plan_keeps_the_range_at_every_instant_and_proves_it():
    plan = linkplan.plan(reach(90.0)).require()
    (margin,) = [one for one in plan.certificate.margins if isinstance(one.of, BallLimit)]
    poses = np.array([list(plan.sample(t).position_deg.values()) for t in np.linspace(0.0, 0.5, 41)])
    assert margin.value == pytest.approx(angles_deg(plan.problem.mechanism, np.radians(poses)).max(), rel=1e-3)
    assert margin.left == pytest.approx(90.0 - margin.value)
    (proved,) = [one for one in plan.proof.findings if "ball joint rod" in one.name]
    assert proved.answer == "proved"
    narrow = certify(reach(0.9 * margin.value), plan.trajectory)
    assert any("angle of ball joint rod" in failure for failure in narrow.failures)


def test_a_goal_beyond_the_range_is_infeasible_and_says_so():
    plan = linkplan.plan(reach(5.0))
    assert plan.status == "infeasible"
    assert "the angle of ball joint rod is" in plan.message
    assert "beyond its limit of 5" in plan.message
