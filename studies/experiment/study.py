"""The whole of an experiment: from a plan to a folder with its results, or to a summary alone."""

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.folders import check_target, plain_record, write_json, write_whole
from linkplan.planner.files.plan_folder import write_plan
from linkplan.planner.plan import Plan
from linkplan.studies.experiment.block import block_count
from linkplan.studies.experiment.conduct import Say, conduct
from linkplan.studies.experiment.experiment import (
    Experiment,
    Settings,
    asked_record,
    experiment_of,
    imperfections_asked,
    settings_from,
)
from linkplan.studies.experiment.metrics import metrics_of
from linkplan.studies.experiment.parts import (
    PLAN,
    read_results,
    refuse_other,
    remove,
    unfinished,
    working,
    write_results,
)
from linkplan.studies.experiment.summary import Summary, summarise, summary_record

RECORD, RESULTS = "experiment.json", "results.parquet"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Outcome:
    """An experiment's results: their columns, what they say, and the record of both."""

    experiment: Experiment
    results: Mapping[str, np.ndarray]
    summary: Summary
    record: dict


def run_experiment(
    source: Mapping,
    digest: str | None,
    plan: Callable[[], Plan],
    settings: Settings,
    target: Path | None,
    say: Say,
    *,
    workers: int = 1,
    threads: int = 0,
    batch: int | None = None,
) -> Outcome:
    """Return an experiment's outcome, and write it into a folder, where one is given.

    Args:
        source: the tables of the problem.
        digest: of a saved plan's motion; None where the problem is planned.
        plan: gives the plan, when it is needed.
        settings: of the experiment.
        target: the folder, written whole when all is done; its parts stand beside it until then.
        say: is told of the progress.
        workers: processes.
        threads: of the simulator in each.
        batch: simulations stepped together, at the most.

    Raises:
        PlanFileError: when the folder holds something else, or the disk refuses.
        LinkplanError: for what cannot be simulated.
    """
    asked = asked_record(source, digest, settings)
    if target is None:
        with tempfile.TemporaryDirectory(prefix="linkplan-") as place:
            return _carried_out(Path(place) / "run", asked, plan, settings, None, say, workers, threads, batch)
    check_target(target, RECORD)
    if (target / RECORD).is_file():
        refuse_other(target / RECORD, asked, f"'{target}' holds another experiment's results")
        say(f"'{target}' holds these results already")
        return saved_outcome(target)
    return _carried_out(unfinished(target), asked, plan, settings, target, say, workers, threads, batch)


def _carried_out(
    folder: Path,
    asked: dict,
    plan: Callable[[], Plan],
    settings: Settings,
    target: Path | None,
    say: Say,
    workers: int,
    threads: int,
    batch: int | None,
) -> Outcome:
    with working(folder, asked):
        experiment = conduct(folder, settings, plan, workers, threads, say, batch)
        blocks = block_count(experiment.n)
        write_results(folder, folder / RESULTS, blocks)
        outcome = _outcome(experiment, read_results(folder / RESULTS), asked)
        (folder / RESULTS).unlink()
        if target is not None:
            write_whole(target, lambda place: _save(outcome, folder, place, blocks), RECORD)
            remove(folder)
    return outcome


def _save(outcome: Outcome, folder: Path, place: Path, blocks: int) -> None:
    from linkplan.studies.experiment.draw_experiment import experiment_figure

    write_results(folder, place / RESULTS, blocks)
    write_json(place / RECORD, outcome.record)
    (place / PLAN).mkdir()
    write_plan(outcome.experiment.plan, place / PLAN)
    settings, summary = outcome.experiment.settings, outcome.summary
    title = f"{outcome.experiment.plan.problem.name}: {summary.samples} machines"
    experiment_figure(outcome.results, settings.trackers, summary.metrics, title, place / "experiment.png")


def _outcome(experiment: Experiment, results: Mapping[str, np.ndarray], asked: dict) -> Outcome:
    metrics = metrics_of(experiment.plan.problem.mechanism)
    summary = summarise(results, experiment.settings.trackers, metrics)
    record = {
        "experiment": experiment.plan.problem.name,
        "asked": asked,
        "imperfections": imperfections_asked(experiment.plan),
        "control_period_s": experiment.reference.period_s,
        "duration_s": experiment.reference.period_s * experiment.reference.n,
        **summary_record(summary),
    }
    return Outcome(experiment=experiment, results=results, summary=summary, record=plain_record(record))


def saved_experiment(folder: Path) -> Experiment:
    """Return the experiment of a folder with results, to run any of its samples again.

    Raises:
        PlanFileError: when the folder is none.
    """
    from linkplan.planner.files.plan_folder import read_plan

    if not (folder / RECORD).is_file():
        raise PlanFileError(f"'{folder}' holds no experiment: it has no {RECORD}")
    return experiment_of(read_plan(folder / PLAN, anyway=True), settings_from(_asked(folder)["settings"]))


def saved_outcome(folder: Path) -> Outcome:
    """Return the outcome of a folder with results.

    Raises:
        PlanFileError: when the folder is none.
    """
    return _outcome(saved_experiment(folder), read_results(folder / RESULTS), _asked(folder))


def _asked(folder: Path) -> dict:
    try:
        return json.loads((folder / RECORD).read_text(encoding="utf-8"))["asked"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PlanFileError(f"'{folder}' is no experiment: a folder with {RECORD}, {RESULTS} and its plan") from error
