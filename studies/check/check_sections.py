"""The section of a check on a path: along a motion or over the reach of a coordinate."""

import numpy as np

from linkplan.studies.check.check_report import path_blocks
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath
from linkplan.studies.check.path_plots import MAX_COORDINATES_DRAWN, over, path_plots, rising_order
from linkplan.studies.output.animation import animation, frames_of
from linkplan.studies.output.document import Section


def path_section(path: KinematicLoopPath, name: str, of: int) -> Section:
    """Return the section of one `of` several paths: an animation, a table, plots of ratios, inertias, efforts and forces."""
    axis, x = over(path)
    group = f"path:{name}:{path.title}"
    order = rising_order(x)
    most = frames_of(path.mechanism, of)
    frames = order[np.unique(np.linspace(0, len(order) - 1, min(len(order), most)).astype(int))]
    moving = animation(
        path.mechanism,
        f"{name} along {path.title}",
        group,
        x[frames],
        path.poses[frames],
        effort=path.holding_effort[frames],
        effort_limit=path.limit,
        unit=axis.unit,
    )
    blocks = [moving, *path_blocks(path), *path_plots(path, group)]
    return Section(title=f"Along {path.title}, at rest", blocks=blocks, depth=2, folded=of > MAX_COORDINATES_DRAWN)
