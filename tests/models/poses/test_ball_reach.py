"""The reach, `check` and `new` keep the ranges of ball joints, as MuJoCo measures them."""

import mujoco
import numpy as np

import linkplan
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.reach import reach
from linkplan.planner.problem.start import is_open
from linkplan.studies.check.new.clear_way import obstacle_on_way
from tests.support.hexapod import hexapod
from tests.support.linkages import RSSR

LARGEST_DEG = 25.0


def ranged(text: str, largest_deg: float) -> linkplan.Mechanism:
    """Return a model's mechanism with a range on every ball joint."""
    largest = np.radians(largest_deg) if 'angle="radian"' in text else largest_deg
    return linkplan.load_mechanism(text.replace('type="ball"', f'type="ball" limited="true" range="0 {largest}"'))


def limits_in_mujoco(mechanism: linkplan.Mechanism, pose: np.ndarray) -> list[float]:
    """Return the distances [rad or m] of MuJoCo's active limits of joints at a pose."""
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(pose)
    mujoco.mj_forward(mechanism.model, data)
    limit = mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
    return [float(data.efc_pos[k]) for k in range(data.nefc) if data.efc_type[k] == limit]


def test_a_reach_ends_where_mujoco_s_limit_of_a_ball_joint_acts():
    mechanism, free = ranged(RSSR, LARGEST_DEG), linkplan.load_mechanism(RSSR)
    ball, wide = reach(mechanism), reach(free)
    assert ball.upper.reason == "range of ball joint rod"
    assert ball.upper.position < wide.upper.position - 0.1
    end = ball.poses[-1][mechanism.independent]
    last, beyond = (close_at(mechanism, end + np.array([d, 0.0]), ball.poses[-1]) for d in (-1e-7, 1e-7))
    assert limits_in_mujoco(mechanism, last) == []
    (distance,) = limits_in_mujoco(mechanism, beyond)
    assert -1e-6 < distance < 0
    assert is_open(mechanism, 0.9 * end)
    assert not is_open(mechanism, 1.1 * end)
    assert is_open(free, 1.1 * end)


def test_a_ball_joint_beyond_its_range_at_home_is_a_problem():
    mechanism = ranged(RSSR, LARGEST_DEG)
    beyond = np.degrees(1.2 * reach(mechanism).upper.position)
    text = RSSR.replace('type="ball"', f'type="ball" limited="true" range="0 {np.radians(LARGEST_DEG)}"')
    found = linkplan.check(linkplan.load_mechanism(text, home_deg={"crank": beyond}))
    (problem,) = [line for line in found.problems if "ball joint rod is turned by" in line]
    assert "at home, beyond its range of 25 deg" in problem
    assert not [line for line in linkplan.check(mechanism).problems if "ball joint" in line]


def test_a_first_motion_of_a_stewart_platform_keeps_its_ball_joints_ranges():
    mechanism = ranged(hexapod(), 3.0)
    slides = [f"s{k}" for k in range(6)]

    def lift(names: list[str]) -> linkplan.Problem:
        return linkplan.Problem.reach(
            mechanism, start_m=dict.fromkeys(slides, 0.0), goal_m=dict.fromkeys(slides, 0.0) | dict.fromkeys(names, 0.02)
        )

    assert obstacle_on_way(lift(["s0"])) == "ball joint b0 is outside its range"
    assert obstacle_on_way(lift(slides)) is None
