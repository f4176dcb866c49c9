"""A plan's folder with its figure."""

from pathlib import Path

from linkplan.planner.plan import Plan
from linkplan.planner.plan_folder import write_plan


def save_plan(plan: Plan, place: Path, target: Path | None = None, *, jumps: bool = False, parquet: bool = False) -> None:
    """Write a plan and its figure into an empty folder, which the caller moves to `target` if it is given."""
    from linkplan.studies.output.draw_plan import plan_figure

    write_plan(plan, place, target, jumps=jumps, parquet=parquet)
    plan_figure(plan, place / "plan.png")
