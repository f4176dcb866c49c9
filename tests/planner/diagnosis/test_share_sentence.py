"""The sentence on a motion that barely passes a pose: it names the slowest passage, and neither rests nor turning points."""

import re

import numpy as np
import pytest

from linkplan.planner.closed_chain.guess import Guess
from linkplan.planner.search.reasons import share_sentence
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem

DURATION_S, SLOWEST_S = 2.0, 1.3


def motion(speed, position) -> Guess:
    """Return a motion of the hinge with a speed, a position and an effort that grows evenly with time."""
    return Guess(
        position=lambda t: position(t)[:, None],
        velocity=lambda t: speed(t)[:, None],
        acceleration=lambda t: np.zeros((len(t), 1)),
        effort=lambda t: 2.0 + t[:, None],
        duration_s=DURATION_S,
        start_pose=np.zeros(1),
    )


def barely(t: np.ndarray) -> np.ndarray:
    """Return a speed that vanishes at both ends, and is least between them at SLOWEST_S."""
    return np.sin(np.pi * t / DURATION_S) * (0.005 + (t - SLOWEST_S) ** 2) * 3.0


@pytest.mark.parametrize("at_all", [True, False])
def test_the_pose_that_is_barely_passed_is_named(at_all):
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n")
    said = share_sentence(problem, 1.1, motion(barely, lambda t: t), at_all=at_all)
    time = np.linspace(0.1, 1.9, 100001)
    slowest = float(time[np.argmin(barely(time))])
    assert f"motor on joint J would have to give {2.0 + slowest:.3g}"[:-1] in said
    if at_all:
        named = re.search(r"to pass J = ([\d.]+) deg at t = ([\d.]+) s", said)
        assert float(named[1]) == pytest.approx(np.degrees(slowest), rel=2e-3)
        assert float(named[2]) == pytest.approx(slowest, rel=5e-3)
    else:
        assert said.endswith("throughout")
