"""The limit on a site's distance from the path that it follows, at every instant.

No row of a program imposes it, because the motion is planned in the curve's parameter and therefore lies on the curve.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.limits.limit import Bounds, Claimed, Limit, LimitFacts, Measured, Rows
from linkplan.planner.limits.samples import Poses, Samples
from linkplan.planner.problem.instant import Scales
from linkplan.planner.problem.path import SitePath
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import JOIN_SHARE, Trajectory


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
        title, bounds = f"the distance of site {path.site} from its path", (-np.inf, path.within_m)
        if not isinstance(at, Samples):
            return Measured(title, np.zeros(len(at.q)), bounds, "m", path.within_m)  # a pose alone has no place along it

        def values(q: np.ndarray, time: np.ndarray) -> np.ndarray:
            along = at.trajectory.along_at(time)
            apart = np.linalg.norm(places_of(mechanism, path.index, q) - path.curve.places(along), axis=1)
            return np.where(np.isfinite(along), apart, np.inf)

        def at_times(time: np.ndarray) -> np.ndarray:
            motion, until = at.trajectory, at.problem.solver.judging_deadline
            return values(follow(mechanism, motion.position_at(time), motion.start_pose, until), time)

        return Measured(title, values(at.q, at.time), bounds, "m", path.within_m, at_times=at_times)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        path = problem.path
        assert path is not None
        places = functools.cache(functools.partial(_squared_distance, problem.mechanism, path))
        known, passed = trajectory.along.size > 0, []
        if known:  # the pieces of the path on each interval, from the coefficients of its parameter
            of, rounding = trajectory.along[:, :, 0], JOIN_SHARE * path.curve.length
            ends = np.stack([of.min(axis=0) + rounding, np.maximum(of.max(axis=0) - rounding, of.min(axis=0) + rounding)])
            at = np.clip(np.searchsorted(path.curve.starts, ends, side="right") - 1, 0, None)
            passed = [places(tuple(range(first, last + 1))) for first, last in at.T.tolist()]
        yield Claimed(
            name=f"squared distance of site {path.site} from its path",
            unit="m2",
            bounds=(-np.inf, path.within_m**2),
            value=passed,
            unknown="" if known else "the motion does not state its place along the path",
            of_planned=True,
            slack=(0.0, 0.0),
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        if problem.path is None:
            return problem
        return problem.varied(path=replace(problem.path, within_m=problem.path.within_m * min(factor, 1e12)))


def _squared_distance(mechanism: Mechanism, path: SitePath, pieces: tuple[int, ...]) -> ca.Function:
    """Return the least squared distance [m2] of the site from the places of pieces at the path's parameter, by pose and x.

    Beyond the end of a piece, its last place counts.
    """
    q, x = ca.SX.sym("q", mechanism.n_q), ca.SX.sym("x")
    p = mechanism.dynamics.site_places(q)[:, path.index]
    of = [(path.curve.pieces[k], float(path.curve.starts[k])) for k in pieces]
    places = (piece.place(ca.fmax(0.0, ca.fmin(piece.length, x - start))) for piece, start in of)
    squared = functools.reduce(ca.fmin, (ca.sumsqr(place - p) for place in places))
    return ca.Function("path", [q, x], [ca.densify(squared)])
