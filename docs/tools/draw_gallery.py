"""The gallery of docs/mechanisms.md: `python -m docs.tools.draw_gallery` plans each mechanism's motion."""

import sys
from pathlib import Path

import numpy as np

from linkplan.models.poses.assembly import follow
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.output.draw_bodies import draw_poses
from linkplan.studies.output.figure import outside_legend, page

# A built-in problem for every built-in mechanism that has one.
SHOWN = (
    "knee-reach",
    "knee-linear-reach",
    "slider-crank-turn",
    "five-bar-swing-up",
    "squeezer-turn",
    "gripper-close",
    "cart-pole-swing-up",
)
FOLDER = Path(__file__).resolve().parents[2] / "studies" / "gallery"


def gallery_figure(plan: Plan, path: Path) -> None:
    """Draw a plan's mechanism at nine instants spread evenly over its motion, the last one opaque."""
    trajectory, mechanism = plan.trajectory, plan.problem.mechanism
    # The loops are solved in small steps; every fortieth pose is drawn.
    time = np.linspace(0.0, trajectory.duration_s, 8 * 40 + 1)
    poses = follow(mechanism, trajectory.position_at(time), trajectory.start_pose)
    with page(path, size=(4.6, 4.2)) as axes:
        draw_poses(axes[0, 0], mechanism, poses[::40])
        outside_legend(axes[0, 0], fontsize=8)


def main() -> int:
    """Write every picture of the gallery."""
    for name in SHOWN:
        plan = plan_motion(load_problem(name)).require()
        path = FOLDER / f"{plan.problem.mechanism.name}.png"
        gallery_figure(plan, path)
        print(f"  {name}: {plan.message}; {path}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
