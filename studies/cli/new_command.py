"""The command `new`."""

import argparse

from linkplan.models.errors import ProblemError
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.studies.cli.common import new_file, selection_asked, tables_of
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress, show


def run_new(arguments: argparse.Namespace) -> int:
    """Write a problem file for a mechanism; 1 if no motion was found for it."""
    from linkplan.planner.files.single_file import write_new
    from linkplan.studies.new.first_motion import first_motion
    from linkplan.studies.new.problem_text import file_tables, first_text

    target, say = new_file(arguments), progress(arguments)
    if arguments.model in PROBLEMS or arguments.model.endswith(".toml"):
        raise ProblemError(f"'{arguments.model}' is already a problem; new takes the model of a mechanism")
    _, sections, _, _ = tables_of(arguments.model, arguments.set, selection_asked(arguments))
    if further := sections.keys() - {"mechanism"}:
        raise ProblemError(f"new takes --set mechanism.KEY=VALUE and writes the other sections, got {', '.join(further)}")
    found = first_motion(sections["mechanism"], say)
    tables = file_tables(found, arguments.model, target)
    file = "problem.toml" if target is None else target.name
    steps = (f"linkplan plan {file} -o planned", "linkplan compare planned -o compared")
    text = first_text(found, tables, steps)
    if target is not None:
        write_new(target, text.encode("utf-8"))
    verdict = "planned" if found.planned else f"NOT planned: {found.why}"
    notes = [f"note: {note}" for note in found.notes]
    said = {"file": None if target is None else str(target), "planned": found.planned, "why": found.why, "tables": tables}
    said |= {"notes": found.notes}
    if target is None:
        for line in (f"{found.description}: {verdict}", *notes):
            say.keep(line)
        show(arguments, said, text.rstrip("\n"))
    else:
        show(arguments, said, "\n".join([f"{target}: {found.description}", f"{verdict[0].upper()}{verdict[1:]}", *notes]))
    return DONE if found.planned else NO
