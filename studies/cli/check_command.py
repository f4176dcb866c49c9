"""The command `check`."""

import argparse
from dataclasses import replace
from pathlib import Path

from linkplan.models.errors import LinkplanError
from linkplan.planner.files.folders import write_json, write_whole
from linkplan.planner.files.problem_file import mechanism_from_tables, problem_from_tables
from linkplan.studies.cli.common import output_folder, poses_asked, tables_of
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import show


def run_check(arguments: argparse.Namespace) -> int:
    """Report on a mechanism and what it does along its way; 1 where problems are found."""
    from linkplan.studies.check.check_report import path_text
    from linkplan.studies.check.inspection import inspect, inspection_record
    from linkplan.studies.check.inspection_text import inspection_text
    from linkplan.studies.check.loop_report import path_record, reach_paths

    target = output_folder(arguments)
    mechanism, problem, note = _to_check(*tables_of(arguments.model, arguments.set))
    motion, off_path = _motion(problem)
    contacts = "refuse" if problem is None else problem.contacts
    found = inspect(mechanism, poses_asked(arguments, mechanism), motion=motion, contacts=contacts)
    paths = reach_paths(mechanism, found.reaches) if motion is None else (motion,)
    found = replace(found, notes=(*found.notes, *(text for text in (note, off_path) if text)))
    said = inspection_record(found) | {"along": [path_record(path) for path in paths]}
    if target is not None:
        from linkplan.studies.check.draw_loop_report import path_figure
        from linkplan.studies.check.draw_mechanism import inspection_figure

        def write(place: Path) -> None:
            write_json(place / "check.json", said)
            inspection_figure(found, place / "mechanism.png")
            for number, path in enumerate(paths, 1):
                path_figure(path, found.reaches, place / f"loop-{number}.png")

        write_whole(target, write, "check.json")
    show(arguments, said, "\n\n".join([inspection_text(found), *(path_text(path) for path in paths)]))
    return NO if found.problems else DONE


def _to_check(name: str, tables: dict, folder: Path | None, is_problem: bool):
    """Return the mechanism to check, its problem if there is one, and why the problem that there is cannot be used."""
    if not is_problem or "motion" not in tables:
        return mechanism_from_tables(tables, folder), None, None
    try:
        problem = problem_from_tables(name, tables, folder)
    except LinkplanError as error:
        return mechanism_from_tables(tables, folder), None, f"the problem cannot be planned: {error}"
    return problem.mechanism, problem, None


def _motion(problem):
    """Return the path of a problem's motion, or None, and why there is none, if there is a problem."""
    from linkplan.studies.check.loop_report import motion_path

    if problem is None:
        return None, None
    try:
        return motion_path(problem), None
    except LinkplanError as error:
        return None, f"no path for the problem's motion: {error}"
