"""Ranges of ball joints: the largest angle of their rotation, which MuJoCo measures from the joint's zero quaternion.

The angle alpha has no derivative at zero, so limits use sin^2(alpha / 2) = 1 - w^2 of the unit quaternion (w, x, y, z).
"""

from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.tree.coordinates import BALL, Coordinates, joint_label, turned_quaternion
from linkplan.models.tree.passive import limits_off


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class BallRange:
    """The largest angle [rad] of a ball joint, less its margin."""

    name: str
    joint: int  # of MuJoCo's model
    largest: float


def limited_balls(model: mujoco.MjModel) -> tuple[BallRange, ...]:
    """Return the ranges of a model's ball joints; a range of half a turn or more limits nothing."""
    if limits_off(model):
        return ()
    limited = [j for j in range(model.njnt) if int(model.jnt_type[j]) == BALL and model.jnt_limited[j]]
    largest = [float(model.jnt_range[j].max() - model.jnt_margin[j]) for j in limited]
    named = zip(limited, largest, strict=True)
    return tuple(BallRange(name=joint_label(model, j), joint=j, largest=angle) for j, angle in named if angle < np.pi)


def ball_turns(model: mujoco.MjModel, coordinates: Coordinates, q: ca.SX) -> ca.SX:
    """Return sin^2(alpha / 2) (n_balls,) of the limited ball joints at coordinates q (n_q,)."""
    charts, turns = {chart.joint: chart for chart in coordinates.charts}, []
    for ball in limited_balls(model):
        chart = charts[ball.joint]
        w, x, y, z = ca.vertsplit(turned_quaternion(chart, q))
        real = chart.centre[0] * w - (chart.centre[1] * x + chart.centre[2] * y + chart.centre[3] * z)
        turns.append(1 - real**2)
    return ca.vertcat(ca.SX(0, 1), *turns)
