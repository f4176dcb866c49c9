"""The commands `plan`, `prove` and `batch`."""

import argparse
import contextlib
import time
from dataclasses import asdict
from pathlib import Path

from linkplan.models.deadline import NO_DEADLINE, OutOfTimeError
from linkplan.planner.files.tables import read_tables
from linkplan.planner.plan import Plan
from linkplan.planner.planning import plan_motion, price_of, with_price
from linkplan.planner.problem.problem import Problem
from linkplan.studies.cli.common import PROVING, engine_asked, output_folder, plan_of, set_all, with_motion
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import Progress, progress, show

# A plan is proved without being asked if that takes at most this share of the plan's time, or this many seconds.
_PROOF_SHARE, _PROOF_SECONDS = 0.25, 1.0


def run_plan(arguments: argparse.Namespace) -> int:
    """Plan a motion; 1 if there is none."""
    from linkplan.studies.output.document import Text
    from linkplan.studies.output.plan_blocks import plan_blocks

    target, say, begun = output_folder(arguments), progress(arguments), time.process_time()
    name, tables, folder = read_tables(arguments.problem)
    set_all(tables, arguments.set)
    plan = plan_motion(Problem.from_tables(name, tables, folder), say)
    price = price_of(plan, say)
    plan = _proved(with_price(plan, price), arguments.prove, time.process_time() - begun, say)
    if plan.passed and target is not None:
        from linkplan.planner.files.folders import write_whole
        from linkplan.studies.output.draw_plan import save_plan

        def write(place: Path) -> None:
            save_plan(plan, place, target, jumps=arguments.jumps, parquet=arguments.parquet)
            if arguments.report:
                from linkplan.studies.report.render import PAGE, write_report
                from linkplan.studies.report.reports import plan_report

                write_report(plan_report(plan), place / PAGE)

        write_whole(target, write)
        say.keep(f"saved in {target}")
    elif target is not None:
        say.keep(f"nothing written: {plan.status}")
    blocks = [*plan_blocks(plan), *([] if price is None else [Text(text=price.sentence())])]

    def document() -> dict:
        from linkplan.planner.plan_folder import record

        return record(plan) | ({} if price is None else {"price": asdict(price)})

    show(arguments, document, blocks)
    return DONE if plan.passed else NO


def _proved(plan: Plan, asked: bool, seconds: float, say: Progress) -> Plan:
    """Return a plan with its proof, if it is asked for or costs little beside the plan's own processor time [s]."""
    if plan.trajectory is None or not plan.passed:
        return plan
    if asked:
        say(PROVING)
        return plan.with_proof()
    until = NO_DEADLINE.within(max(_PROOF_SHARE * seconds, _PROOF_SECONDS))
    with contextlib.suppress(OutOfTimeError):
        return plan.with_proof(until, existence=False)
    say.keep("not proved: the proof takes long beside the plan; linkplan plan --prove and linkplan prove make it")
    return plan


def run_batch(arguments: argparse.Namespace) -> int:
    """Plan the cases of a batch file, or continue to; 1 if one of them has no plan."""
    from linkplan.planner.files.batch_file import read_batch
    from linkplan.studies.batch import study
    from linkplan.studies.output.batch_table import batch_blocks

    engine = engine_asked(arguments)
    target, say = output_folder(arguments), progress(arguments)
    batch = read_batch(arguments.batch)
    how = {"engine": engine, "parquet": arguments.parquet, "keep_records": arguments.json}
    outcome = study.run_batch(batch, target, say, **how)
    if target is not None:
        say.keep(f"saved in {target}")
    show(arguments, outcome.record, batch_blocks(outcome.rows, outcome.failures))
    return NO if outcome.failures else DONE


def run_prove(arguments: argparse.Namespace) -> int:
    """Prove a plan's limits at every instant; 1 if one of them is refuted."""
    from linkplan.models.errors import ProblemError
    from linkplan.planner.plan_folder import read_to_prove
    from linkplan.studies.output.document import Text
    from linkplan.studies.output.plan_blocks import names_in, proof_blocks

    say, folder = progress(arguments), Path(arguments.plan)
    if folder.is_dir():
        if arguments.set:
            raise ProblemError(f"--set {arguments.set[0]}: a saved plan is fixed; it is proved as it is")
        plan = read_to_prove(folder)
    else:
        plan = plan_of(arguments.plan, say, arguments.set)
    plan = with_motion(plan)
    say(PROVING if arguments.existence else "proving the limits")
    proof = plan.prove(existence=arguments.existence)
    said = {"plan": plan.problem.name, "verdict": proof.verdict} | proof.record()
    show(arguments, said, [Text(text=plan.problem.name), *proof_blocks(proof, names_in(plan))])
    return DONE if proof.passed else NO
