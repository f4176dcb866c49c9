"""The command `experiment`: trackers on many imperfect machines; and the repetition of a sample by `track`."""

from __future__ import annotations

import argparse
import functools
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.errors import ProblemError
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.files.tables import read_tables
from linkplan.planner.problem.problem import Problem
from linkplan.studies.cli.common import deliver, engine_asked, output_folder, plan_asked, sample_again, set_all, with_motion
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
        trackers=TRACKERS if arguments.trackers.strip() == "all" else tuple(map(str.strip, arguments.trackers.split(","))),
        samples=arguments.samples,
        seed=arguments.seed,
        design=arguments.design,
        levels=arguments.levels,
        tube_deg=arguments.tube_deg,
        tube_m=arguments.tube_m,
    )
    if arguments.threads < 0:
        raise ProblemError(f"--threads is a whole number of at least 0, got {arguments.threads}")
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


def run_replay(arguments: argparse.Namespace) -> int:
    """Run one sample of an experiment again; 1 if it fails or is unstable."""
    from linkplan.studies.compare.compare import Comparison, comparison_record
    from linkplan.studies.compare.comparison_blocks import comparison_blocks, comparison_figure
    from linkplan.studies.compare.time_series import save_time_series
    from linkplan.studies.experiment.block import replay
    from linkplan.studies.experiment.study import refuse_changed_tracker, saved_experiment
    from linkplan.studies.output.document import Text
    from linkplan.studies.report.experiment_sections import machine_section
    from linkplan.studies.report.reports import replay_report

    target = output_folder(arguments)
    _refuse_beside_sample(arguments)
    experiment = saved_experiment(Path(arguments.plan))
    refuse_changed_tracker(Path(arguments.plan), arguments.tracker)
    rollout, said = replay(experiment, arguments.tracker, arguments.sample)
    plan = experiment.plan
    title, stem = f"sample {arguments.sample}", f"sample-{arguments.sample}"
    runs = {arguments.tracker: rollout}
    comparison = Comparison(plan=plan, nominal=runs, mismatch=None, mismatched={}, title=title, stem=stem)
    record = comparison_record(comparison) | {"tracker": arguments.tracker, "sample": said}

    def draw(place: Path) -> None:
        save_time_series(comparison, place, parquet=arguments.parquet)
        comparison_figure(comparison, place / "track.png")

    failure = [Text(text=said["failure"], tone="bad")] if said["failure"] else []
    blocks = [*comparison_blocks(comparison), *failure, *machine_section(said).blocks]
    deliver(arguments, target, record, blocks, lambda: replay_report(comparison, said), draw)
    return DONE if said["failure"] is None and rollout.stable else NO


def _refuse_beside_sample(arguments: argparse.Namespace) -> None:
    """Refuse options that would change a sample's machine or its plan."""
    given = {
        "--set": bool(arguments.set),
        "--anyway": arguments.anyway,
        "--mass-factor": arguments.mass_factor != 1.0,
        "--delay-periods": arguments.delay_periods != 0,
    }
    if named := [option for option, is_given in given.items() if is_given]:
        raise ProblemError(
            f"{', '.join(named)}: not with --sample, which runs a machine of an experiment again as it was; without it they"
            " go with a plan"
        )
