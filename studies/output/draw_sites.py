"""The paths of sites along a plan in the plane of the drawing, and the regions that their limits forbid."""

import numpy as np

from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.skeleton import sticks, view
from linkplan.planner.plan import Plan
from linkplan.planner.problem.motion import Motion
from linkplan.planner.problem.sites import SiteLimit
from linkplan.studies.output.directions import direction_name
from linkplan.studies.output.draw_bodies import draw_bodies
from linkplan.studies.output.drawing import SERIES, outside_legend


def draw_sites(axes, plan: Plan) -> None:
    """Draw the paths of the sites that a problem names, with the forbidden regions shaded.

    The mechanism is pale at start and end. A point is shaded if it is forbidden at every depth of the path.
    """
    mechanism, motion = plan.problem.mechanism, plan.trajectory
    q = follow(mechanism, motion.position_at(motion.dense_times(10)), motion.start_pose)
    right, up = view(mechanism.model)
    across = np.cross(right, up)
    flat = np.stack([right, up], axis=1)
    drawn = sticks(mechanism, q[[0, -1]])
    draw_bodies(axes, mechanism, q[[0, -1]], np.full(2, 0.35), named=False)
    paths = {name: places_of(mechanism, index, q) for name, index in plan.problem.sites.items()}
    seen = np.vstack([stick.pins.reshape(-1, 2) for stick in drawn] + [path @ flat for path in paths.values()])
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = 0.12 * max(float((high - low).max()), 1e-3)
    low, high = low - margin, high + margin
    for colour, (name, path) in zip(SERIES * (1 + len(paths) // len(SERIES)), paths.items(), strict=False):
        axes.plot(*(path @ flat).T, color=colour, label=f"path of {name}")
        axes.plot(*(path[:1] @ flat).T, color=colour, marker="o", linestyle="", label=f"{name} at the start")
        axes.plot(*(path[-1:] @ flat).T, color=colour, marker="s", linestyle="", label=f"{name} at the end")
        via = _passed(plan.problem.motion, name, path) @ flat
        if len(via):
            axes.plot(*via.T, color=colour, marker="D", markerfacecolor="white", linestyle="", label=f"waypoints of {name}")
        limits = [limit for limit in plan.problem.limits.site if limit.site == name]
        _shade(axes, limits, (low, high), (right, up), path @ across, colour, name)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(f"{direction_name(right)} [m]")
    axes.set_ylabel(f"{direction_name(up)} [m]")
    outside_legend(axes, narrow=True)


def _passed(motion: Motion, name: str, path: np.ndarray) -> np.ndarray:
    """Return a site's waypoints (n, 3) [m]; free coordinates are those of the nearest point of its path (m, 3)."""
    points = [point for waypoint in motion.waypoints for point in waypoint.at if point.site == name]
    nearest = [path[int(np.argmin([point.off_m(p) for p in path]))] for point in points]
    return np.array([np.where(np.isnan(p.point), x, p.point) for p, x in zip(points, nearest, strict=True)]).reshape(-1, 3)


def _shade(axes, limits: list[SiteLimit], frame, plane, depths: np.ndarray, colour: str, name: str) -> None:
    """Shade the region that a site's limits forbid at five depths, in a frame (low, high) of the plane (right, up)."""
    if not limits:
        return
    (low, high), (right, up) = frame, plane
    x, y = (np.linspace(a, b, 400) for a, b in zip(low, high, strict=True))
    X, Y = np.meshgrid(x, y)
    at = X.ravel()[:, None] * right + Y.ravel()[:, None] * up
    excess = np.full(X.size, np.inf)
    for depth in np.linspace(depths.min(), depths.max(), 5):
        p = at + depth * np.cross(right, up)
        beyond = np.max([np.maximum(limit.low - limit.value(p), limit.value(p) - limit.high) for limit in limits], axis=0)
        excess = np.minimum(excess, beyond)
    field = excess.reshape(X.shape)
    axes.contourf(X, Y, field, levels=[0.0, np.inf], colors=[colour], alpha=0.15)
    if field.min() < 0.0 < field.max():
        axes.contour(X, Y, field, levels=[0.0], colors=[colour], linewidths=1.0, linestyles=":")
    axes.fill_between([], [], color=colour, alpha=0.15, label=f"forbidden to {name}")
