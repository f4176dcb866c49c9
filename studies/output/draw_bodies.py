"""The bodies of a mechanism in the plane of a drawing: outlines of their shapes, and sticks for bodies without geoms."""

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.patches import Polygon

from linkplan.models.errors import listed
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.hulls import outline, thickened
from linkplan.models.poses.skeleton import Stick, body_name, sticks, view
from linkplan.models.poses.solids import body_frames, cut_pins, solids
from linkplan.models.tree.coordinates import joint_label
from linkplan.studies.output.directions import direction_name
from linkplan.studies.output.drawing import GREY, SERIES

_PAYLOAD_COLOUR = "#8D8273"
# A larger legend would leave no space for the lines.
_MAX_LEGEND_ENTRIES = 12
# The names of more pins stand in a column beside the drawing.
_MAX_NAMES_AT_PINS = 6


def draw_poses(axes, mechanism: Mechanism, poses: np.ndarray) -> None:
    """Draw the bodies at poses (n, n_q); the last one is opaque, with the names of its pins."""
    named = mechanism.model.nbody <= _MAX_LEGEND_ENTRIES
    draw_bodies(axes, mechanism, poses, np.append(np.full(len(poses) - 1, 0.3), 1.0), named=named)
    name_pins(axes, mechanism, poses[-1])
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(axis="x", nbins=6)
    right, up = (direction_name(direction) for direction in view(mechanism.model))
    axes.set_xlabel(f"{right} [m]")
    axes.set_ylabel(f"{up} [m]")


def draw_bodies(axes, mechanism: Mechanism, poses: np.ndarray, alphas: np.ndarray, *, named: bool) -> None:
    """Draw a mechanism at poses (n, n_q) with their opacities (n,), from 0 to 1; the legend has the bodies if `named`."""
    right, up = view(mechanism.model)
    drawn = {stick.body: stick for stick in sticks(mechanism, poses)}
    shapes = solids(mechanism)
    places, turns = body_frames(mechanism, poses)
    towards = np.cross(right, up)
    moving = [name for name, stick in drawn.items() if not stick.fixed]
    colours = dict(zip(moving, SERIES * (1 + len(moving) // len(SERIES)), strict=False))
    for depth, (name, stick) in enumerate(drawn.items()):
        own = [solid for solid in shapes if body_name(mechanism.model, solid.body) == name]
        colour = colours.get(name, GREY)
        bare = not any(solid.kind == "geom" for solid in own)
        for k, alpha in enumerate(alphas):
            if stick.fixed and k < len(alphas) - 1:
                continue  # the ground is the same at every pose
            for solid in own:
                points = places[k, solid.body] + solid.points @ turns[k, solid.body].T
                near = float(np.mean(points @ towards)) / mechanism.extent_m
                edges = outline(thickened(points @ np.stack([right, up], axis=1), solid.radius))
                face = _PAYLOAD_COLOUR if solid.kind == "payload" else colour
                size = float(np.prod(np.ptp(edges, axis=0))) / mechanism.extent_m**2
                layer = (2.5 if alpha == 1 else 2.0) + 0.2 * np.tanh(near) - 0.05 * np.tanh(size) - 0.001 * depth
                _fill(axes, edges, face, float(alpha), layer)
            if bare or stick.fixed:
                _draw_stick(axes, stick, k, colour, float(alpha), 3.0 - 0.01 * depth)
        if named:
            axes.plot([], [], color=colour, marker="^" if stick.fixed else "s", linestyle="", label=name)
    axes.autoscale_view()
    if any(solid.kind == "payload" for solid in shapes) and named:
        axes.plot([], [], color=_PAYLOAD_COLOUR, marker="s", linestyle="", label="payload")


def name_pins(axes, mechanism: Mechanism, pose: np.ndarray) -> None:
    """Mark the joints and the pins that close loops at a pose (n_q,) by rings with their names."""
    right, up = view(mechanism.model)
    places, turns = body_frames(mechanism, pose[None])
    joints = range(mechanism.model.njnt)
    named = [(joint_label(mechanism.model, k), int(mechanism.model.jnt_bodyid[k])) for k in joints]
    found: dict[tuple, list[str]] = {}
    at_joints = [places[0, body] + turns[0, body] @ mechanism.model.jnt_pos[k] for k, (_, body) in enumerate(named)]
    pins = [(name, place) for (name, _), place in zip(named, at_joints, strict=True)]
    pins += [(pin.name, places[0, pin.body] + turns[0, pin.body] @ pin.point) for pin in cut_pins(mechanism)]
    for name, place in pins:
        at = tuple(np.round(np.array([place @ right, place @ up]) / mechanism.extent_m, 3))
        if name not in found.setdefault(at, []):
            found[at].append(name)
    line = {"arrowstyle": "-", "color": GREY, "linewidth": 0.5, "relpos": (0, 0.5), "shrinkA": 1}
    beside = {"textcoords": "axes fraction", "va": "center", "arrowprops": line}
    for k, (at, names) in enumerate(sorted(found.items(), key=lambda one: one[0][::-1])):
        x, y = np.array(at) * mechanism.extent_m
        axes.plot([x], [y], marker="o", color="black", markerfacecolor="white", markersize=3.2, linestyle="", zorder=4)
        words = listed([name for name in names if name], 2)
        if len(found) > _MAX_NAMES_AT_PINS:  # names at the pins would cover one another
            axes.annotate(words, (x, y), xytext=(1.02, (k + 0.5) / len(found)), fontsize=7, zorder=5, **beside)
        else:
            axes.annotate(words, (x, y), xytext=(5, 5 if k % 2 else -11), textcoords="offset points", fontsize=7.5, zorder=5)


def _fill(axes, edges: np.ndarray, colour: str, alpha: float, layer: float) -> None:
    if len(edges) > 2:
        half = tuple(0.5 + 0.5 * part for part in to_rgb(colour))
        face, line = (half, 1.0) if alpha == 1 else (colour, 0.5 * alpha), (colour, alpha)
        axes.add_patch(Polygon(edges, closed=True, facecolor=face, edgecolor=line, linewidth=1.0, zorder=layer))
        axes.update_datalim(edges)


def _draw_stick(axes, stick: Stick, k: int, colour: str, alpha: float, layer: float) -> None:
    pins = stick.pins[k]
    loop = np.vstack([pins, pins[:1]]) if len(pins) > 2 and not stick.fixed else pins
    look = {"marker": "^", "linestyle": ""} if stick.fixed else {"marker": "o", "linestyle": "-"}
    thick = {"markersize": 5, "linewidth": 2.6} if alpha == 1 else {"markersize": 3, "linewidth": 1.2}
    axes.plot(loop[:, 0], loop[:, 1], color=colour, alpha=alpha, zorder=layer, **look, **thick)
