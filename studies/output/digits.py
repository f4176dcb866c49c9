"""How many digits of a figure are known, and figures in no more than those."""

import numpy as np

from linkplan.planner.plan import Plan

# Solvers stop at a relative 1e-8; a plan that passes its certificate is known to a part in a thousand at the least.
_MOST, _FEWEST = 8, 3
# Errors are known by their size: two digits of them.
_OF_AN_ERROR = 2
# A pole nearer to the unit circle than this is said by its distance from it.
_NEAR_THE_CIRCLE = 5e-4
# A length or an effort below this [m, N.m or N] is what rounding leaves of zero.
_ROUNDING = 1e-14


def known_digits(plan: Plan) -> int:
    """Return to how many digits a plan's duration and objective are known: those of its integration error in its motion.

    The integrated state differs from the planned one by a share of what the joints travel; figures of the motion are known
    to about that share.
    """
    trajectory, certificate = plan.trajectory, plan.certificate
    if trajectory is None or certificate is None:
        return _FEWEST
    travelled = np.ptp(trajectory.position_at(trajectory.dense_times(4)), axis=0)
    shares, error_rad = [], np.radians(certificate.integration_error_deg)
    for kind, error in (("hinge", error_rad), ("slide", certificate.integration_error_m)):
        of_kind = [x for x, j in zip(travelled, plan.problem.mechanism.independent_joints, strict=True) if j.kind == kind]
        if of_kind and max(of_kind) > 0 and np.isfinite(error):
            shares.append(error / max(of_kind))
    share = max(shares, default=1.0)
    return int(np.clip(np.floor(-np.log10(max(share, 10.0**-_MOST))), _FEWEST, _MOST))


def figure(value: float, digits: int) -> str:
    """Return a number in so many digits."""
    return f"{value:.{digits}g}"


def error_figure(value: float) -> str:
    """Return an error in the digits that errors are known to; what rounding leaves of zero as that."""
    return f"< {_ROUNDING:.0e}" if 0 < value < _ROUNDING else figure(value, _OF_AN_ERROR)


def radius_figure(radius: float) -> str:
    """Return the size of a sampled loop's pole: near the unit circle, where it decides, by its distance, as "1-2.3e-05"."""
    beyond = radius - 1.0
    return f"1{beyond:+.1e}" if 0 < abs(beyond) < _NEAR_THE_CIRCLE else figure(radius, 4)
