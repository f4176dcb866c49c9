"""The command `check`."""

import argparse
from pathlib import Path

from linkplan.models.errors import LinkplanError, LockedError, UnassembledError
from linkplan.planner.files.folders import write_json, write_whole
from linkplan.planner.files.problem_file import mechanism_from_tables, problem_from_tables
from linkplan.studies.check.refused_model import RefusedModel
from linkplan.studies.cli.common import output_folder, poses_asked, tables_of
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import show


def run_check(arguments: argparse.Namespace) -> int:
    """Report on a mechanism and what it does along its way; 1 where problems are found."""
    from linkplan.studies.check.whole_check import check_whole

    target = output_folder(arguments)
    asked = tables_of(arguments.model, arguments.set)
    try:
        mechanism, problem, note = _to_check(*asked)
    except (LockedError, UnassembledError) as error:
        return _refused(arguments, target, RefusedModel(name=Path(asked[0]).stem, error=error))
    whole = check_whole(mechanism, problem, poses_asked(arguments, mechanism), [] if note is None else [note])
    found, said = whole.found, whole.record()
    if target is not None:
        from linkplan.studies.check.draw_kinematic_loop_report import path_figure
        from linkplan.studies.check.draw_mechanism import inspection_figure
        from linkplan.studies.report.reports import check_report
        from linkplan.studies.report.saving import save_report

        def write(place: Path) -> None:
            write_json(place / "check.json", said)
            save_report(check_report(whole), place, page=arguments.report)
            inspection_figure(found, place / "mechanism.png")
            for number, path in enumerate(whole.paths, 1):
                path_figure(path, found.reaches, place / f"loop-{number}.png")

        write_whole(target, write, "check.json")
    show(arguments, said, whole.text())
    return NO if found.problems else DONE


def _refused(arguments: argparse.Namespace, target: Path | None, found: RefusedModel) -> int:
    """Report on a model that is no mechanism; a problem found, and no bad input."""
    said = found.record()
    if target is not None:
        from linkplan.studies.report.reports import check_report
        from linkplan.studies.report.saving import save_report

        def write(place: Path) -> None:
            write_json(place / "check.json", said)
            save_report(check_report(found), place, page=arguments.report)

        write_whole(target, write, "check.json")
    show(arguments, said, found.text())
    return NO


def _to_check(name: str, tables: dict, folder: Path | None, is_problem: bool):
    """Return the mechanism to check, its problem if there is one, and why the problem that there is cannot be used."""
    if not is_problem or "motion" not in tables:
        return mechanism_from_tables(tables, folder), None, None
    try:
        problem = problem_from_tables(name, tables, folder)
    except (LockedError, UnassembledError):
        raise
    except LinkplanError as error:
        return mechanism_from_tables(tables, folder), None, f"the problem cannot be planned: {error}"
    return problem.mechanism, problem, None
