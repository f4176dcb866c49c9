"""The command `decompose`."""

import argparse
from pathlib import Path

from linkplan.studies.cli.common import deliver, output_folder, plan_asked
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress


def run_decompose(arguments: argparse.Namespace) -> int:
    """Split trackers' errors among their causes; 1 if the plan has no motion or a tracker's error cannot be split."""
    from linkplan.studies.compare.user_tracker import trackers_named
    from linkplan.studies.decompose.decompose import decompose, decomposition_record
    from linkplan.studies.decompose.decomposition_blocks import decomposition_blocks, decomposition_figure

    asked = trackers_named(arguments.trackers)
    target, say = output_folder(arguments), progress(arguments)
    plan = plan_asked(arguments, say)
    found = decompose(plan, asked, arguments.samples, arguments.seed, say)
    said = decomposition_record(found)
    blocks = decomposition_blocks(found)

    def draw(place: Path) -> None:
        decomposition_figure(found, place / "decompose.png")

    deliver(arguments, target, said, blocks, lambda reports: reports.decomposition_report(found), draw)
    return DONE if plan.passed and found.found else NO
