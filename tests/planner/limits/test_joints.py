"""Sentences on joints that a motion moves too far or too fast, against the motion's closed form."""

import numpy as np
import pytest

from linkplan.planner.limits.joints import RangeLimit, SpeedLimit
from linkplan.planner.limits.kinds import violation
from linkplan.planner.transcription.bernstein import bernstein_matrix
from tests.support.bodies import HINGE, body_problem
from tests.support.motions import motion_along

REACH = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 90.0 }\nduration_s = 2.0\n'


def turn(*overrides: str):
    """Return a problem and the motion q = 100 deg sin(pi t / 2), up and back in two seconds, by polynomials."""
    problem = body_problem(HINGE, REACH, *overrides)
    breaks = np.linspace(0.0, 2.0, 5)
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(6) / 5)
    time = breaks[:-1] + 0.5 * nodes[:, None]
    angle, rate = np.radians(100.0), 0.5 * np.pi
    position, velocity = angle * np.sin(rate * time), angle * rate * np.cos(rate * time)
    solved = [np.linalg.solve(bernstein_matrix(5, nodes), values)[:, :, None] for values in (position, velocity)]
    motion = motion_along(breaks, solved[0], velocity=solved[1])
    return problem, motion


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        ("[-10.0, 95.0]", "joint J would have to come to 100 deg at t = 1 s, 5 deg beyond its limit of 95 deg"),
        ("[-10.0, 101.0]", None),
    ],
)
def test_a_joint_that_would_leave_its_range_is_named_with_the_instant_and_the_excess(limit, said):
    assert violation(RangeLimit, *turn(f"limits.range_deg.J={limit}")) == said


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        (
            "[-150.0, 500.0]",
            "the speed of joint J would have to come to -157.1 deg/s at t = 2 s, 7.08 deg/s beyond its limit of -150 deg/s",
        ),
        ("158.0", None),
    ],
)
def test_a_joint_that_would_be_too_fast_is_named_with_the_instant_and_the_excess(limit, said):
    assert violation(SpeedLimit, *turn(f"limits.speed_deg_s.J={limit}")) == said
