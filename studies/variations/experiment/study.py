"""A complete experiment: from a plan to a folder with results, or to a summary only."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from msgspec import structs

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.errors import PlanFileError, ProblemError
from linkplan.models.extras import load_extra
from linkplan.planner.files.folders import check_target, plain_record, write_json
from linkplan.planner.files.manifest import read_record
from linkplan.planner.plan.folder import read_plan, write_plan
from linkplan.planner.plan.plan import Plan
from linkplan.studies.compare.tracker_source import object_hash, refuse_other_sources, source_hash
from linkplan.studies.compare.user_tracker import TrackerLike
from linkplan.studies.variations.experiment.conduct import conduct, read_parts, read_results, write_results
from linkplan.studies.variations.experiment.design import LATIN_HYPERCUBE, replicate_of
from linkplan.studies.variations.experiment.experiment import (
    AskedRecord,
    Experiment,
    ExperimentRecord,
    Settings,
    defaults_note,
    experiment_of,
    fall_note,
    imperfections_asked,
    request_of,
)
from linkplan.studies.variations.experiment.experiment_blocks import ExperimentOutcome
from linkplan.studies.variations.experiment.metrics import metrics_of
from linkplan.studies.variations.experiment.sensitivity import sensitivity_of
from linkplan.studies.variations.experiment.summary import chatter_notes, summarise
from linkplan.studies.variations.tasks.engine import Engine, Say, serial
from linkplan.studies.variations.tasks.unfinished import (
    PLAN,
    finish,
    parts_folder,
    refuse_other,
    remove_left,
    unfinished,
    working,
)

RECORD, RESULTS = "experiment.json", "results.parquet"


def run_experiment(
    source: Mapping,
    digest: str | None,
    plan: Callable[[], Plan],
    settings: Settings,
    target: Path | None,
    say: Say,
    *,
    engine: Engine = serial,
    threads: int = 0,
    own: Mapping[str, TrackerLike] | None = None,
) -> ExperimentOutcome:
    """Return an experiment's outcome, and write it into a folder if one is given.

    Args:
        source: the tables of the problem.
        digest: hash of a saved plan's motion; None if the problem is planned here.
        plan: returns the plan when it is needed.
        settings: of the experiment.
        target: the folder, written in one step at the end; until then the parts are kept next to it.
        say: receives progress messages.
        engine: runs the blocks.
        threads: simulator threads of each block; 0 for the engine's default.
        own: trackers given as Python objects, by their names in the settings.

    Raises:
        PlanFileError: if the folder holds something else, or cannot be written.
        LinkplanError: for a plan that cannot be simulated.
    """
    load_extra("pyarrow.parquet", "experiment")  # errors are raised before anything is planned
    objects = own or {}
    sources = {name: source_hash(name) for name in settings.trackers if name not in TRACKERS and name not in objects}
    written = {name: object_hash(given) for name, given in objects.items()}
    request = request_of(source, digest, settings, sources | written)
    asked = plain_record(request)
    if target is not None:
        check_target(target, RECORD)
        if (target / RECORD).is_file():
            refuse_other(target / RECORD, asked, f"'{target}' holds another experiment's results")
            say(f"'{target}' holds these results already")
            remove_left(unfinished(target), asked)
            return saved_outcome(target)
    with parts_folder(target) as folder, working(folder, asked, "an experiment"):
        experiment = conduct(folder, settings, sources, objects, plan, engine, say, threads)
        outcome = _outcome(experiment, read_parts(folder, experiment), request)
        if target is not None:
            finish(folder, target, lambda place: _save(outcome, place), RECORD)
    return outcome


def _save(outcome: ExperimentOutcome, place: Path) -> None:
    """Write an outcome's files into an empty folder, and check that the record and the results can be read."""
    from linkplan.studies.output.figure import save_figures

    write_results(place / RESULTS, outcome.experiment, outcome.results)
    read_results(place / RESULTS, outcome.experiment)
    write_json(place / RECORD, outcome)
    read_asked(place)
    (place / PLAN).mkdir()
    write_plan(outcome.experiment.plan, place / PLAN)
    save_figures(outcome.figure_specs(), place)


def _outcome(experiment: Experiment, results: Mapping[str, np.ndarray], asked: AskedRecord) -> ExperimentOutcome:
    metrics = metrics_of(experiment.plan.problem.mechanism)
    settings = experiment.settings
    replicate = replicate_of(experiment.n) if settings.design == LATIN_HYPERCUBE else None
    summary = summarise(results, settings.trackers, metrics, replicate)
    return ExperimentOutcome(
        **structs.asdict(summary),
        name=experiment.plan.problem.name,
        asked=asked,
        imperfections=imperfections_asked(experiment.plan),
        control_period_s=experiment.reference.period_s,
        duration_s=experiment.reference.period_s * experiment.reference.n,
        notes=[
            *(note for note in (fall_note(experiment), defaults_note(experiment.plan)) if note is not None),
            *chatter_notes(experiment, summary),
        ],
        sensitivity=sensitivity_of(experiment, results),
        experiment=experiment,
        results=results,
    )


def saved_experiment(folder: Path) -> Experiment:
    """Return the experiment of a folder with results, for the replay of its samples.

    Raises:
        PlanFileError: if the folder holds no experiment.
    """
    asked = read_asked(folder)
    return experiment_of(read_plan(folder / PLAN, anyway=True), asked.settings)


def refuse_changed_tracker(folder: Path, tracker: str) -> None:
    """Refuse a user's tracker whose source has changed since the experiment of a folder.

    Raises:
        LinkplanError: if it has changed.
    """
    sources = read_asked(folder).tracker_sources or {}
    refuse_other_sources({name: known for name, known in sources.items() if name == tracker.strip()})


def saved_outcome(folder: Path) -> ExperimentOutcome:
    """Return the outcome of a folder with results.

    Raises:
        PlanFileError: if the folder holds no experiment, or its results do not match its record.
    """
    experiment = saved_experiment(folder)
    return _outcome(experiment, read_results(folder / RESULTS, experiment), read_asked(folder))


def read_asked(folder: Path) -> AskedRecord:
    """Return the inputs of the experiment of a folder.

    Raises:
        PlanFileError: if the folder holds no experiment, or its record is damaged.
    """
    path = folder / RECORD
    if not path.is_file():
        raise PlanFileError(f"'{folder}' holds no experiment: it has no {RECORD}")
    try:
        return read_record(path, ExperimentRecord).asked
    except ProblemError as error:  # for example an invalid setting
        raise PlanFileError(f"'{path}' is not a record that linkplan wrote: {error}") from error
