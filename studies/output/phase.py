"""The phase plane of a motion with one degree of freedom: its path, full effort at start and goal, and speed limits."""

import numpy as np

from linkplan.models.errors import LinkplanError
from linkplan.planner.limits.kinds import are_efforts_bounded
from linkplan.planner.limits.samples import Samples
from linkplan.planner.phase_plane.grid import PhasePlane as PhaseGrid
from linkplan.planner.phase_plane.grid import grid_of, plane_of
from linkplan.planner.plan.plan import Plan
from linkplan.studies.output.document import Axis, Plane, Series
from linkplan.studies.output.numbers import drawn_rows, rounded, rounded_times


def phase_plane(plan: Plan, motion: Samples, group: str, period: float | None) -> Plane | None:
    """Return the phase plane of a plan; None for several degrees of freedom."""
    mechanism = plan.problem.mechanism
    if mechanism.dof != 1:
        return None
    joint = mechanism.independent_joints[0]
    s, v = motion.q[:, mechanism.independent[0]], motion.v[:, 0]
    rows = drawn_rows(np.column_stack([s, v]))
    path = Series(name="planned", x=rounded(joint.shown(s[rows])), y=rounded(joint.shown(v[rows])), colour=None, width=2.2)
    most = 2.5 * float(np.abs(v).max()) or 1.0  # limit curves are unbounded next to singular poses
    limits = [] if not are_efforts_bounded(plan.problem) else _limit_curves(plan, motion, most)
    curves = [
        Series(name=name, x=rounded(joint.shown(x)), y=rounded(joint.shown(y)), look=look, colour=colour)
        for name, x, y, look, colour in limits
    ]
    return Plane(
        title=f"Phase plane of {joint.name}",
        x_axis=Axis(label=joint.name, unit=joint.unit),
        y_axis=Axis(label=f"speed of {joint.name}", unit=f"{joint.unit}/s"),
        curves=[*curves, path],
        group=group,
        track=len(curves),
        track_times=rounded_times(motion.time[rows]),
        period=period,
    )


def _limit_curves(plan: Plan, motion: Samples, most: float) -> list[tuple[str, np.ndarray, np.ndarray, str, int]]:
    """Return the limit curves (name, positions, signed speeds, look, colour); none if the grid cannot cover the motion."""
    problem = plan.problem
    s = motion.q[:, problem.mechanism.independent[0]]
    places = np.array([s[0], s.max(), s.min(), s[-1]])
    try:
        gridded = grid_of(problem, places, motion.q[0], 600)
    except LinkplanError:
        return []
    if gridded is None:
        return []
    grid = plane_of(problem, *gridded)
    found = []
    if problem.motion.kind == "reach" and abs(s[-1] - s[0]) > 1e-9:
        way = int(np.sign(s[-1] - s[0]))
        speeds = motion.v[[0, -1], 0]
        for name, start, v, step, effort, back, colour in (
            ("full effort from the start", s[0], speeds[0], way, way, False, 2),
            ("full braking into the goal", s[-1], speeds[1], -way, -way, True, 4),
        ):
            index = grid.at(start)
            leg = grid.leg(index, 0.5 * v**2, step, effort, backwards=back)
            at = grid.s[index + step * np.arange(len(leg))]
            found.append((name, at, _cut(way * np.sqrt(2 * leg), most), "dash", colour))
    return [*found, *_speed_limits(grid, s, most)]


def _speed_limits(grid: PhaseGrid, s: np.ndarray, most: float) -> list:
    """Return the curves of the largest speeds from which full effort can satisfy the joints' speed limits, if any."""
    near = (grid.s >= s.min()) & (grid.s <= s.max())
    found = []
    for way in (1, -1):
        top = way * np.sqrt(2 * np.array(grid.top[way]))
        top = np.where(np.abs(top) <= most, top, np.nan)
        if np.isfinite(top[near]).any():
            found.append(("speed limit" if way > 0 else "", grid.s[near], top[near], "dots", 1))
    return found


def _cut(speed: np.ndarray, most: float) -> np.ndarray:
    """Return speeds; NaN from the first speed above `most` on."""
    beyond = np.flatnonzero(np.abs(speed) > most)
    return np.where(np.arange(len(speed)) < (beyond[0] if len(beyond) else len(speed)), speed, np.nan)
