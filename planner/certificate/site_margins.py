"""Sites along a motion: what is left of the limits on where they stay, and how far its ends are from where they belong."""

from dataclasses import replace

import numpy as np

from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.certificate.margins import Margin, least_between, margin_of
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.problem.sites import SiteLimit
from linkplan.planner.trajectory import Trajectory

# Samples next to a limit, within this share of its size, are looked at once more with so many between their neighbours:
# where two segments of a tube's path are as near, its distance has a kink, and no parabola there.
_NEXT_TO_IT, _CLOSER = 1e-3, 33
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
        found.append(_looked_at_closer(problem, trajectory, limit, margin, values, time, len(points)))
    return tuple(found)


def title(limit: SiteLimit) -> str:
    """Return what of a site is limited, in words."""
    from_what = {"wall": "its wall", "tube": "its path"}.get(limit.what)
    return (
        f"{limit.what} of site {limit.site}" if from_what is None else f"the distance of site {limit.site} from {from_what}"
    )


def _looked_at_closer(
    problem: PlanningProblem, trajectory: Trajectory, limit: SiteLimit, margin: Margin, values, time, n_points: int
) -> Margin:
    """Return a margin, its worst instant and that of every interval next to the limit sampled finely between neighbours.

    `values` (n,) at `time` (n,) are those that it was made of, `n_points` an interval.
    """
    mechanism, low = problem.mechanism, -np.inf if limit.is_tube else limit.low
    inside = np.minimum(values - low, limit.high - values).reshape(-1, n_points)
    size = limit.high if limit.is_tube else mechanism.extent_m
    worst = inside.argmin(axis=1)
    chosen = np.flatnonzero(inside.min(axis=1) < max(_NEXT_TO_IT * size, float(inside.min()) + _NEXT_TO_IT * size))
    rows, times = np.arange(len(inside))[chosen], time.reshape(-1, n_points)
    first, last = times[rows, np.maximum(worst[rows] - 1, 0)], times[rows, np.minimum(worst[rows] + 1, n_points - 1)]
    shares = np.linspace(0.0, 1.0, _CLOSER)
    near = first[:, None] + (last - first)[:, None] * shares
    q = follow(mechanism, trajectory.position_at(near.ravel()), trajectory.start_pose, problem.solver.judging_deadline)
    fine = limit.value(places_of(mechanism, limit.index, q)).reshape(near.shape)
    left = np.minimum(fine - low, limit.high - fine)
    # Of the samples the finest count, and parabolas through those: coarse ones may bulge beyond the curve.
    least = np.minimum(least_between(left, shares), inside[rows].min(axis=1))
    overrun = np.zeros(len(inside))
    overrun[rows] = np.maximum(0.0, -least) / size
    row, k = np.unravel_index(int(np.argmin(left)), left.shape)
    upper = bool(limit.high - fine[row, k] <= fine[row, k] - low)
    bound, gap = (limit.high if upper else limit.low), float(least.min())
    value = bound - gap if upper else bound + gap
    instant = float(near[row, k])
    return replace(margin, value=value, limit=float(bound), left=gap, time_s=instant, overrun=overrun, upper=upper)


def ends_off_m(
    problem: PlanningProblem, trajectory: Trajectory, time: np.ndarray, q: np.ndarray
) -> tuple[float, tuple[str, ...]]:
    """Return how far [m] sites are from where start, waypoints and goal ask them, at the most, and sentences on that.

    Args:
        problem: with what is asked; of a periodic motion the goal is in its middle.
        trajectory: the motion.
        time: (n,) [s] along it, from its start to its end.
        q: poses (n, n_q) at those times.
    """
    worst, failures, motion = 0.0, [], problem.motion
    goal_s = trajectory.breaks_s[0] + (0.5 if motion.kind == "periodic" else 1.0) * trajectory.duration_s
    for name, points, at in (("start", motion.start_at, trajectory.breaks_s[0]), ("goal", motion.goal_at, goal_s)):
        if not points:
            continue
        near = q[int(np.argmin(np.abs(time - at)))]
        pose = follow(problem.mechanism, trajectory.position_at(np.array([at])), near, problem.solver.judging_deadline)[0]
        for point in points:
            off = point.off_m(places_of(problem.mechanism, point.index, pose)[0])
            worst = max(worst, off)
            if not off <= ENDS_SHARE * problem.mechanism.extent_m:
                failures.append(f"site {point.site} is {off:.3g} m away from where motion.{name}_at asks it")
    for k, waypoint in enumerate(motion.waypoints):
        if waypoint.at:
            apart = waypoint_off_m(problem, trajectory, waypoint, waypoint_times(trajectory, waypoint))
            off, point = float(apart.max(axis=1).min()), waypoint.at[int(apart[apart.max(axis=1).argmin()].argmax())]
            worst = max(worst, off)
            if not off <= ENDS_SHARE * problem.mechanism.extent_m:
                failures.append(f"site {point.site} is {off:.3g} m away from where motion.waypoints[{k}].at asks it")
    return worst, tuple(failures)


def waypoint_times(trajectory: Trajectory, waypoint: Waypoint) -> np.ndarray:
    """Return the instants (n,) [s] at which a motion may pass a waypoint: its own, or all breaks where that is free."""
    return trajectory.breaks_s if waypoint.time_s is None else trajectory.breaks_s[:1] + waypoint.time_s


def waypoint_off_m(problem: PlanningProblem, trajectory: Trajectory, waypoint: Waypoint, time: np.ndarray) -> np.ndarray:
    """Return how far [m] a waypoint's sites are from their places (n, n_sites) at times (n,) [s]."""
    if not waypoint.at:
        return np.zeros((len(time), 1))
    # Loops are followed from break to break, whatever instant is asked for.
    along, back = np.unique(np.concatenate([trajectory.breaks_s, time]), return_inverse=True)
    until = problem.solver.judging_deadline
    poses = follow(problem.mechanism, trajectory.position_at(along), trajectory.start_pose, until)
    q = poses[back[len(trajectory.breaks_s) :]]
    places = [places_of(problem.mechanism, point.index, q) for point in waypoint.at]
    return np.array([[p.off_m(x) for x in at] for p, at in zip(waypoint.at, places, strict=True)]).T
