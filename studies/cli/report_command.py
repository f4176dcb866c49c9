"""The command `report`."""

import argparse
from pathlib import Path

from linkplan.studies.cli.common import naming, sample_again
from linkplan.studies.cli.exit_codes import DONE
from linkplan.studies.cli.printing import progress, show


def run_report(arguments: argparse.Namespace) -> int:
    """Write the report of a saved folder as one HTML file."""
    from linkplan.models.errors import ProblemError
    from linkplan.studies.report.reading import folder_report
    from linkplan.studies.report.render import refuse_other_files, write_report

    if not arguments.output:
        raise ProblemError("-o takes a file, got an empty name")
    path, say = Path(arguments.output), progress(arguments)
    with naming("-o"):
        refuse_other_files(path)
    say(f"reading {arguments.folder}")
    write_report(folder_report(Path(arguments.folder), sample_again), path)
    size = path.stat().st_size
    show(arguments, {"report": str(path), "bytes": size}, f"{path}: {size / 1e6:.2g} MB, opens in any browser, offline too")
    return DONE
