"""The commands `experiment` and `decompose`: trackers on many imperfect machines, and the causes of their errors."""

from __future__ import annotations

import argparse
import functools
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.files.tables import read_tables
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import whole
from linkplan.studies.cli.common import (
    deliver,
    engine_asked,
    names_asked,
    output_folder,
    plan_asked,
    sample_again,
    set_all,
    with_motion,
)
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress, show

if TYPE_CHECKING:
    from linkplan.studies.experiment.study import Outcome


def run_experiment(arguments: argparse.Namespace) -> int:
    """Run or continue an experiment; 1 if the plan has no motion."""
    from linkplan.planner.planning import plan_motion
    from linkplan.studies.experiment import study
    from linkplan.studies.experiment.experiment import Settings, plan_digest
    from linkplan.studies.experiment.experiment_blocks import outcome_blocks

    settings = Settings(
        trackers=TRACKERS if arguments.trackers.strip() == "all" else tuple(names_asked(arguments.trackers, "--trackers")),
        samples=arguments.samples,
        seed=arguments.seed,
        design=arguments.design,
        levels=arguments.levels,
        tube_deg=arguments.tube_deg,
        tube_m=arguments.tube_m,
    )
    whole(arguments.threads, "--threads", 0, 10_000)
    engine = engine_asked(arguments)
    target = output_folder(arguments)
    say, source = progress(arguments), arguments.plan
    if source in PROBLEMS or Path(source).is_file():
        name, tables, folder = read_tables(source)
        set_all(tables, arguments.set)
        problem = Problem.from_tables(name, tables, folder)
        digest, asked = None, {"name": name, **problem.source, "model_hash": problem.mechanism.fingerprint()}

        def plan():
            return with_motion(plan_motion(problem, say))
    else:
        saved = plan_asked(arguments, say)
        digest, asked = plan_digest(saved), {"name": saved.problem.name, **saved.problem.source}

        def plan():
            return saved

    how = {"engine": engine, "threads": arguments.threads}
    outcome = study.run_experiment(asked, digest, plan, settings, target, say, **how)
    if arguments.report and target is not None:
        _write_page(outcome, target)
    show(arguments, outcome.record, outcome_blocks(outcome))
    return DONE if outcome.experiment.plan.passed else NO


def _write_page(outcome: Outcome, target: Path) -> None:
    """Write the page into a folder with results, which stay unchanged."""
    from linkplan.studies.report.render import PAGE, write_report
    from linkplan.studies.report.reports import experiment_report

    write_report(experiment_report(outcome, functools.partial(sample_again, target)), target / PAGE)


def run_decompose(arguments: argparse.Namespace) -> int:
    """Split trackers' errors among their causes; 1 if the plan has no motion or a tracker's error cannot be split."""
    from linkplan.studies.compare.user_tracker import trackers_named
    from linkplan.studies.decompose.decompose import decompose, decomposition_record
    from linkplan.studies.decompose.decomposition_blocks import decomposition_blocks, decomposition_figure

    asked = trackers_named(arguments.trackers)
    target, say = output_folder(arguments), progress(arguments)
    plan = plan_asked(arguments, say)
    found = decompose(plan, asked, arguments.samples, arguments.seed, say)
    said = decomposition_record(found)
    blocks = decomposition_blocks(found)

    def draw(place: Path) -> None:
        decomposition_figure(found, place / "decompose.png")

    deliver(arguments, target, said, blocks, lambda reports: reports.decomposition_report(found), draw)
    return DONE if plan.passed and found.found else NO
