"""The labelled sketch of the knee in the README: `python -m docs.tools.draw_knee` writes it."""

import sys
from pathlib import Path

import numpy as np

from docs.tools.draw_gallery import FOLDER
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.skeleton import sticks
from linkplan.studies.output.draw_bodies import draw_bodies, pins_by_place
from linkplan.studies.output.figure import BLACK, GREY, RED, page

PICTURE = FOLDER / "knee-sketch.png"


def knee_figure(path: Path, turned_deg: float = 30.0) -> dict[str, float]:
    """Draw the knee with the names of its joints and links; return the distance [m] between the pins of each link.

    Args:
        path: of the image file.
        turned_deg: position of the driven joint.
    """
    mechanism = load_mechanism("optimus-knee")
    driven = mechanism.independent_joints[0].name
    closed = mechanism.equations.closed_pose
    poses = np.stack([closed(at_deg={driven: 0.0}), closed(at_deg={driven: turned_deg})])
    links = {stick.body: stick for stick in sticks(mechanism, poses)}
    lengths = {name: float(np.linalg.norm(stick.pins[1, 1] - stick.pins[1, 0])) for name, stick in links.items()}
    pins = {", ".join(names): np.array(at) for at, names in pins_by_place(mechanism, poses[1]).items()}
    centre = np.mean(list(pins.values()), axis=0)
    with page(path, size=(7.6, 3.3)) as axes:
        axis = axes[0, 0]
        draw_bodies(axis, mechanism, poses[1:], np.ones(1), named=False)
        for name, stick in links.items():
            shown = "fixed thigh, O to C" if stick.fixed else name
            _label(axis, f"{shown}: {1e3 * lengths[name]:.4g} mm", stick.pins[1].mean(axis=0), centre, size=10, gap=58)
        for name, at in pins.items():
            colour = RED if name == driven else BLACK
            axis.plot(*at, "o", color=colour, markerfacecolor="white", markersize=9, markeredgewidth=2, zorder=6)
            _label(axis, name, at, centre, size=15, gap=26, color=colour, fontweight="bold")
        _draw_angle(axis, links["crank"].pins, f"angle {driven},\ndriven by the motor")
        axis.set_aspect("equal")
        axis.margins(x=0.03, y=0.16)
        axis.axis("off")
    return lengths


def _label(axis, text: str, at: np.ndarray, centre: np.ndarray, *, size: float, gap: float, **look) -> None:
    """Write a text `gap` points from a place (2,) [m], away from the centre (2,) [m] of the loop."""
    away = (at - centre) / np.linalg.norm(at - centre)
    side = "center" if abs(away[0]) < 0.7 else ("left" if away[0] > 0 else "right")
    line = {"arrowstyle": "-", "color": GREY, "linewidth": 0.8} if gap > 30 else None
    place = {"textcoords": "offset points", "ha": side, "va": "center", "fontsize": size, "zorder": 7}
    axis.annotate(text, at, xytext=gap * away, arrowprops=line, **place, **look)


def _draw_angle(axis, crank: np.ndarray, text: str) -> None:
    """Draw the angle of the crank's pins (2, 2, 2) [m] from its zero pose to its pose, as an arc with an arrow."""
    pivot = crank[1, 0]
    along = 1.5 * (crank[:, 1] - crank[:, 0])
    axis.plot(*np.stack([pivot, pivot + along[0]]).T, color=GREY, linestyle="dashed", linewidth=1.2, zorder=5)
    start, end = np.arctan2(along[:, 1], along[:, 0])
    angles = np.linspace(start, end, 40)
    arc = pivot + np.linalg.norm(along[0]) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    axis.plot(*arc[:-2].T, color=RED, linewidth=2, zorder=6)
    axis.annotate("", arc[-1], arc[-4], zorder=6, arrowprops={"arrowstyle": "-|>", "color": RED, "linewidth": 2})
    place = {"textcoords": "offset points", "ha": "right", "va": "center", "fontsize": 10, "color": RED, "zorder": 7}
    axis.annotate(text, arc[0], xytext=(-8, 0), **place)


if __name__ == "__main__":
    found = knee_figure(PICTURE)
    print(f"{PICTURE}: " + ", ".join(f"{name} {1e3 * length:.4g} mm" for name, length in found.items()), file=sys.stderr)
