"""The commands `track` and `compare`."""

import argparse
from pathlib import Path

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.plan import Plan
from linkplan.studies.cli.common import deliver, output_folder, plan_asked
from linkplan.studies.cli.exit_codes import DONE, NO
from linkplan.studies.cli.printing import progress


def run_track(arguments: argparse.Namespace) -> int:
    """Run one tracker; 1 if the plan has no motion or the loop is unstable."""
    from linkplan.studies.compare.compare import comparison_record
    from linkplan.studies.compare.user_tracker import tracker_named

    if arguments.sample is not None:
        from linkplan.studies.cli.experiment_command import run_replay

        return run_replay(arguments)
    asked = tracker_named(arguments.tracker)
    target, say = output_folder(arguments), progress(arguments)
    mismatch_given = _check_mismatch(arguments)
    plan = plan_asked(arguments, say)
    comparison = _single(plan, asked, arguments, mismatch_given)
    said = comparison_record(comparison) | {"tracker": next(iter(comparison.nominal))}
    _deliver(arguments, target, comparison, said)
    return DONE if plan.passed and next(iter(comparison.nominal.values())).stable else NO


def _single(plan: Plan, asked, arguments: argparse.Namespace, mismatch_given: bool):
    """Return one tracker's run as a comparison of a single tracker, with the mismatch if one was given."""
    from linkplan.studies.compare.compare import Comparison, default_mismatch, track

    mismatch = default_mismatch(plan, arguments.mass_factor, arguments.delay_periods) if mismatch_given else None
    rollout = track(plan, asked, mismatch)
    title, stem = ("nominal", "nominal") if mismatch is None else (mismatch.name, "mismatch")
    runs = {rollout.tracker: rollout}
    return Comparison(plan=plan, nominal=runs, mismatch=None, mismatched={}, title=title, stem=stem)


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
    from linkplan.studies.compare.document import document_record, is_the_documents, mended_runs
    from linkplan.studies.compare.user_tracker import trackers_named

    asked = trackers_named(arguments.trackers)
    target, say = output_folder(arguments), progress(arguments)
    mismatch_given = _check_mismatch(arguments)
    plan = plan_asked(arguments, say)
    mismatch = default_mismatch(plan, arguments.mass_factor, arguments.delay_periods) if mismatch_given else None
    comparison = compare(plan, mismatch, say, asked)
    said = comparison_record(comparison)
    document = {}
    if is_the_documents(plan):
        document = mended_runs(plan, say)
        said["document"] = document_record(document)
    _deliver(arguments, target, comparison, said, document)
    return DONE if plan.passed and any(rollout.stable for rollout in comparison.nominal.values()) else NO


def _deliver(
    arguments: argparse.Namespace, target: Path | None, comparison, said: dict, document: dict | None = None
) -> None:
    """Save and show the runs, and those of the source document's experiment if there are any."""
    from linkplan.studies.compare.comparison_blocks import (
        comparison_blocks,
        comparison_figure,
        document_blocks,
        document_figure,
    )
    from linkplan.studies.compare.document import DOCUMENT_KP, document_record
    from linkplan.studies.compare.time_series import save_time_series
    from linkplan.studies.output.document import Section

    blocks = document_blocks(document, document_record(document), DOCUMENT_KP) if document else []

    def draw(place: Path) -> None:
        save_time_series(comparison, place, parquet=arguments.parquet)
        comparison_figure(comparison, place / f"{arguments.command}.png")
        if blocks:
            document_figure(blocks, place / "desired_and_actual.png")

    def report():
        from linkplan.studies.report.reports import comparison_report

        source = Section(title="The source document, as printed and mended", blocks=blocks) if blocks else None
        return comparison_report(comparison, source)

    deliver(arguments, target, said, comparison_blocks(comparison), report, draw)
