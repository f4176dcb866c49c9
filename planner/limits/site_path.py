"""The path of a motion that follows one: the site's distance from its curve at every instant.

No row of a program imposes it. The motion is planned in the curve's parameter, and lies on the curve by its coordinate.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.guide.curve import Arc, Curve, Polynomial
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.limits.limit import (
    Bounds,
    Claimed,
    Facts,
    Limit,
    Measured,
    Poses,
    Problem,
    Rows,
    Samples,
    Scales,
    Trajectory,
)

# Newton steps from the chord's parameter to the nearest point of a piece; each squares the error.
_NEWTON_STEPS = 4


@dataclass(frozen=True, slots=True)
class OnPathLimit(Limit):
    """The largest distance of a site from the path that it follows."""

    key: ClassVar[str] = "path"
    item: int = 0

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [] if problem.path is None else [cls()]

    @property
    def facts(self) -> Facts:
        return Facts(kind="path", tightened=None, of_position=True)

    @property
    def rows(self) -> Rows:
        return Rows()

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        assert problem.path is not None
        return -np.inf, problem.path.within_m

    def measured(self, at: Poses) -> Measured:
        path, mechanism = at.problem.path, at.problem.mechanism
        assert path is not None

        def values(q: np.ndarray) -> np.ndarray:
            return path.curve.distance(places_of(mechanism, path.index, q))

        def at_times(time: np.ndarray) -> np.ndarray:
            motion, until = at.trajectory, at.problem.solver.judging_deadline
            return values(follow(mechanism, motion.position_at(time), motion.start_pose, until))

        finer = at_times if isinstance(at, Samples) else None
        title = f"the distance of site {path.site} from its path"
        return Measured(title, values(at.q), (-np.inf, path.within_m), "m", path.within_m, at_times=finer)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        path = problem.path
        assert path is not None
        q = ca.SX.sym("q", problem.mechanism.n_q)
        place = problem.mechanism.dynamics.site_places(q)[:, path.index]
        squared = functools.reduce(ca.fmin, _squared_distances(path.curve, place))
        yield Claimed(
            name=f"squared distance of site {path.site} from its path",
            unit="m2",
            bounds=(-np.inf, path.within_m**2),
            value=ca.Function("path", [q], [ca.densify(squared)]),
            of_planned=True,
            slack=(0.0, 0.0),
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        if problem.path is None:
            return problem
        return replace(problem, path=replace(problem.path, within_m=problem.path.within_m * min(factor, 1e12)))


def _squared_distances(curve: Curve, p: ca.SX) -> list[ca.SX]:
    """Return an upper bound [m2] of the squared distance of a place p (3,) from each piece, to rounding the distance."""
    return [ca.sumsqr(piece.place(_nearest(piece, p)) - p) for piece in curve.pieces]


def _nearest(piece: Arc | Polynomial, p: ca.SX) -> ca.SX:
    """Return the parameter of the point of a piece that is nearest to p: of its chord's, then by Newton's method."""
    x = ca.SX.sym("x")
    slope = ca.jacobian(piece.place(x), x)
    step = ca.Function("step", [x, q := ca.SX.sym("p", 3)], [x - ca.dot(slope, piece.place(x) - q) / ca.sumsqr(slope)])
    first, last = (ca.DM(ca.evalf(piece.place(ca.SX(end)))) for end in (0.0, piece.length))
    way = last - first
    share = ca.dot(p - first, way) / ca.sumsqr(way)
    found = ca.fmax(0.0, ca.fmin(1.0, share)) * piece.length
    for _ in range(_NEWTON_STEPS):
        found = ca.fmax(0.0, ca.fmin(piece.length, step(found, p)))
    return found
