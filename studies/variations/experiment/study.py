"""A complete experiment: from a plan to a folder with results, or to a summary only."""

import functools
import hashlib
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from msgspec import structs

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.errors import LinkplanError, PlanFileError, ProblemError
from linkplan.models.extras import load_extra
from linkplan.models.reading import MAX_FILE_BYTES, read_file
from linkplan.models.work_folders import replace_file
from linkplan.planner.files.columns import Kind, read_table, schema_of
from linkplan.planner.files.folders import check_target, plain_record, write_json, write_whole
from linkplan.planner.files.manifest import read_record
from linkplan.planner.plan.folder import read_plan, write_plan
from linkplan.planner.plan.plan import Plan
from linkplan.studies.compare.tracker_source import object_hash, refuse_other_sources, source_hash
from linkplan.studies.compare.user_tracker import TrackerLike
from linkplan.studies.variations.experiment.block import run_block, sample_blocks, unbatched_notes
from linkplan.studies.variations.experiment.experiment import (
    LATIN_HYPERCUBE,
    AskedRecord,
    Experiment,
    ExperimentRecord,
    Settings,
    defaults_note,
    experiment_of,
    fall_note,
    imperfections_asked,
    replicate_of,
    request_of,
)
from linkplan.studies.variations.experiment.experiment_blocks import ExperimentOutcome
from linkplan.studies.variations.experiment.metrics import metrics_of
from linkplan.studies.variations.experiment.sensitivity import sensitivity_of
from linkplan.studies.variations.experiment.statistics import chatter_notes, summarise
from linkplan.studies.variations.tasks.engine import Engine, Say, serial
from linkplan.studies.variations.tasks.streaming import complete
from linkplan.studies.variations.tasks.unfinished import (
    PLAN,
    finish,
    part,
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


def conduct(
    folder: Path,
    settings: Settings,
    sources: Mapping[str, str],
    own: Mapping[str, TrackerLike],
    plan: Callable[[], Plan],
    engine: Engine,
    say: Say,
    threads: int = 0,
) -> Experiment:
    """Run the unfinished blocks of an experiment, and return the experiment.

    Args:
        folder: the folder of parts, locked by this process.
        settings: of the experiment.
        sources: hashes of the source files of users' trackers.
        own: trackers given as Python objects, by their names in the settings.
        plan: makes the plan if the folder has none yet.
        engine: runs the blocks.
        say: receives progress messages.
        threads: simulator threads of each block; 0 for the engine's default.

    Raises:
        LinkplanError: if workers fail repeatedly.
        OSError: if a part cannot be written.
    """
    if not (folder / PLAN).is_dir():
        made = plan()
        experiment_of(made, settings)  # checked first, so that a refused experiment leaves no folder
        write_whole(folder / PLAN, lambda place: write_plan(made, place))
    folder = folder.resolve()
    digest = hashlib.sha256()
    for place in (folder / PLAN / name for name in ("plan.json", "trajectory.npz")):
        digest.update(read_file(place, f"'{place}'", MAX_FILE_BYTES, PlanFileError))
    written = digest.hexdigest()
    experiment = replace(_opened(folder, settings, written), own=own)
    for line in unbatched_notes(experiment):
        say(line)
    work = functools.partial(_work, folder, settings, written, sources, own, threads)
    write = functools.partial(write_part, folder, experiment)
    complete(folder, sample_blocks(experiment), "samples", engine, work, write, say)
    return experiment


@functools.lru_cache(maxsize=1)
def _opened(folder: Path, settings: Settings, written: str) -> Experiment:
    """Return the experiment of a folder's plan. It is cached by the hash of the plan's files."""
    del written
    return experiment_of(read_plan(folder / PLAN, anyway=True), settings)


def _work(
    folder: Path,
    settings: Settings,
    written: str,
    sources: Mapping[str, str],
    own: Mapping[str, TrackerLike],
    threads: int,
    block: int,
    share: int,
) -> dict[str, list]:
    """Return a block's columns; runs in any worker process."""
    if not (folder / PLAN).is_dir():
        raise LinkplanError(
            f"a worker on {socket.gethostname()} does not see '{folder}': all workers must share the disk of the results"
        )
    refuse_other_sources(sources)
    return run_block(replace(_opened(folder, settings, written), own=own), block, threads or share)


def column_kinds(experiment: Experiment) -> dict[str, Kind]:
    """Return the kinds of an experiment's result columns by name, in order."""
    kinds: dict[str, Kind] = {"sample": "count", "tracker": "word", "success": "flag", "failure": "word"}
    for name in (*metrics_of(experiment.plan.problem.mechanism), *experiment.varied_values()):
        kinds[name] = "number"
    return kinds


def write_part(folder: Path, experiment: Experiment, block: int, columns: Mapping[str, list]) -> None:
    """Write a block's results as a part, completely or not at all."""
    replace_file(part(folder, block, "parquet"), lambda place: write_results(place, experiment, columns))


def write_results(path: Path, experiment: Experiment, columns: Mapping[str, Sequence | np.ndarray]) -> None:
    """Write columns of results into a file."""
    import pyarrow as pa
    import pyarrow.parquet as parquet

    parquet.write_table(pa.table(dict(columns), schema=schema_of(column_kinds(experiment))), path)


def read_parts(folder: Path, experiment: Experiment) -> dict[str, np.ndarray]:
    """Return the columns of all parts in their order.

    Raises:
        PlanFileError: if a part is damaged or belongs to another experiment.
    """
    blocks = enumerate(sample_blocks(experiment))
    parts = [read_results(part(folder, block, "parquet"), experiment, samples) for block, samples in blocks]
    return {name: np.concatenate([columns[name] for columns in parts]) for name in parts[0]}


def read_results(path: Path, experiment: Experiment, samples: range | None = None) -> dict[str, np.ndarray]:
    """Return the columns of a results file by name, as arrays (of objects for text).

    Args:
        path: the file.
        experiment: the experiment of the results.
        samples: the samples in the file; default: all.

    Raises:
        PlanFileError: if the file is damaged, or its rows do not match the experiment's samples and trackers.
    """
    samples, trackers = range(experiment.n) if samples is None else samples, experiment.settings.trackers
    results = read_table(path, column_kinds(experiment), len(samples) * len(trackers))
    wrong = _wrong_value(results, experiment, np.repeat(samples, len(trackers)))
    if wrong is not None:
        raise PlanFileError(f"'{path}' holds no results of this experiment: {wrong}")
    return results


def _wrong_value(results: Mapping[str, np.ndarray], experiment: Experiment, samples: np.ndarray) -> str | None:
    """Return a description of the first invalid value in the results of samples (n,), or None."""
    n, names = len(samples) // len(experiment.settings.trackers), np.array(experiment.settings.trackers, dtype=object)
    ran = np.array([failure is None for failure in results["failure"]], dtype=bool)
    checks: list[tuple[str, np.ndarray, str]] = [
        ("sample", results["sample"] == samples, "the experiment's samples in their order"),
        ("tracker", results["tracker"] == np.tile(names, n), f"{', '.join(names)} in turn"),
        ("success", ran | ~results["success"], "false where a run failed"),
    ]
    for name in metrics_of(experiment.plan.problem.mechanism):
        values = results[name]
        is_needed = "_error_" in name  # a completed run has all errors but may lack other metrics
        legal = (values >= 0) | (name == "energy_j") | (np.isnan(values) & ~(ran & is_needed))
        checks.append((name, legal, "a number of at least 0" if is_needed else "0, more, or none"))
    for name, values in experiment.varied_values().items():
        alike = np.isclose(results[name], values[samples], rtol=1e-9, atol=0.0)  # scipy's versions differ by rounding
        checks.append((name, alike, "the value by the experiment's seed"))
    for name, legal, what in checks:
        if not np.all(legal):
            row = int(np.argmin(legal))
            return f"column {name} is {what}; row {row} has {results[name][row]!s:.60}"
    return None
