"""The number of parts into which each interval of a mesh is divided, from the errors in a motion's certificate."""

import numpy as np

from linkplan.planner.closed_chain.case import MechanismCase
from linkplan.planner.refinement.case import CertifiedIterate
from linkplan.planner.refinement.marking import degree_of

# A mesh is too coarse where the residual of the dynamics exceeds `_MOST_RESIDUAL` times the allowed one, or where a motion
# exceeds a limit between the nodes by `_MOST_OVERRUN` times that limit.
_MOST_RESIDUAL, _MOST_OVERRUN = 0.2, 3e-4
# The largest number of parts into which one interval is divided, for a solve and for a correction. Corrections in four parts
# take a fifth longer, because a second one follows more often.
_MAX_PIECES, _MAX_PIECES_OF_CORRECTIONS = 4, 6
# On an interval that is still inexact after a correction, the needed effort has a bend, for example where dry friction
# changes its sign. There the error is proportional only to this power of the interval's length, so the interval is divided
# into up to twice as many parts. Two robots with friction then need two or three corrections instead of three to five.
_ORDER_OF_BENDS = 2
# The largest error of the integrated state, as a share of the allowed, that needs no finer mesh.
_MOST_ERROR = 0.5


def for_a_solve(case: MechanismCase, at: CertifiedIterate) -> np.ndarray:
    """Return the number of parts (n,) of each interval for a solve, from its residual and overruns."""
    errors = at.report.residual_share / _MOST_RESIDUAL, at.report.overrun / _MOST_OVERRUN
    return _enough(case, np.maximum(*errors))


def for_a_correction(case: MechanismCase, at: CertifiedIterate, *, bent: bool) -> np.ndarray:
    """Return the number of parts (n,) of each interval with which certificate and proof would accept the motion.

    An error of the integrated state continues on all intervals after its cause. It is assigned to the intervals by the
    residuals of the dynamics there, times their widths. With the distance from the limits on efforts, errors of three
    allowances would pass. Only one is used, because the largest effort may lie between the samples.

    Args:
        case: what was solved.
        at: the motion with its certificate.
        bent: it was corrected before, so inexact intervals have bends.
    """
    report, order = at.report, _ORDER_OF_BENDS if bent else None
    error = float(report.growth.sum()) * (case.target.strictness if case.target.tolerance_given else 1.0)
    errors = report.effort_overrun
    if not error <= _MOST_ERROR:
        cause = report.residual_share * np.diff(at.found.motion.breaks_s)
        share = cause / max(cause.sum(), np.finfo(float).tiny)
        errors = np.maximum(error / _MOST_ERROR * share * len(share), errors)
    most = (2 if bent else 1) * _MAX_PIECES_OF_CORRECTIONS
    return np.maximum(for_a_solve(case, at), _enough(case, errors, most, order))


def _enough(case: MechanismCase, worst: np.ndarray, most: int = _MAX_PIECES, order: int | None = None) -> np.ndarray:
    """Return the number of parts (n,) of intervals with `worst` (n,) times the allowed error; at most `most`.

    The error is proportional to an interval's length to the power of `order`, by default the scheme's.
    """
    finite, scheme = np.nan_to_num(worst, nan=1e30, posinf=1e30), case.problem.mesh.scheme
    order = order or (degree_of(scheme) if scheme[-1].isdigit() else 2)
    return np.clip(np.ceil(finite ** (1.0 / order)), 1, most).astype(int)
