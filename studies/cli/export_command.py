"""The command `export`."""

import argparse

from linkplan.models.errors import ProblemError
from linkplan.models.names import choose
from linkplan.studies.cli.common import new_file, no_plan, plan_asked
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress, show
from linkplan.studies.export.formats import FORMATS


def run_export(arguments: argparse.Namespace) -> int:
    """Write a plan for another program; 1 if the plan has no motion."""
    from linkplan.planner.files.single_file import write_new
    from linkplan.studies.export.export import exported

    choose("format", arguments.to, FORMATS, ProblemError)
    target, say = new_file(arguments), progress(arguments)
    plan = plan_asked(arguments, say)
    if plan.trajectory is None:
        return no_plan(arguments, plan)
    content = exported(plan, arguments.to, arguments.every_s)
    write_new(target, content)
    said = {"file": str(target), "format": arguments.to, "bytes": len(content), "plan": plan.problem.name}
    show(arguments, said, f"{target}: {plan.problem.name}, {FORMATS[arguments.to]}")
    return DONE if plan.passed else NO
