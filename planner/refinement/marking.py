"""The choice of a finer mesh (intervals to halve, or a scheme of higher degree) and of tightened limits.

Limits that a motion overran between the nodes are tightened there, by the amount of the overrun.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.limits.limit import Limit, Margin, Tightened
from linkplan.planner.problem.settings import MeshSettings
from linkplan.planner.refinement.case import Case, CertifiedIterate, ErrorReport
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.mesh import Mesh
from linkplan.planner.transcription.schemes import MAX_DEGREE

# The tightening is this multiple of the overrun plus this share of the limit, so that the next motion satisfies the limit.
_OVERRUN_FACTOR = 1.1
_MIN_TIGHTENING = 1e-7
# Up to this share, a limit is tightened by the same amount along the motion. A limit that is tighter on one interval than on
# its neighbours increases the error of the polynomial at the ends of that interval.
_EVEN_TIGHTENING = 2e-5
# An interval is halved if its error is above this share of its allowance, and above the second share of the worst
# interval's.
MARKED_SHARE, SHARE_OF_WORST = 0.5, 0.01
# If the dynamics are not satisfied, an interval with less than this share of the largest residual only inherits the error of
# other intervals, and is not halved.
SHARE_OF_RESIDUAL = 1e-6
# An overrun between the nodes above this share of the limit is removed by a finer mesh. A smaller one is removed by
# tightening, which costs about the same share of the objective.
TIGHTENED_OVERRUN = 1e-7
# When limits are loosened, intervals with an overrun above this share of the largest are halved.
LARGE_OVERRUN_SHARE = 0.1
# The degree is raised if at least this share of the intervals is inexact, and the worst error is at most this factor above
# the median: the motion is smooth there.
EVEN_SHARE = 0.5
OUTLIER_FACTOR = 30.0
# Least number of intervals of an arc along a limit; fewer are the end of an arc inside an interval.
INTERVALS_OF_ARC = 3
# An interval is rough if an effort bends there by at least this share of its largest bend.
ROUGH_SHARE = 0.01


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Tightening:
    """The tightening of one limit, as a share (n,) of the limit; `breaks` (n + 1,) are shares of the duration."""

    what: str
    item: int
    breaks: np.ndarray
    share: np.ndarray
    upper: bool = True  # the limit's end to which the share refers


def tightened_share(overrun: np.ndarray) -> np.ndarray:
    """Return the tightening (n,) of a limit on intervals with overruns, both as shares of the limit."""
    return np.where(overrun > 0, _OVERRUN_FACTOR * overrun + _MIN_TIGHTENING, 0.0)


def tightenings_of(margins: tuple[Margin, ...], breaks_s: np.ndarray) -> tuple[Tightening, ...]:
    """Return the tightening of each limit that a motion with breaks (n + 1,) [s] overruns, by its margin.

    A limit with an infinite overrun, such as a jerk where an acceleration jumps, is not tightened.
    """
    relative = (breaks_s - breaks_s[0]) / (breaks_s[-1] - breaks_s[0])
    return tuple(
        Tightening(what=one.what, item=one.item, breaks=relative, share=tightened_share(one.overrun), upper=one.upper)
        for one in margins
        if one.of.facts.tightened not in (None, Tightened.IN_PROBLEM) and not one.kept and np.isfinite(one.left)
    )


def evened(tightenings: tuple[Tightening, ...]) -> tuple[Tightening, ...]:
    """Return the tightenings, the small ones made constant along the motion."""
    most = [one.share.max(initial=0.0) for one in tightenings]
    return tuple(
        replace(one, share=np.full_like(one.share, share)) if share <= _EVEN_TIGHTENING else one
        for one, share in zip(tightenings, most, strict=True)
    )


def tightening_over(
    tightenings: tuple[Tightening, ...], rows: Sequence[Limit], path: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function from breaks (n + 1,) [s] to the tightening (n, n_path) of the bounds `path` (n_path, 2).

    The first bounds are those of the limits `rows`, in this order. The other bounds are never tightened.
    """
    size = np.where(np.isfinite(path), np.where(path == 0, 1.0, np.abs(path)), 0.0)
    size[[column for column, row in enumerate(rows) if row.facts.tightened is Tightened.IN_UNITS]] = 1.0
    factor = [2.0 if row.facts.tightened is Tightened.SQUARED else 1.0 for row in rows]
    columns = {(row.facts.kind, row.item): column for column, row in enumerate(rows)}
    # Tightening both bounds leaves at least a tenth of the distance between them.
    most = np.where(np.all(np.isfinite(path), axis=1), 0.45 * (path[:, 1] - path[:, 0]), np.inf)

    def tightening(breaks_s: np.ndarray) -> np.ndarray:
        middle = (0.5 * (breaks_s[1:] + breaks_s[:-1]) - breaks_s[0]) / (breaks_s[-1] - breaks_s[0])
        amount = np.zeros((len(middle), len(path)))
        for one in tightenings:
            column = columns.get((one.what, one.item))
            if column is not None:
                share = one.share[np.clip(np.searchsorted(one.breaks, middle, side="right") - 1, 0, len(one.share) - 1)]
                amount[:, column] += size[column, int(one.upper)] * factor[column] * share
        return np.minimum(amount, most)

    return tightening


