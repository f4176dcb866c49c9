"""The bodies of a mechanism in the plane of a drawing, the paths of its sites along a plan, and forbidden regions."""

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.patches import Polygon

from linkplan.models.errors import listed
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.skeleton import body_name, sticks, view
from linkplan.models.poses.solids import body_frames, outline, solids, thickened
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.sites import SiteLimit
from linkplan.studies.output.bodies import named_pins
from linkplan.studies.output.body_colours import PAYLOAD, body_colours, hex_of
from linkplan.studies.output.figure import GREY, PIN_NAME, SERIES, outside_legend
from linkplan.studies.output.numbers import direction_name

# With more entries the legend would leave no space for the lines.
_MAX_LEGEND_ENTRIES = 12
# The names of more pins are in a column beside the drawing.
_MAX_NAMES_AT_PINS = 6


def draw_poses(axes, mechanism: Mechanism, poses: np.ndarray, last: str = "") -> None:
    """Draw the bodies at poses (n, n_q); the last one is opaque, with the names of its pins. The title says what it is."""
    axes.set_title(last and f"Poses; {last} is opaque")
    named = mechanism.model.nbody <= _MAX_LEGEND_ENTRIES
    draw_bodies(axes, mechanism, poses, np.append(np.full(len(poses) - 1, 0.3), 1.0), named=named)
    name_pins(axes, mechanism, poses[-1])
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(axis="x", nbins=6)
    right, up = (direction_name(direction) for direction in view(mechanism.model))
    axes.set_xlabel(f"{right} [m]")
    axes.set_ylabel(f"{up} [m]")


def draw_bodies(
    axes,
    mechanism: Mechanism,
    poses: np.ndarray,
    alphas: np.ndarray,
    *,
    named: bool,
    plane: tuple[np.ndarray, np.ndarray] | None = None,
    looks: Sequence[str] | None = None,
) -> None:
    """Draw a mechanism at poses (n, n_q) with their opacities (n,), from 0 to 1; the legend has the bodies if `named`.

    `plane` is the right and up of the drawing, by default those of the mechanism. `looks` has a colour for all bodies at
    each pose, "" for the bodies' own.
    """
    right, up = plane or view(mechanism.model)
    looks = looks or [""] * len(poses)
    drawn = {stick.body: stick for stick in sticks(mechanism, poses)}
    shapes = solids(mechanism)
    places, turns = body_frames(mechanism, poses)
    towards = np.cross(right, up)
    of_body = body_colours(mechanism)
    colours = {body_name(mechanism.model, body): hex_of(rgba) for body, rgba in of_body.items() if body}
    for depth, (name, stick) in enumerate(drawn.items()):
        own = [solid for solid in shapes if body_name(mechanism.model, solid.body) == name]
        colour = GREY if stick.fixed else colours.get(name, GREY)
        bare = not any(solid.kind == "geom" for solid in own)
        for k, alpha in enumerate(alphas):
            if stick.fixed and k < len(alphas) - 1:
                continue  # the ground is the same at every pose
            for solid in own:
                points = places[k, solid.body] + solid.points @ turns[k, solid.body].T
                near = float(np.mean(points @ towards)) / mechanism.extent_m
                edges = outline(thickened(points @ np.stack([right, up], axis=1), solid.radius))
                face = looks[k] or (hex_of(PAYLOAD) if solid.kind == "payload" else colour)
                size = float(np.prod(np.ptp(edges, axis=0))) / mechanism.extent_m**2
                layer = (2.5 if alpha == 1 else 2.0) + 0.2 * np.tanh(near) - 0.05 * np.tanh(size) - 0.001 * depth
                _fill(axes, edges, face, float(alpha), layer)
            if bare or stick.fixed:
                pins = stick.places[k] @ np.stack([right, up], axis=1)
                _draw_stick(axes, pins, looks[k] or colour, float(alpha), 3.0 - 0.01 * depth, fixed=stick.fixed)
        if named:
            axes.plot([], [], color=colour, marker="^" if stick.fixed else "s", linestyle="", label=name)
    axes.autoscale_view()
    if any(solid.kind == "payload" for solid in shapes) and named:
        axes.plot([], [], color=hex_of(PAYLOAD), marker="s", linestyle="", label="payload")


