"""The command `decompose`."""

import argparse
from pathlib import Path

from linkplan.planner.files.folders import write_json, write_whole
from linkplan.studies.cli.common import no_plan, output_folder, plan_asked
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress, show


def run_decompose(arguments: argparse.Namespace) -> int:
    """Split trackers' errors among their causes; 1 if the plan has no motion or a tracker's error cannot be split."""
    from linkplan.studies.compare.user_tracker import trackers_named
    from linkplan.studies.decompose.decompose import decompose, decomposition_record
    from linkplan.studies.decompose.decomposition_blocks import decomposition_blocks, decomposition_figure

    asked = trackers_named(arguments.trackers)
    target, say = output_folder(arguments), progress(arguments)
    plan = plan_asked(arguments, say)
    if plan.trajectory is None:
        return no_plan(arguments, plan)
    found = decompose(plan, asked, arguments.samples, arguments.seed, say)
    said = decomposition_record(found)

    def save(place: Path) -> None:
        from linkplan.studies.report.reports import decomposition_report
        from linkplan.studies.report.saving import save_report

        write_json(place / "decompose.json", said)
        decomposition_figure(found, place / "decompose.png")
        save_report(decomposition_report(found), place, page=arguments.report)

    if target is not None:
        write_whole(target, save, "decompose.json")
    show(arguments, said, decomposition_blocks(found))
    return DONE if plan.passed and found.found else NO
