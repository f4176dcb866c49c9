"""The command `prove`."""

import argparse
from pathlib import Path

from linkplan.studies.cli.common import PROVING, plan_of, with_motion
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress, show


def run_prove(arguments: argparse.Namespace) -> int:
    """Prove a plan's limits at every instant; 1 if one of them is refuted."""
    from linkplan.models.errors import ProblemError
    from linkplan.planner.plan_folder import read_to_prove
    from linkplan.studies.output.document import Text
    from linkplan.studies.output.proof_blocks import proof_blocks

    say, folder = progress(arguments), Path(arguments.plan)
    if folder.is_dir():
        if arguments.set:
            raise ProblemError(f"--set {arguments.set[0]}: a saved plan is fixed; it is proved as it is")
        plan = read_to_prove(folder)
    else:
        plan = plan_of(arguments.plan, say, arguments.set)
    plan = with_motion(plan)
    say(PROVING)
    proof = plan.prove()
    said = {"plan": plan.problem.name, "verdict": proof.verdict} | proof.record()
    show(arguments, said, [Text(text=plan.problem.name), *proof_blocks(proof)])
    return DONE if proof.passed else NO