def name_pins(axes, mechanism: Mechanism, pose: np.ndarray) -> None:
    """Mark the joints and the pins that close loops at a pose (n_q,) by rings with their names."""
    found = pins_by_place(mechanism, pose)
    line = {"arrowstyle": "-", "color": GREY, "linewidth": 0.5, "relpos": (0, 0.5), "shrinkA": 1}
    beside = {"textcoords": "axes fraction", "va": "center", "arrowprops": line}
    for k, (at, names) in enumerate(sorted(found.items(), key=lambda one: one[0][::-1])):
        x, y = at
        axes.plot([x], [y], marker="o", color="black", markerfacecolor="white", markersize=3.2, linestyle="", zorder=4)
        words = listed([name for name in names if name], 2)
        if len(found) > _MAX_NAMES_AT_PINS:  # names at the pins would overlap
            axes.annotate(words, (x, y), xytext=(1.02, (k + 0.5) / len(found)), fontsize=7, zorder=5, **beside)
        else:
            look = {"textcoords": "offset points", "fontsize": 7.5, "zorder": 5, "gid": PIN_NAME}
            axes.annotate(words, (x, y), xytext=(5, 5 if k % 2 else -11), **look)


def pins_by_place(mechanism: Mechanism, pose: np.ndarray) -> dict[tuple[float, float], list[str]]:
    """Return the places (right, up) [m] of all joints and closing pins at a pose (n_q,), with the names of those at each."""
    right, up = view(mechanism.model)
    found: dict[tuple[float, float], list[str]] = {}
    for name, (place,) in named_pins(mechanism, pose[None]):
        x, y = np.round(np.array([place @ right, place @ up]) / mechanism.extent_m, 3) * mechanism.extent_m
        if name not in found.setdefault((float(x), float(y)), []):
            found[float(x), float(y)].append(name)
    return found


def _fill(axes, edges: np.ndarray, colour: str, alpha: float, layer: float) -> None:
    if len(edges) > 2:
        half = tuple(0.5 + 0.5 * part for part in to_rgb(colour))
        face, line = (half, 1.0) if alpha == 1 else (colour, 0.5 * alpha), (colour, alpha)
        axes.add_patch(Polygon(edges, closed=True, facecolor=face, edgecolor=line, linewidth=1.0, zorder=layer))
        axes.update_datalim(edges)


def _draw_stick(axes, pins: np.ndarray, colour: str, alpha: float, layer: float, *, fixed: bool) -> None:
    loop = np.vstack([pins, pins[:1]]) if len(pins) > 2 and not fixed else pins
    look = {"marker": "^", "linestyle": ""} if fixed else {"marker": "o", "linestyle": "-"}
    thick = {"markersize": 5, "linewidth": 2.6} if alpha == 1 else {"markersize": 3, "linewidth": 1.2}
    axes.plot(loop[:, 0], loop[:, 1], color=colour, alpha=alpha, zorder=layer, **look, **thick)


def draw_sites(axes, plan: Plan) -> None:
    """Draw the paths of the sites that a problem names, with the forbidden regions shaded.

    The mechanism is pale at start and end. A point is shaded if it is forbidden at all depths of the path.
    """
    mechanism, motion = plan.problem.mechanism, plan.trajectory
    q = follow(mechanism, motion.position_at(motion.dense_times()), motion.start_pose)
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
        points = [one for waypoint in plan.problem.motion.waypoints for one in waypoint.at if one.label == f"site {name}"]
        if points:  # free coordinates are those of the nearest point of the path
            nearest = [path[int(np.argmin([one.distance_m(p) for p in path]))] for one in points]
            via = np.array([np.where(np.isnan(p.point), x, p.point) for p, x in zip(points, nearest, strict=True)]) @ flat
            axes.plot(*via.T, color=colour, marker="D", markerfacecolor="white", linestyle="", label=f"waypoints of {name}")
        limits = [limit for limit in plan.problem.limits.site if limit.site == name]
        _shade(axes, limits, (low, high), (right, up), path @ across, colour, name)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(f"{direction_name(right)} [m]")
    axes.set_ylabel(f"{direction_name(up)} [m]")
    outside_legend(axes)


def _shade(axes, limits: list[SiteLimit], frame, plane, depths: np.ndarray, colour: str, name: str) -> None:
    """Shade the points that a site's limits forbid at all five depths, in a frame (low, high) of the plane (right, up)."""
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
