"""The sections of a comparison: animation of the tracked motions, table of trackers, errors and efforts over time."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.studies.compare.compare import Comparison, tracking_reference
from linkplan.studies.compare.comparison_blocks import (
    comparison_blocks,
    effort_plots,
    gap_plots,
    joint_plots,
    largest,
    site_plots,
)
from linkplan.studies.output.animation import Run, animation, frames_of
from linkplan.studies.output.document import Block, Section, Text
from linkplan.studies.output.plan_sections import group_of, plan_sections

# With more joints or actuators, those with the largest errors and efforts are shown and the others are collapsed.
_MAX_JOINTS_SHOWN = 6


def comparison_sections(comparison: Comparison) -> list[Section]:
    """Return the sections of trackers' runs on a plan, without those of the plan."""
    mechanism, blocks = comparison.plan.problem.mechanism, [_animation(comparison), *comparison_blocks(comparison)]
    found = [Section(title=f"Tracking: {comparison.plan.problem.name}", blocks=blocks)]
    for title, runs in comparison.cases:  # over time, the joints and actuators with the largest errors and efforts first
        chosen, pushed = largest(runs.values(), _MAX_JOINTS_SHOWN)
        others = [k for k in range(mechanism.dof) if k not in chosen], [j for j in range(mechanism.n_u) if j not in pushed]
        blocks = [*joint_plots(comparison, runs, chosen), *site_plots(comparison, runs)]
        blocks += [*effort_plots(comparison, runs, pushed), *gap_plots(comparison, runs)]
        found.append(Section(title=f"Over time: {title}", blocks=[*_left_out(mechanism, *others), *blocks], depth=2))
        if any(others):
            blocks = [*joint_plots(comparison, runs, others[0]), *effort_plots(comparison, runs, others[1])]
            found.append(Section(title=f"Other joints: {title}", blocks=blocks, depth=2, folded=True))
    return found


def whole_comparison(comparison: Comparison) -> list[Section]:
    """Return the sections of a comparison and those of its plan."""
    return [*comparison_sections(comparison), *plan_sections(comparison.plan, animated=False)]


def _animation(comparison: Comparison) -> Block:
    """Return the animation of the planned motion over the tracked time, with every run as a ghost."""
    plan = comparison.plan
    mechanism, reference = plan.problem.mechanism, tracking_reference(plan)
    cases = comparison.cases
    n_runs = sum(len(runs) for _, runs in cases)
    frames = np.unique(np.linspace(0, reference.n - 1, frames_of(mechanism, 1 + n_runs)).astype(int))
    ghosts = {}
    for k, (_, runs) in enumerate(cases):
        for name, run in runs.items():
            seen = np.flatnonzero(np.isfinite(run.pose_rad).all(axis=1))
            last = int(seen[-1]) if len(seen) else 0  # a diverged run keeps its last finite pose, with zero effort
            at, ran = np.minimum(frames, last), (frames <= last)[:, None]
            drawn = Run(poses=np.nan_to_num(run.pose_rad[at]), effort=np.where(ran, run.applied[at], 0.0))
            ghosts[name if k == 0 else f"{name}, with the mismatch"] = drawn
    return animation(
        mechanism,
        f"{mechanism.name} along {plan.problem.name}, planned and as tracked",
        group_of(plan),
        reference.time_s[frames],
        reference.pose_rad[frames],
        effort=reference.effort[frames],
        effort_limit=effort_bounds(plan.problem),
        ghosts=ghosts,
        sites=plan.problem.sites,
    )


def _left_out(mechanism: Mechanism, joints: list[int], actuators: list[int]) -> list[Text]:
    if not joints and not actuators:
        return []
    said = (
        f"The plots show the {mechanism.dof - len(joints)} of {mechanism.dof} joints with the largest errors and the"
        f" {mechanism.n_u - len(actuators)} of {mechanism.n_u} actuators with the largest efforts; the section below shows"
        " the others."
    )
    return [Text(text=said, tone="note")]