def marked_for(at: CertifiedIterate, strictness: float) -> np.ndarray:
    """Return the intervals (n,) with more than their share of an error that is too large."""
    report, n = at.report, at.n_intervals
    if report is None:
        return np.ones(n, dtype=bool)
    with np.errstate(over="ignore"):
        growth, residual = report.growth * strictness, report.residual_share
    if not np.all(np.isfinite(growth)):
        return np.ones(n, dtype=bool)
    marked = np.zeros(n, dtype=bool)
    if residual.max() > 1.0:
        marked |= residual > MARKED_SHARE
        growth = np.where(residual > SHARE_OF_RESIDUAL * residual.max(), growth, 0.0)
    if growth.sum() > 1.0:
        marked |= growth > MARKED_SHARE * max(1.0, SHARE_OF_WORST * growth.max() * n) / n
    return marked


def overrunning(at: CertifiedIterate) -> np.ndarray:
    """Return the intervals (n,) on which a limit is overrun by more than tightening should remove."""
    if at.report is None:
        return np.zeros(at.n_intervals, dtype=bool)
    overrun = at.report.overrun
    return overrun > max(TIGHTENED_OVERRUN, SHARE_OF_WORST * overrun.max(initial=0.0))


def most_overrun(at: CertifiedIterate) -> np.ndarray:
    """Return the intervals (n,) with an overrun near the largest one."""
    overrun = np.zeros(at.n_intervals) if at.report is None else at.report.overrun
    return overrun > LARGE_OVERRUN_SHARE * overrun.max(initial=0.0)


def grown(mesh: Mesh, marked: np.ndarray) -> int:
    """Return the number of intervals once those marked (n,) are halved."""
    return mesh.n_intervals + int(marked.sum())


def rough_of(motion: Trajectory) -> np.ndarray:
    """Return the intervals (n,) near kinks, on which the efforts' polynomials have the largest highest-degree terms."""
    widths, degree = np.diff(motion.breaks_s), motion.effort.shape[0] - 1
    bend = np.abs(np.diff(motion.effort, n=degree, axis=0)[0]) if degree else np.abs(motion.effort[0])
    size = np.maximum(np.abs(motion.effort).max(axis=(0, 1)), np.finfo(float).tiny)
    rough = widths * (bend / size).max(axis=1)
    return rough >= ROUGH_SHARE * rough.max()


def higher_for(case: Case, report: ErrorReport | None, marked: np.ndarray) -> str | None:
    """Return the scheme of higher degree that reduces the error more than a finer mesh, or None."""
    if report is None or not marked.any():
        return None
    growth = report.growth[marked]
    even = marked.mean() >= EVEN_SHARE and growth.max() <= OUTLIER_FACTOR * max(float(np.median(growth)), 1e-300)
    return raised(case.problem.mesh) if even or case.problem.mesh.refine == "degree" else None


def higher_on_arcs(case: Case, at: CertifiedIterate, over: np.ndarray) -> str | None:
    """Return the scheme of higher degree if limits are overrun evenly along smooth arcs, or None."""
    if at.report is None or not over.any():
        return None
    fixed = at.found.fixed
    if case.target.switches and (fixed is None or not np.all(fixed.paths[at.found.mesh.segment[over]].any(axis=1))):
        return None  # an arc that is not fixed may end inside an interval, which requires a switch time
    overrun = at.report.overrun[over]
    even = len(overrun) >= INTERVALS_OF_ARC and overrun.max() <= OUTLIER_FACTOR * float(np.median(overrun))
    return raised(case.problem.mesh) if even or case.problem.mesh.refine == "degree" else None


def raised(mesh: MeshSettings) -> str | None:
    """Return the scheme two degrees higher than that of a mesh; None if there is no such scheme or it is not allowed."""
    family = re.fullmatch(r"(radau|gauss)-(\d)", mesh.scheme)
    if family is None or mesh.refine == "intervals" or int(family[2]) == MAX_DEGREE:
        return None
    return f"{family[1]}-{min(int(family[2]) + 2, MAX_DEGREE)}"


def degree_of(scheme_name: str) -> int:
    """Return the degree in the name of a scheme."""
    return int(scheme_name.rpartition("-")[2])
