"""The drawing of the cut loop in docs/mathematics.md: `python -m docs.tools.draw_cut_loop` writes it."""

import sys
from pathlib import Path

import numpy as np

from docs.tools.draw_gallery import FOLDER
from linkplan.models.kinematics import tied_points
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.skeleton import view
from linkplan.models.poses.solids import body_frames
from linkplan.studies.output.draw_bodies import draw_bodies
from linkplan.studies.output.figure import page

PICTURE = FOLDER / "cut-loop.png"
_INDEPENDENT, _DEPENDENT, _GAP = "#0b7a3b", "#b8860b", "#c0392b"


def cut_loop_figure(path: Path, turned_deg: float = -14.0) -> float:
    """Draw the closed knee, and the cut knee with only the independent joint turned; return the gap at its pin [m]."""
    mechanism = load_mechanism("optimus-knee")
    opened = mechanism.home.copy()
    opened[mechanism.independent] += np.radians(turned_deg)
    with page(path, columns=2, size=(8.6, 2.9)) as axes:
        for axis, pose in zip(axes[0], (mechanism.home, opened), strict=True):
            draw_bodies(axis, mechanism, pose[None], np.ones(1), named=False)
            _mark_joints(axis, mechanism, pose)
            axis.set_aspect("equal")
            axis.margins(0.12)
            axis.axis("off")
        gap = _mark_closure(axes[0, 1], mechanism, opened)
        _mark_closure(axes[0, 0], mechanism, mechanism.home)
        axes[0, 0].set_title("closed: φ(s, z) = 0 gives z for every s", fontsize=10)
        axes[0, 1].set_title("cut: only s turned, and a gap φ is left", fontsize=10)
        axes[0, 0].get_figure().legend(
            *axes[0, 1].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9
        )
    return gap


def _mark_joints(axis, mechanism: Mechanism, pose: np.ndarray) -> None:
    """Mark the joints with their names, the independent ones filled; MuJoCo's joints equal the planner's here."""
    right, up = view(mechanism.model)
    places, turns = body_frames(mechanism, pose[None])
    for k, joint in enumerate(mechanism.joints):
        body = int(mechanism.model.jnt_bodyid[k])
        at = places[0, body] + turns[0, body] @ mechanism.model.jnt_pos[k]
        free = k in mechanism.independent
        colour, face = (_INDEPENDENT, _INDEPENDENT) if free else (_DEPENDENT, "white")
        label = "independent joint, in s" if free else "dependent joint, in z"
        known = label in axis.get_legend_handles_labels()[1]
        x, y = at @ right, at @ up
        axis.plot(x, y, "o", color=colour, markerfacecolor=face, markersize=9, zorder=6, label="_" if known else label)
        axis.annotate(joint.name, (x, y), xytext=(9, 7), textcoords="offset points", zorder=7)


def _mark_closure(axis, mechanism: Mechanism, pose: np.ndarray) -> float:
    """Draw both ends of the first closure and the gap between them; return the gap [m]."""
    right, up = view(mechanism.model)
    places, turns = body_frames(mechanism, pose[None])
    ends = np.array([places[0, body] + turns[0, body] @ point for body, point in tied_points(mechanism.model, 0)])
    axis.plot(
        ends @ right,
        ends @ up,
        linestyle="dashed",
        marker="x",
        color=_GAP,
        linewidth=2,
        zorder=6,
        label=f"closure {mechanism.closure_names[0]}",
    )
    return float(np.linalg.norm(ends[1] - ends[0]))


if __name__ == "__main__":
    print(f"{PICTURE}: a gap of {1e3 * cut_loop_figure(PICTURE):.1f} mm", file=sys.stderr)
