"""Collisions along a motion: whether every motion has them, and how they are told."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.models.poses.contacts import Meeting
from linkplan.planner.certificate.further_checks import unavoidable


def meeting(since: float | None) -> Meeting:
    depths = {"depth_m": 1e-3, "home_depth_m": 0.0}
    return Meeting(first="a", second="b", bodies=("A", "B"), since=since, deepest_at=since or 0.0, **depths)


@pytest.mark.parametrize(("start", "goal"), [(1.0, 3.0), (3.0, 1.0)])
@pytest.mark.parametrize(
    ("pose", "expected"), [(0.9, False), (1.0, True), (2.0, True), (3.0, True), (3.1, False), (None, False)]
)
def test_a_collision_is_unavoidable_at_a_pose_between_start_and_goal(start, goal, pose, expected):
    motion = SimpleNamespace(start=np.array([start]), goal=np.array([goal]))
    problem = SimpleNamespace(contacts="refuse", mechanism=SimpleNamespace(dof=1), motion=motion)
    trajectory = SimpleNamespace(position_at=lambda time: time[:, None])  # it is at pose t at the instant t
    assert unavoidable(problem, trajectory, SimpleNamespace(contacts=(meeting(pose),))) is expected
