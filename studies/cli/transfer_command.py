"""The command `transfer`."""

import argparse
from pathlib import Path

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.problem.problem import Problem
from linkplan.studies.cli.common import deliver, names_asked, once, output_folder, plan_of, selection_asked, tables_of
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress


def run_transfer(arguments: argparse.Namespace) -> int:
    """Carry efforts, gains and inertia across a linkage; 1 if the table misses the interpolation error asked for."""
    from linkplan.studies.transfer.study import GAINS, transfer_study
    from linkplan.studies.transfer.transfer_blocks import transfer_blocks, transfer_record

    target, say = output_folder(arguments), progress(arguments)
    name, tables, folder, is_problem = tables_of(arguments.model, arguments.set, selection_asked(arguments))
    problem = Problem.from_tables(name, tables, folder) if is_problem else None
    mechanism = mechanism_from_tables(tables, folder) if problem is None else problem.mechanism
    along = None if arguments.along is None else plan_of(arguments.along, say)
    gains = {key: numbers(getattr(arguments, key), key) for key in GAINS if getattr(arguments, key) is not None}
    found = transfer_study(
        mechanism,
        names_asked(arguments.joints, "--joints"),
        tolerance=arguments.tolerance,
        ends=_ends(arguments.range, mechanism),
        problem=problem,
        motor_speeds=() if arguments.motor_speed is None else numbers(arguments.motor_speed, "motor_speed"),
        gains=gains,
        along=along,
        say=say,
    )

    def draw(place: Path) -> None:
        from linkplan.studies.transfer.files import write_files

        write_files(found, place, parquet=arguments.parquet)

    said, blocks = transfer_record(found), transfer_blocks(found)
    deliver(arguments, target, said, blocks, lambda reports: reports.transfer_report(found), draw)
    return DONE if found.kept else NO


def numbers(text: str, key: str) -> list[float]:
    """Return the numbers of an option, with commas between them."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise ProblemError(f"--{key.replace('_', '-')} takes numbers with commas between them, got '{text}'") from None


def _ends(ranges: list[str], mechanism: Mechanism) -> dict[str, tuple[float, float]]:
    """Return the ranges of --range, JOINT=LOW:HIGH in degrees or metres, in rad or m by joint."""
    found: dict[str, tuple[float, float]] = {}
    for text in ranges:
        name, _, both = text.partition("=")
        ends = both.split(":")
        try:
            low, high = (float(end) for end in ends)
        except ValueError:
            raise ProblemError(f"--range takes JOINT=LOW:HIGH in degrees (metres for a slide), got '{text}'") from None
        joint = mechanism.joints[mechanism.joint_index(name.strip(), ProblemError)]
        once(found, joint.name, (joint.read(low), joint.read(high)), "--range")
    return found
