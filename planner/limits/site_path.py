"""The limit on a site's distance from the path that it follows, at every instant.

No row of a program imposes it, because the motion is planned in the curve's parameter and therefore lies on the curve.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.guide.curve import Arc, Polynomial
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.limits.limit import Bounds, Claimed, Limit, LimitFacts, Measured, Rows
from linkplan.planner.limits.samples import Poses, Samples
from linkplan.planner.problem.instant import Scales
from linkplan.planner.problem.path import SitePath
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory

# Most Newton steps from the chord's parameter to that of a piece's nearest point, and their allowed error as a share of the
# piece's length: a squared distance then has an error of 1e-16 of the squared length.
_NEWTON_STEPS, _MISSED_SHARE = 6, 1e-8
# Shares of an interval at which the nearest piece is searched. They avoid the ends, because plans have nodes at the ends of
# pieces.
_SHARES = np.array([1e-6, 0.25, 0.5, 0.75, 1 - 1e-6])


@dataclass(frozen=True, slots=True)
class OnPathLimit(Limit):
    """The largest distance of a site from the path that it follows."""

    key: ClassVar[str] = "path"
    item: int = 0

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [] if problem.path is None else [cls()]

    @property
    def facts(self) -> LimitFacts:
        return LimitFacts(kind="path", tightened=None, of_position=True)

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
        places = functools.cache(functools.partial(_squared_distance, problem.mechanism, path))
        yield Claimed(
            name=f"squared distance of site {path.site} from its path",
            unit="m2",
            bounds=(-np.inf, path.within_m**2),
            value=[places(pieces) for pieces in _pieces_near(problem, trajectory)],
            of_planned=True,
            slack=(0.0, 0.0),
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        if problem.path is None:
            return problem
        return replace(problem, path=replace(problem.path, within_m=problem.path.within_m * min(factor, 1e12)))


def _pieces_near(problem: Problem, trajectory: Trajectory) -> list[tuple[int, ...]]:
    """Return the pieces of the path nearest to the site on each interval."""
    path, mechanism = problem.path, problem.mechanism
    assert path is not None
    q = trajectory.position_at(trajectory.times_at(_SHARES))
    q = follow(mechanism, q, trajectory.start_pose, problem.solver.judging_deadline)
    nearest = path.curve.nearest(places_of(mechanism, path.index, q))
    pieces = np.searchsorted(path.curve.starts, nearest, side="right") - 1
    return [tuple(range(min(of), max(of) + 1)) for of in pieces.reshape(-1, len(_SHARES)).tolist()]


def _squared_distance(mechanism: Mechanism, path: SitePath, pieces: tuple[int, ...]) -> ca.Function:
    """Return an upper bound [m2] of the squared distance of the site from pieces, to rounding the distance, by the pose."""
    q = ca.SX.sym("q", mechanism.n_q)
    p = mechanism.dynamics.site_places(q)[:, path.index]
    of = [path.curve.pieces[k] for k in pieces]
    squared = functools.reduce(ca.fmin, (ca.sumsqr(piece.place(_nearest(piece, p)) - p) for piece in of))
    return ca.Function("path", [q], [ca.densify(squared)])


def _nearest(piece: Arc | Polynomial, p: ca.SX) -> ca.SX:
    """Return the parameter of the point of a piece that is nearest to p: of its chord's, then by Newton's method.

    It takes only as many steps as the piece's points need, because each step doubles the width of a ball around the
    parameter.
    """
    x, q = ca.SX.sym("x"), ca.SX.sym("p", 3)
    place = piece.place(x)
    slope = ca.jacobian(place, x)
    step = ca.Function("step", [x, q], [x - ca.dot(slope, place - q) / ca.sumsqr(slope)])
    first, last = (ca.DM(ca.evalf(piece.place(ca.SX(end)))) for end in (0.0, piece.length))
    way = last - first
    found = piece.length * ca.fmax(0.0, ca.fmin(1.0, ca.dot(q - first, way) / ca.sumsqr(way)))
    along = np.linspace(0.0, piece.length, 20)
    for _ in range(_NEWTON_STEPS):
        found = ca.fmax(0.0, ca.fmin(piece.length, step(found, q)))
        missed = ca.Function("missed", [x], [ca.substitute(found, q, place) - x]).map(len(along))
        if np.abs(np.array(missed(along[None]))).max() <= _MISSED_SHARE * piece.length:
            break
    return ca.substitute(found, q, p)
