"""Angles of ball joints with a range, at poses q (n, n_q)."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled


def ball_angles(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return the angles [rad] (n, n_balls) of the ball joints with a range, in the order of `mechanism.balls`."""
    if not mechanism.balls:
        return np.empty((len(poses), 0))
    turns = sampled(mechanism.dynamics.ball_turns, poses)[:, :, 0]
    return 2 * np.arcsin(np.sqrt(np.clip(turns, 0.0, 1.0)))


def beyond_balls(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return how far ball joints are turned beyond their ranges [rad] (n, n_balls); values inside are negative."""
    return ball_angles(mechanism, poses) - [ball.largest for ball in mechanism.balls]


def shut_balls(mechanism: Mechanism) -> str | None:
    """Return a sentence on the ball joints with a range of 0 deg, as by a default limited="true"; else None."""
    names = [ball.name for ball in mechanism.balls if ball.largest == 0]
    if not names:
        return None
    return (
        f'ball joint {", ".join(names)} may not turn: limited="true" with a range of 0 deg, which a default class gives to'
        ' all joints; limited="false" at the joint, or a range, frees it'
    )
