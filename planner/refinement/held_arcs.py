"""Arcs of a least-time motion that are held throughout: each at a limit, the effort's own or a path's.

In a least-time motion of one effort some limit binds at every instant (Bryson & Ho 1975, section 3.9). A solution does not
show this on an arc of a few intervals. The limit then follows from the arcs before and after it.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.refinement.constrained_arcs import SAMPLES_OF_INTERVAL, FixedArcs
from linkplan.planner.refinement.switches import PiecewiseMotion

# This share of an arc along a power limit shows the arc before it.
SHARE_INTO_ARC = 0.1


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Arc:
    """One arc: its ends [s], the effort it is held at (n_u,), NaN where free, and the path quantities that it holds."""

    begin: float
    end: float
    effort: np.ndarray
    paths: np.ndarray

    @property
    def loose(self) -> bool:
        return bool(np.isnan(self.effort).all() and not self.paths.any())


def held_throughout(
    motion: PiecewiseMotion, limit: np.ndarray, ends_s: np.ndarray, fixed: FixedArcs, powers: np.ndarray
) -> tuple[np.ndarray, FixedArcs] | None:
    """Return switch times (n,) [s] and what is held, where arcs on which nothing was seen to be held are bangs.

    What lies between two arcs along paths is the switch from one to the other. From rest and to rest no power is at its
    limit: an arc along one begins and ends with a bang there, however short. From a power's limit efforts jump to its other
    one, where full effort the other way would be beyond that. None where all of that is so already.

    Args:
        motion: a solution.
        limit: (n_u, 2) of the efforts.
        ends_s: (n_segments + 1,) [s].
        fixed: what was seen to be held.
        powers: limits (n_path, 2) of path quantities that are powers, NaN of others.
    """
    if len(limit) != 1 or not np.all(np.isfinite(limit)):
        return None
    seen = [
        _Arc(begin=float(begin), end=float(end), effort=effort, paths=paths)
        for (begin, end), effort, paths in zip(itertools.pairwise(ends_s), fixed.efforts, fixed.paths, strict=True)
    ]
    arcs = _without_gaps(seen, motion, limit)
    arcs = _from_rest(arcs, motion, limit, powers)
    arcs = _from_rest(arcs[::-1], motion, limit, powers)[::-1]
    if len(arcs) == len(seen) and not any(arc.loose for arc in seen):
        return None
    switch_times = np.array([arc.end for arc in arcs[:-1]])
    return switch_times, FixedArcs(
        efforts=np.array([arc.effort for arc in arcs]), paths=np.array([arc.paths for arc in arcs])
    )


def _without_gaps(seen: list[_Arc], motion: PiecewiseMotion, limit: np.ndarray) -> list[_Arc]:
    """Return arcs of which each is held: loose ones at the limit that they are nearer to, or parted by their neighbours."""
    arcs: list[_Arc] = []
    parted: float | None = None
    for k, arc in enumerate(seen):
        if arc.loose and 0 < k < len(seen) - 1 and seen[k - 1].paths.any() and seen[k + 1].paths.any():
            parted = 0.5 * (arc.begin + arc.end)
            arcs[-1] = replace(arcs[-1], end=parted)
            continue
        if arc.loose:
            mean = motion.effort_at(np.linspace(arc.begin, arc.end, SAMPLES_OF_INTERVAL)).mean(axis=0)
            arc = replace(arc, effort=np.where(mean > limit.mean(axis=1), limit[:, 1], limit[:, 0]))
        arcs.append(arc if parted is None else replace(arc, begin=parted))
        parted = None
    return arcs


def _from_rest(arcs: list[_Arc], motion: PiecewiseMotion, limit: np.ndarray, powers: np.ndarray) -> list[_Arc]:
    """Return arcs, the outermost first, that begin with a bang up to where the power's limit is reached.

    With an inertia that is constant meanwhile and a power P, from rest: M w = U t_1 and U w = P where they meet, and from
    there the energy M w^2 / 2 grows by P. At a time t further on the effort is u, so that t_1 = 2 t / (1 + (U / u)^2).
    """
    arcs = _with_the_other_limit(arcs, motion, powers)
    known = ~np.isnan(powers[:, 0])
    first = arcs[0]
    along = first if first.paths[known].any() else arcs[1] if len(arcs) > 1 and arcs[1].paths[known].any() else None
    if along is None or (along is not first and first.paths.any()):
        return arcs
    forward = arcs[0].begin <= arcs[-1].begin
    origin, near, far = (first.begin, along.begin, along.end) if forward else (first.end, along.end, along.begin)
    at = near + SHARE_INTO_ARC * (far - near)
    effort = float(motion.effort_at(np.array([at]))[0, 0])
    most = limit[0, 1] if effort > 0 else limit[0, 0]
    if effort == 0.0 or abs(effort) >= abs(most) or (along is not first and first.effort[0] != most):
        return arcs
    meet = origin + 2.0 * (at - origin) / (1.0 + (most / effort) ** 2)
    ends = {"begin": origin, "end": meet} if forward else {"begin": meet, "end": origin}
    bang = _Arc(effort=np.array([most]), paths=0 * along.paths, **ends)
    along = replace(along, begin=meet) if forward else replace(along, end=meet)
    return [bang, along, *arcs[1 if along.paths is first.paths else 2 :]]


def _with_the_other_limit(arcs: list[_Arc], motion: PiecewiseMotion, powers: np.ndarray) -> list[_Arc]:
    """Return arcs, the outermost first, whose bang is an arc along a power's other limit where it would exceed that."""
    if len(arcs) < 2 or arcs[0].paths.any() or not arcs[1].paths.any():
        return arcs
    bang, along = arcs[:2]
    i = int(np.flatnonzero(along.paths)[0])
    here, other = powers[i] if along.paths[i] < 0 else powers[i, ::-1]
    effort = float(motion.effort_at(np.array([0.5 * (along.begin + along.end)]))[0, 0])
    if not (np.isfinite(here) and np.isfinite(other)) or effort * bang.effort[0] >= 0:
        return arcs
    if abs(bang.effort[0] / effort) <= abs(other / here):
        return arcs
    return [replace(bang, effort=np.array([np.nan]), paths=-along.paths), *arcs[1:]]
