"""The command `export`."""

import argparse
from pathlib import Path

from linkplan.models.errors import ProblemError, choose
from linkplan.studies.cli.common import names_asked, new_file, output_folder, plan_asked, selection_asked, tables_of
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress, show
from linkplan.studies.export.formats import C_TRACKERS, FOLDER_FORMATS, FORMATS


def run_export(arguments: argparse.Namespace) -> int:
    """Write a plan for another program; 1 if the plan has no motion."""
    choose("format", arguments.to, (*FORMATS, *FOLDER_FORMATS), ProblemError)
    if arguments.to in FOLDER_FORMATS:
        return _export_c(arguments)
    for name in ("tolerance", "sizes"):
        if getattr(arguments, name):
            raise ProblemError(f"--{name} is for code in C, got --to {arguments.to}")
    from linkplan.planner.files.single_file import write_new
    from linkplan.studies.export.export import exported

    target, say = new_file(arguments), progress(arguments)
    assert target is not None  # -o is required
    plan = plan_asked(arguments, say)
    content = exported(plan, arguments.to, arguments.every_s, names_asked(arguments.joints, "--joints"))
    write_new(target, content)
    said = {"file": str(target), "format": arguments.to, "bytes": len(content), "plan": plan.problem.name}
    show(arguments, said, f"{target}: {plan.problem.name}, {FORMATS[arguments.to]}")
    return DONE if plan.passed else NO


def _export_c(arguments: argparse.Namespace) -> int:
    """Write a model's dynamics or a plan's control law as C into a folder; 1 if the plan has no motion."""
    from linkplan.planner.files.folders import write_json, write_whole
    from linkplan.studies.export.c_files import cost_blocks

    choose("tracker for C", arguments.tracker, C_TRACKERS, ProblemError)
    if arguments.every_s is not None:
        raise ProblemError("--every-s is for files of samples; a law in C has the instants of tracking.period_s")
    target, say = output_folder(arguments), progress(arguments)
    assert target is not None  # -o is required
    said: dict = {}
    passed = True
    if Path(arguments.plan).is_dir() or tables_of(arguments.plan, [])[3]:
        from linkplan.studies.export.c_law import write_law
        from linkplan.studies.export.law_tables import law_tables

        if arguments.joints is not None:
            raise ProblemError("--joints is for ros, and for a model in C; a plan's law has the plan's own coordinates")
        if arguments.sizes:
            raise ProblemError("--sizes is for a model in C; a law's flash and stack are measured anyway")
        plan = plan_asked(arguments, say)
        tables, passed = law_tables(plan, arguments.tracker, arguments.tolerance or 0.0), plan.passed

        def write(place: Path) -> None:
            said.update(write_law(tables, place) | {"plan": plan.problem.name})
            write_json(place / "export.json", said)
    else:
        from linkplan.planner.problem.build import mechanism_from_tables
        from linkplan.studies.export.c_files import write_model
        from linkplan.studies.export.c_model import model_code
        from linkplan.studies.export.output_joints import with_outputs

        if arguments.tolerance is not None:
            raise ProblemError("--tolerance is for the tables of a plan's law in C; a model's code has none")
        _, tables, folder, _ = tables_of(arguments.plan, arguments.set, selection_asked(arguments))
        mechanism = mechanism_from_tables(tables, folder)
        if arguments.joints is not None:
            mechanism = with_outputs(mechanism, names_asked(arguments.joints, "--joints"))
        code = model_code(mechanism)
        say(f"{code.mechanism.name}: C code")

        def write(place: Path) -> None:
            said.update(write_model(code, place, compiled=arguments.sizes or None))
            write_json(place / "export.json", said)

    write_whole(target, write, "export.json")
    show(arguments, said, cost_blocks(said, target))
    return DONE if passed else NO
