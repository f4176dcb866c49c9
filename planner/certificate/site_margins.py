"""Sites along a motion: what is left of the limits on where they stay, and how far its ends are from where they are asked."""

from dataclasses import replace

import numpy as np

from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.certificate.margins import Margin, margin_of
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.problem.sites import SiteLimit
from linkplan.planner.trajectory import Trajectory

# The worst sample is looked at once more, with so many between its neighbours: where two segments of a tube's path are as
# near, its distance has a kink, and no parabola there.
_CLOSER = 65
# Sites end within this share of the mechanism's extent of where they are asked: as boundary states do of their span.
ENDS_SHARE = 1e-6
# Start and goal may be beyond a limit by this share of the extent: what inverse kinematics and rounding leave.
SITE_SLACK = 2e-9


def site_margins(
    problem: PlanningProblem, trajectory: Trajectory, points: np.ndarray, time: np.ndarray, q: np.ndarray
) -> tuple[Margin, ...]:
    """Return what is left of every limit on a site along a motion, sampled at `points` of each interval.

    Args:
        problem: with the limits.
        trajectory: the motion.
        points: shares (n_points,) of an interval.
        time: (n,) [s], those of all intervals.
        q: poses (n, n_q) at those times.
    """
    mechanism, found = problem.mechanism, []
    for item, limit in enumerate(problem.limits.site):
        values = limit.value(places_of(mechanism, limit.index, q))
        # A tube's distance has no lower limit; of a slab in space shares are those of the mechanism's size.
        bounds = (-np.inf, limit.high) if limit.is_tube else (limit.low, limit.high)
        size = limit.high if limit.is_tube else mechanism.extent_m
        what = "tube" if limit.is_tube else "site"
        margin = margin_of(what, item, title(limit), values, bounds, "m", points, time, size)
        inside = np.minimum(values - bounds[0], bounds[1] - values)
        found.append(_looked_at_closer(problem, trajectory, limit, margin, time, int(np.argmin(inside)), len(points), size))
    return tuple(found)


def title(limit: SiteLimit) -> str:
    """Return what of a site is limited, in words."""
    from_what = {"wall": "its wall", "tube": "its path"}.get(limit.what)
    return (
        f"{limit.what} of site {limit.site}" if from_what is None else f"the distance of site {limit.site} from {from_what}"
    )


def _looked_at_closer(
    problem: PlanningProblem, trajectory: Trajectory, limit: SiteLimit, margin: Margin, time, at: int, n_points: int, size
) -> Margin:
    """Return a margin whose worst instant, sample `at`, was sampled finely between its neighbours."""
    first, last = (at // n_points) * n_points, (at // n_points + 1) * n_points - 1
    near = np.linspace(time[max(at - 1, first)], time[min(at + 1, last)], _CLOSER)
    q = follow(problem.mechanism, trajectory.position_at(near), trajectory.start_pose)
    values = limit.value(places_of(problem.mechanism, limit.index, q))
    left = (limit.high - values) if margin.upper else (values - limit.low)
    k = int(np.argmin(left))
    if left[k] >= margin.left:
        return margin
    overrun = margin.overrun.copy()
    overrun[at // n_points] = max(float(overrun[at // n_points]), -float(left[k]) / size)
    return replace(margin, value=float(values[k]), left=float(left[k]), time_s=float(near[k]), overrun=overrun)


def ends_off_m(problem: PlanningProblem, q: np.ndarray) -> tuple[float, tuple[str, ...]]:
    """Return how far [m] sites are from where start and goal ask them, at the most, and the sentences on those too far off.

    Args:
        problem: with what is asked.
        q: closed poses (2, n_q) at the motion's start and end; of a periodic motion at its start and in its middle.
    """
    worst, failures = 0.0, []
    for name, points, pose in zip(("start", "goal"), (problem.motion.start_at, problem.motion.goal_at), q, strict=True):
        for point in points:
            off = point.off_m(places_of(problem.mechanism, point.index, pose)[0])
            worst = max(worst, off)
            if not off <= ENDS_SHARE * problem.mechanism.extent_m:
                failures.append(f"site {point.site} is {off:.3g} m away from where motion.{name}_at asks it")
    return worst, tuple(failures)
