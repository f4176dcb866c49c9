"""The command `check`."""

import argparse
from pathlib import Path

from linkplan.planner.files.folders import write_json, write_whole
from linkplan.studies.check.refused_model import REFUSED, RefusedModel
from linkplan.studies.cli.common import output_folder, poses_asked, tables_of
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import show


def run_check(arguments: argparse.Namespace) -> int:
    """Report on a mechanism and its quantities along a path; 1 if problems are found."""
    from linkplan.studies.check.whole_check import check_whole, mechanism_and_problem

    target = output_folder(arguments)
    name, tables, folder, is_problem = tables_of(arguments.model, arguments.set)
    try:
        sections = tables if is_problem else {"mechanism": tables["mechanism"]}
        mechanism, problem, notes = mechanism_and_problem(name, sections, folder)
    except REFUSED as error:
        return _refused(arguments, target, RefusedModel(name=Path(name).stem, error=error))
    whole = check_whole(mechanism, problem, poses_asked(arguments, mechanism), notes)
    found, said = whole.found, whole.record()
    if target is not None:
        from linkplan.studies.check.path_plots import inspection_figure, path_figure
        from linkplan.studies.report.reports import check_report
        from linkplan.studies.report.saving import save_report

        def write(place: Path) -> None:
            write_json(place / "check.json", said)
            save_report(check_report(whole), place, page=arguments.report)
            inspection_figure(found, place / "mechanism.png")
            for number, path in enumerate(whole.paths, 1):
                path_figure(path, found.reaches, place / f"loop-{number}.png")

        write_whole(target, write, "check.json")
    show(arguments, said, whole.blocks())
    return NO if found.problems else DONE


def _refused(arguments: argparse.Namespace, target: Path | None, found: RefusedModel) -> int:
    """Report on a model that cannot be loaded; the exit code is that of a problem, not of bad input."""
    said = found.record()
    if target is not None:
        from linkplan.studies.report.reports import check_report
        from linkplan.studies.report.saving import save_report

        def write(place: Path) -> None:
            write_json(place / "check.json", said)
            save_report(check_report(found), place, page=arguments.report)

        write_whole(target, write, "check.json")
    show(arguments, said, found.blocks())
    return NO
