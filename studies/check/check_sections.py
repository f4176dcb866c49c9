"""The sections of a check: its findings, and the mechanism along its motion or over the reach of its coordinates."""

import numpy as np

from linkplan.models.errors import counted
from linkplan.studies.check.check_report import path_blocks
from linkplan.studies.check.inspection_blocks import inspection_blocks
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath
from linkplan.studies.check.path_plots import MAX_COORDINATES_DRAWN, over, path_plots, rising_order
from linkplan.studies.check.refused_model import RefusedModel
from linkplan.studies.check.whole_check import WholeCheck
from linkplan.studies.output.animation import animation, frames_of
from linkplan.studies.output.document import Report, Section
from linkplan.studies.output.report_file import report_of


def check_sections(whole: WholeCheck) -> list[Section]:
    """Return the sections of a check."""
    first = Section(title=f"Mechanism: {whole.name}", blocks=inspection_blocks(whole))
    n = len(whole.sweeps)
    return [first, *(path_section(path, whole.name, n) for path in whole.paths)]


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


def check_report(found: WholeCheck | RefusedModel) -> Report:
    """Return the report of a check."""
    verdict = f"{counted(len(found.problems), 'problem')} found" if found.problems else "no problems found"
    if isinstance(found, RefusedModel):
        sections = [Section(title=f"Model: {found.name}", blocks=found.blocks())]
    else:
        sections = check_sections(found)
    return report_of(f"Check of {found.name}", verdict, not found.problems, sections)
