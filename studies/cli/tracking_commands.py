"""The commands `track` and `compare`."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from linkplan.models.errors import ProblemError
from linkplan.planner.plan import Plan
from linkplan.planner.problem.settings import number
from linkplan.studies.cli.common import deliver, output_folder, plan_asked
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import Progress, progress
from linkplan.studies.output.document import Block, Report, Section

if TYPE_CHECKING:
    from linkplan.studies.compare.compare import Comparison, Mismatch


def run_track(arguments: argparse.Namespace) -> int:
    """Run one tracker; 1 if the plan has no motion or the loop is unstable."""
    from linkplan.studies.compare.compare import Comparison, track
    from linkplan.studies.compare.comparison_notes import comparison_record
    from linkplan.studies.compare.user_tracker import tracker_named

    if arguments.sample is not None:
        return _run_sample(arguments)
    asked = tracker_named(arguments.tracker)
    target, say = output_folder(arguments), progress(arguments)
    plan, mismatch = _plan_and_mismatch(arguments, say)
    run = track(plan, asked, mismatch)
    title, stem = ("nominal", "nominal") if mismatch is None else (mismatch.name, "mismatch")
    comparison = Comparison(plan=plan, nominal={run.tracker: run}, title=title, stem=stem)
    said = comparison_record(comparison) | {"tracker": run.tracker}
    _deliver(arguments, target, comparison, said, lambda made: made.comparison_report(comparison))
    return DONE if plan.passed and run.stable else NO


def _run_sample(arguments: argparse.Namespace) -> int:
    """Run one sample of an experiment again; 1 if it fails or is unstable."""
    from linkplan.studies.compare.compare import Comparison
    from linkplan.studies.compare.comparison_notes import comparison_record
    from linkplan.studies.experiment.block import replay
    from linkplan.studies.experiment.study import refuse_changed_tracker, saved_experiment
    from linkplan.studies.output.document import Text
    from linkplan.studies.report.experiment_sections import machine_section

    target, number, tracker = output_folder(arguments), arguments.sample, arguments.tracker
    _refuse_beside_sample(arguments)
    experiment = saved_experiment(Path(arguments.plan))
    refuse_changed_tracker(Path(arguments.plan), tracker)
    run, said = replay(experiment, tracker, number)
    title, stem = f"sample {number}", f"sample-{number}"
    comparison = Comparison(plan=experiment.plan, nominal={tracker: run}, title=title, stem=stem)
    record = comparison_record(comparison) | {"tracker": tracker, "sample": said}
    failure = [Text(text=said["failure"], tone="bad")] if said["failure"] else []
    further = [*failure, *machine_section(said).blocks]
    _deliver(arguments, target, comparison, record, lambda made: made.replay_report(comparison, said), further)
    return DONE if said["failure"] is None and run.stable else NO


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


def _plan_and_mismatch(arguments: argparse.Namespace, say: Progress) -> tuple[Plan, "Mismatch | None"]:
    """Return the plan and the mismatch asked for, or None; its numbers are checked before the plan is made."""
    from linkplan.studies.compare.compare import delay_of, mismatch_of

    factor = number(arguments.mass_factor, "--mass-factor", positive=True)
    delay = delay_of(arguments.delay_periods, "--delay-periods")
    plan = plan_asked(arguments, say)
    return plan, mismatch_of(plan, factor, delay)


def run_compare(arguments: argparse.Namespace) -> int:
    """Run all trackers; 1 if the plan has no motion or no tracker is stable on the nominal model."""
    from linkplan.studies.compare.compare import compare
    from linkplan.studies.compare.comparison_blocks import document_blocks
    from linkplan.studies.compare.comparison_notes import comparison_record
    from linkplan.studies.compare.document import document_record, is_the_documents, mended_runs
    from linkplan.studies.compare.user_tracker import trackers_named

    asked = trackers_named(arguments.trackers)
    target, say = output_folder(arguments), progress(arguments)
    plan, mismatch = _plan_and_mismatch(arguments, say)
    comparison = compare(plan, mismatch, say, asked)
    said = comparison_record(comparison)
    document, section = [], None
    if is_the_documents(plan):
        runs = mended_runs(plan, say)
        said["document"] = document_record(runs)
        document = document_blocks(runs)
        section = Section(title="The source document, as printed and mended", blocks=document)
    _deliver(arguments, target, comparison, said, lambda made: made.comparison_report(comparison, section), (), document)
    return DONE if plan.passed and any(rollout.stable for rollout in comparison.nominal.values()) else NO


def _deliver(
    arguments: argparse.Namespace,
    target: Path | None,
    comparison: "Comparison",
    said: dict,
    report: Callable[[ModuleType], Report],
    further: Sequence[Block] = (),
    document: Sequence[Block] = (),
) -> None:
    """Save and show runs, with `further` blocks on a terminal and the figure of the source `document`."""
    from linkplan.studies.compare.comparison_blocks import comparison_blocks, comparison_figure, document_figure
    from linkplan.studies.compare.time_series import save_time_series

    def draw(place: Path) -> None:
        save_time_series(comparison, place, parquet=arguments.parquet)
        comparison_figure(comparison, place / f"{arguments.command}.png")
        if document:
            document_figure(document, place / "desired_and_actual.png")

    deliver(arguments, target, said, [*comparison_blocks(comparison), *further], report, draw)
