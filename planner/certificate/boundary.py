"""Errors of a motion's boundary states, and of sites at its start, waypoints and goal."""

import numpy as np

from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory

# Boundary states, and sites at them, are constraints of the program and kept to rounding: the allowed error as a share of
# the motion's span or largest speed, or of the mechanism's extent.
BOUNDARY_SHARE = 1e-6


Bounds = tuple[np.ndarray, np.ndarray] | np.ndarray
# Start and goal may exceed a limit by this share of its size, because inverse kinematics and rounding are inexact.
POSE_SLACK = 2e-9


def relative_violation(values: np.ndarray, bounds: Bounds, size: np.ndarray | float) -> float:
    """Return the largest amount, in units of `size`, by which values (..., n) lie outside the bounds, low and high (2, n).

    It is 0 if all are inside.
    """
    low, high = bounds
    return float((np.maximum(low - values, values - high) / size).max(initial=0.0))


def exact_bounds(asked: np.ndarray, free: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds, low and high, of prescribed values; infinite where these are NaN or `free`."""
    open_values = np.isnan(asked) if free is None else free
    return np.where(open_values, -np.inf, asked), np.where(open_values, np.inf, asked)


def ends_off_m(problem: Problem, trajectory: Trajectory, time: np.ndarray, q: np.ndarray) -> tuple[float, tuple[str, ...]]:
    """Return the largest error [m] of the sites prescribed at start, waypoints and goal, and sentences on errors.

    Args:
        problem: the problem; the goal of a periodic motion lies in its middle.
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
            if not off <= BOUNDARY_SHARE * problem.mechanism.extent_m:
                failures.append(f"site {point.site} is {off:.3g} m away from where motion.{name}_at asks it")
    for k, waypoint in enumerate(motion.waypoints):
        if waypoint.at:
            apart = waypoint_off_m(problem, trajectory, waypoint, waypoint_times(trajectory, waypoint))
            off, point = float(apart.max(axis=1).min()), waypoint.at[int(apart[apart.max(axis=1).argmin()].argmax())]
            worst = max(worst, off)
            if not off <= BOUNDARY_SHARE * problem.mechanism.extent_m:
                failures.append(f"site {point.site} is {off:.3g} m away from where motion.waypoints[{k}].at asks it")
    return worst, tuple(failures)


def waypoint_times(trajectory: Trajectory, waypoint: Waypoint) -> np.ndarray:
    """Return the times (n,) [s] at which a motion may pass a waypoint: its own time, or all breaks if that is free."""
    return trajectory.breaks_s if waypoint.time_s is None else trajectory.breaks_s[:1] + waypoint.time_s


def waypoint_off_m(problem: Problem, trajectory: Trajectory, waypoint: Waypoint, time: np.ndarray) -> np.ndarray:
    """Return the distances [m] (n, n_sites) of a waypoint's sites from their prescribed places at times (n,) [s]."""
    if not waypoint.at:
        return np.zeros((len(time), 1))
    # Loops are followed from break to break, so the result does not depend on the given times.
    along, back = np.unique(np.concatenate([trajectory.breaks_s, time]), return_inverse=True)
    until = problem.solver.judging_deadline
    poses = follow(problem.mechanism, trajectory.position_at(along), trajectory.start_pose, until)
    q = poses[back[len(trajectory.breaks_s) :]]
    places = [places_of(problem.mechanism, point.index, q) for point in waypoint.at]
    return np.array([[p.off_m(x) for x in at] for p, at in zip(waypoint.at, places, strict=True)]).T
