"""What a finer mesh is to be: which intervals to halve, and where a higher degree is worth more."""

import re
from typing import Any

import numpy as np

from linkplan.planner.problem.settings import MeshSettings
from linkplan.planner.refinement.case import Case, CertificateT, MotionT
from linkplan.planner.refinement.judged import Judged
from linkplan.planner.refinement.switches import Motion
from linkplan.planner.transcription.mesh import Mesh
from linkplan.planner.transcription.schemes import MAX_DEGREE

# The share of its allowance that marks an interval for halving; how far below the worst interval's error another may be to
# be halved with it.
MARKED_SHARE, SHARE_OF_WORST = 0.5, 0.01
# Where dynamics are not kept, an interval with less than this share of the largest residual adds nothing to the error of the
# integrated state: it carries on what others have begun.
SHARE_OF_RESIDUAL = 1e-6
# A limit overrun between the nodes by more than this share of itself is a matter for the mesh; for less the limit is
# tightened, which costs the objective about as much.
TIGHTENED_OVERRUN = 1e-7
# Intervals on which a limit is overrun by this share of the most are halved where limits are loosened.
LARGE_OVERRUN_SHARE = 0.1
# The degree is raised where at least this share of the intervals asks for more, and none stands out by more than this
# factor: the motion is smooth there, and nodes are worth more than intervals.
EVEN_SHARE = 0.5
OUTLIER_FACTOR = 30.0
# Fewer intervals in a row than these are no arc along a limit, but the end of one inside an interval.
INTERVALS_OF_ARC = 3
# Intervals with at least this share of the largest bend of an effort are rough: halved where the objective has not settled.
ROUGH_SHARE = 0.01


def marked_for(at: Judged[Any, Any], strictness: float) -> np.ndarray:
    """Return which intervals (n,) to halve: those with more than their share of an error that is too large."""
    certificate, n = at.certificate, at.n_intervals
    if certificate is None:
        return np.ones(n, dtype=bool)
    with np.errstate(over="ignore"):
        growth, residual = certificate.growth * strictness, certificate.residual_share
    if not np.all(np.isfinite(growth)):
        return np.ones(n, dtype=bool)
    marked = np.zeros(n, dtype=bool)
    if residual.max() > 1.0:
        marked |= residual > MARKED_SHARE
        growth = np.where(residual > SHARE_OF_RESIDUAL * residual.max(), growth, 0.0)
    if growth.sum() > 1.0:
        marked |= growth > MARKED_SHARE * max(1.0, SHARE_OF_WORST * growth.max() * n) / n
    return marked


def overrunning(at: Judged[Any, Any]) -> np.ndarray:
    """Return on which intervals (n,) a limit is overrun between the nodes by more than should be tightened."""
    if at.findings is None:
        return np.zeros(at.n_intervals, dtype=bool)
    overrun = at.findings.overrun
    return overrun > max(TIGHTENED_OVERRUN, SHARE_OF_WORST * overrun.max(initial=0.0))


def most_overrun(at: Judged[Any, Any]) -> np.ndarray:
    """Return on which intervals (n,) a limit is overrun by a share of the most that it is overrun."""
    overrun = np.zeros(at.n_intervals) if at.findings is None else at.findings.overrun
    return overrun > LARGE_OVERRUN_SHARE * overrun.max(initial=0.0)


def grown(mesh: Mesh, marked: np.ndarray) -> int:
    """Return the number of intervals once those marked (n,) are halved."""
    return mesh.n_intervals + int(marked.sum())


def uneven_of(at: Judged[Any, Any]) -> np.ndarray:
    """Return the intervals (n,) that the objective hangs on: next to kinks, and where limits begin or cease to bind."""
    rough = rough_of(at.found.motion)
    touching = None if at.findings is None else at.findings.touching
    return rough if touching is None else rough | touching


def rough_of(motion: Motion) -> np.ndarray:
    """Return the intervals (n,) on which the efforts' polynomials bend most in their highest degree: next to kinks."""
    widths, degree = np.diff(motion.breaks_s), motion.effort.shape[0] - 1
    bend = np.abs(np.diff(motion.effort, n=degree, axis=0)[0]) if degree else np.abs(motion.effort[0])
    size = np.maximum(np.abs(motion.effort).max(axis=(0, 1)), np.finfo(float).tiny)
    rough = widths * (bend / size).max(axis=1)
    return rough >= ROUGH_SHARE * rough.max()


def higher_for(case: Case[Any, CertificateT], certificate: CertificateT | None, marked: np.ndarray) -> str | None:
    """Return the transcription of higher degree that is worth more than a finer mesh, or None."""
    if certificate is None or not marked.any():
        return None
    growth = certificate.growth[marked]
    even = marked.mean() >= EVEN_SHARE and growth.max() <= OUTLIER_FACTOR * max(float(np.median(growth)), 1e-300)
    return raised(case.problem.mesh) if even or case.problem.mesh.refine == "degree" else None


def higher_on_arcs(case: Case[MotionT, CertificateT], at: Judged[MotionT, CertificateT], over: np.ndarray) -> str | None:
    """Return the transcription of higher degree where motions along limits overrun them evenly: the arcs are smooth."""
    if at.findings is None or not over.any():
        return None
    fixed = at.found.fixed
    if case.aims.switches and (fixed is None or not np.all(fixed.paths[at.found.mesh.segment[over]].any(axis=1))):
        return None  # an arc that is not held may end inside an interval, which wants a switch time
    overrun = at.findings.overrun[over]
    even = len(overrun) >= INTERVALS_OF_ARC and overrun.max() <= OUTLIER_FACTOR * float(np.median(overrun))
    return raised(case.problem.mesh) if even or case.problem.mesh.refine == "degree" else None


def raised(mesh: MeshSettings) -> str | None:
    """Return the transcription two degrees up from that of a mesh; None where there is none, or none is wanted."""
    family = re.fullmatch(r"(radau|gauss)-(\d)", mesh.scheme)
    if family is None or mesh.refine == "intervals" or int(family[2]) == MAX_DEGREE:
        return None
    return f"{family[1]}-{min(int(family[2]) + 2, MAX_DEGREE)}"


def degree_of(scheme_name: str) -> int:
    """Return the degree in a transcription's name."""
    return int(scheme_name.rpartition("-")[2])


def widths_of(motion: Motion, marked: np.ndarray) -> np.ndarray:
    """Return the intervals' widths [s] once those marked (n,) are halved."""
    widths = np.diff(motion.breaks_s)
    pieces = np.where(marked, 2, 1)
    return np.repeat(widths / pieces, pieces)
