"""Limits on the angle of a body, and the coordinates of tasks in a program.

The row of a limit is the angle relative to home [rad]. The angle is linear in the joints' positions
(`linkplan.models.poses.body_angles`), so it can also limit a joint that appears in no other limit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.body_angles import turning
from linkplan.planner.limits.joints import RANGE_SLACK
from linkplan.planner.limits.limit import Bounds, Claimed, Limit, LimitFacts, Measured, Rows, Tightened, with_limits
from linkplan.planner.limits.samples import Poses
from linkplan.planner.limits.site import site_at_home, way
from linkplan.planner.problem.instant import Instant, Scales
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import ANGLE, AXES, BodyAngle, Task, angles_of
from linkplan.planner.trajectory import Trajectory

# Overruns are shares of one radian [deg].
_RADIAN_DEG = float(np.degrees(1.0))


@dataclass(frozen=True, slots=True)
class BodyAngleLimit(Limit):
    """The limit on the angle of one body, number `item` of limits.body_deg; `body` is its index in the model."""

    key: ClassVar[str] = "body"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key, words="the angle of body {}", tightened=Tightened.IN_UNITS, of_position=True, by_size=True
    )
    item: int
    body: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        limits = enumerate(problem.limits.body)
        return [cls(item, limit.index) for item, limit in limits if np.isfinite([limit.low, limit.high]).any()]

    @property
    def rows(self) -> Rows:
        return Rows(node=lambda at, _: coordinate(at, self.body, ANGLE))

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        limit = problem.limits.body[self.item]
        low, high = (scaled_coordinate(problem.mechanism, self.body, ANGLE, end) for end in (limit.low, limit.high))
        return low, high

    def measured(self, at: Poses) -> Measured:
        limit = at.problem.limits.body[self.item]
        angles, bounds = np.degrees(limit.at_poses(at.problem.mechanism, at.q)), np.degrees([limit.low, limit.high])

        def known_from(tasks: Sequence[Task]) -> bool:
            return any(isinstance(task, BodyAngle) and task.index == limit.index for task in tasks)

        return Measured(limit.body, angles, bounds, "deg", _RADIAN_DEG, known_from=known_from)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        limit, q = problem.limits.body[self.item], ca.SX.sym("q", problem.mechanism.n_q)
        yield Claimed(
            name=f"angle of body {limit.body}",
            unit="deg",
            bounds=(limit.low, limit.high),
            value=ca.Function("angle", [q], [ca.densify(expression_of(problem.mechanism, self.body, ANGLE, q))]),
            of_planned=True,
            slack=(RANGE_SLACK, RANGE_SLACK),
            per_unit=_RADIAN_DEG,
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        room = factor - 1  # of one radian
        wider = tuple(replace(one, low=one.low - room, high=one.high + room) for one in problem.limits.body)
        return with_limits(problem, body=wider)


def coordinate(at: Instant, index: int, axis: int) -> ca.SX:
    """Return the displacement from home of a site along an axis of the world [extents], or of a body's angle [rad]."""
    if axis == ANGLE:
        return expression_of(at.mechanism, index, axis, at.q) - _home(at.mechanism, index, axis)
    return way(at, index, np.eye(len(AXES))[axis])


def scaled_coordinate(mechanism: Mechanism, index: int, axis: int, value: float) -> float:
    """Return the value of `coordinate` at a coordinate [m or rad]."""
    return (value - _home(mechanism, index, axis)) / unit_of(mechanism, axis)


def expression_of(mechanism: Mechanism, index: int, axis: int, q: ca.SX) -> ca.SX:
    """Return a coordinate [m or rad] at a pose q (n_q,)."""
    if axis == ANGLE:
        return ca.dot(ca.DM(turning(mechanism, index, "the angle")), q)
    return mechanism.dynamics.site_places(q)[axis, index]


def unit_of(mechanism: Mechanism, axis: int) -> float:
    """Return the unit of a coordinate in the program: the mechanism's extent [m], or one radian."""
    return 1.0 if axis == ANGLE else mechanism.extent_m


def _home(mechanism: Mechanism, index: int, axis: int) -> float:
    """Return a coordinate [m or rad] at home."""
    if axis == ANGLE:
        return float(angles_of(mechanism, index, mechanism.home)[0])
    return float(site_at_home(mechanism, index)[axis])
