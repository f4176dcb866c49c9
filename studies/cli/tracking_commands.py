"""The commands `track` and `compare`."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.plan import Plan
from linkplan.studies.cli.common import deliver, output_folder, plan_asked
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress
from linkplan.studies.output.document import Block, Report, Section

if TYPE_CHECKING:
    from linkplan.controllers.rollout import Rollout
    from linkplan.studies.compare.compare import Comparison


def run_track(arguments: argparse.Namespace) -> int:
    """Run one tracker; 1 if the plan has no motion or the loop is unstable."""
    from linkplan.studies.compare.compare import comparison_record, default_mismatch, track
    from linkplan.studies.compare.user_tracker import tracker_named

    if arguments.sample is not None:
        return _run_sample(arguments)
    asked = tracker_named(arguments.tracker)
    target, say = output_folder(arguments), progress(arguments)
    mismatch_given = _check_mismatch(arguments)
    plan = plan_asked(arguments, say)
    mismatch = default_mismatch(plan, arguments.mass_factor, arguments.delay_periods) if mismatch_given else None
    run = track(plan, asked, mismatch)
    title, stem = ("nominal", "nominal") if mismatch is None else (mismatch.name, "mismatch")
    comparison = _of_one(plan, run, run.tracker, title, stem)
    _deliver(arguments, target, comparison, comparison_record(comparison) | {"tracker": run.tracker})
    return DONE if plan.passed and run.stable else NO


def _run_sample(arguments: argparse.Namespace) -> int:
    """Run one sample of an experiment again; 1 if it fails or is unstable."""
    from linkplan.studies.compare.compare import comparison_record
    from linkplan.studies.experiment.block import replay
    from linkplan.studies.experiment.study import refuse_changed_tracker, saved_experiment
    from linkplan.studies.output.document import Text
    from linkplan.studies.report.experiment_sections import machine_section

    target, number, tracker = output_folder(arguments), arguments.sample, arguments.tracker
    _refuse_beside_sample(arguments)
    experiment = saved_experiment(Path(arguments.plan))
    refuse_changed_tracker(Path(arguments.plan), tracker)
    run, said = replay(experiment, tracker, number)
    comparison = _of_one(experiment.plan, run, tracker, f"sample {number}", f"sample-{number}")
    record = comparison_record(comparison) | {"tracker": tracker, "sample": said}
    failure = [Text(text=said["failure"], tone="bad")] if said["failure"] else []
    _deliver(arguments, target, comparison, record, [*failure, *machine_section(said).blocks], said)
    return DONE if said["failure"] is None and run.stable else NO


def _of_one(plan: Plan, run: "Rollout", tracker: str, title: str, stem: str) -> "Comparison":
    """Return a single run as a comparison of one tracker."""
    from linkplan.studies.compare.compare import Comparison

    return Comparison(plan=plan, nominal={tracker: run}, mismatch=None, mismatched={}, title=title, stem=stem)


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


def _check_mismatch(arguments: argparse.Namespace) -> bool:
    """Check the numbers of the mismatch and tell if there is one."""
    factor, delay = arguments.mass_factor, arguments.delay_periods
    if not (np.isfinite(factor) and factor > 0):
        raise ProblemError(f"--mass-factor is a positive number, got {factor:g}")
    if not 0 <= delay <= 1000:
        raise ProblemError(f"--delay-periods is a number from 0 to 1000, got {delay:g}")
    return factor != 1.0 or delay != 0


def run_compare(arguments: argparse.Namespace) -> int:
    """Run all trackers; 1 if the plan has no motion or no tracker is stable on the nominal model."""
    from linkplan.studies.compare.compare import compare, comparison_record, default_mismatch
    from linkplan.studies.compare.comparison_blocks import document_blocks
    from linkplan.studies.compare.document import DOCUMENT_KP, document_record, is_the_documents, mended_runs
    from linkplan.studies.compare.user_tracker import trackers_named

    asked = trackers_named(arguments.trackers)
    target, say = output_folder(arguments), progress(arguments)
    mismatch_given = _check_mismatch(arguments)
    plan = plan_asked(arguments, say)
    mismatch = default_mismatch(plan, arguments.mass_factor, arguments.delay_periods) if mismatch_given else None
    comparison = compare(plan, mismatch, say, asked)
    said = comparison_record(comparison)
    document: list[Block] = []
    if is_the_documents(plan):
        runs = mended_runs(plan, say)
        said["document"] = document_record(runs)
        document = document_blocks(runs, said["document"], DOCUMENT_KP)
    _deliver(arguments, target, comparison, said, document=document)
    return DONE if plan.passed and any(rollout.stable for rollout in comparison.nominal.values()) else NO


def _deliver(
    arguments: argparse.Namespace,
    target: Path | None,
    comparison: "Comparison",
    said: dict,
    further: Sequence[Block] = (),
    sample: dict | None = None,
    document: Sequence[Block] = (),
) -> None:
    """Save and show runs: of a `sample` of an experiment by its record, or with the source document's experiment."""
    from linkplan.studies.compare.comparison_blocks import comparison_blocks, comparison_figure, document_figure
    from linkplan.studies.compare.time_series import save_time_series

    def draw(place: Path) -> None:
        save_time_series(comparison, place, parquet=arguments.parquet)
        comparison_figure(comparison, place / f"{arguments.command}.png")
        if document:
            document_figure(document, place / "desired_and_actual.png")

    def report(reports: ModuleType) -> Report:
        if sample is not None:
            return reports.replay_report(comparison, sample)
        title = "The source document, as printed and mended"
        return reports.comparison_report(comparison, Section(title=title, blocks=document) if document else None)

    deliver(arguments, target, said, [*comparison_blocks(comparison), *further], report, draw)
