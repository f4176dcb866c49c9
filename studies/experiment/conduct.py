"""The execution of an experiment: an engine runs its blocks, and each block's results are written when they arrive."""

import contextlib
import functools
import hashlib
import socket
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from linkplan.models.errors import LinkplanError, PlanFileError
from linkplan.models.reading import MAX_FILE_BYTES, read_file
from linkplan.planner.plan import Plan
from linkplan.planner.plan_folder import read_plan
from linkplan.studies.compare.tracker_source import refuse_other_sources
from linkplan.studies.compare.user_tracker import TrackerLike
from linkplan.studies.experiment.block import block_count, run_block, samples_of
from linkplan.studies.experiment.experiment import Experiment, Settings, experiment_of
from linkplan.studies.experiment.laws import unbatched_notes
from linkplan.studies.experiment.parts import keep_plan, write_part
from linkplan.studies.tasks.engine import Engine, Say
from linkplan.studies.tasks.progress import Progress
from linkplan.studies.tasks.streaming import streamed
from linkplan.studies.tasks.unfinished import PLAN, done


def conduct(
    folder: Path,
    settings: Settings,
    sources: Mapping[str, str],
    own: Mapping[str, TrackerLike],
    plan: Callable[[], Plan],
    engine: Engine,
    say: Say,
    threads: int = 0,
    batch: int | None = None,
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
        batch: most simulations stepped together.

    Raises:
        LinkplanError: if workers fail repeatedly.
        OSError: if a part cannot be written.
    """
    if not (folder / PLAN).is_dir():
        keep_plan(folder, plan())
    folder = folder.resolve()
    written = _hash_of(folder / PLAN)
    experiment = replace(_opened(folder, settings, written), own=own)
    for line in unbatched_notes(experiment):
        say(line)
    there = done(folder)
    progress = Progress(experiment.n, sum(len(samples_of(block, experiment)) for block in there), "samples", say)
    work = functools.partial(_work, folder, settings, written, sources, own, threads, batch)
    todo = [block for block in range(block_count(experiment)) if block not in there]
    with contextlib.closing(streamed(engine, work, todo, say)) as results:
        for block, columns in results:
            write_part(folder, block, columns, experiment)
            progress.more(len(samples_of(block, experiment)))
    return experiment


@functools.lru_cache(maxsize=1)
def _opened(folder: Path, settings: Settings, written: str) -> Experiment:
    """Return the experiment of a folder's plan. It is cached by the hash of the plan's files."""
    del written
    return experiment_of(read_plan(folder / PLAN, anyway=True), settings)


def _hash_of(folder: Path) -> str:
    digest = hashlib.sha256()
    for name in ("plan.json", "trajectory.npz"):
        digest.update(read_file(folder / name, f"'{folder / name}'", MAX_FILE_BYTES, PlanFileError))
    return digest.hexdigest()


def _work(
    folder: Path,
    settings: Settings,
    written: str,
    sources: Mapping[str, str],
    own: Mapping[str, TrackerLike],
    threads: int,
    batch: int | None,
    block: int,
    share: int,
) -> dict[str, list]:
    """Return a block's columns; runs in any worker process."""
    if not (folder / PLAN).is_dir():
        raise LinkplanError(
            f"a worker on {socket.gethostname()} does not see '{folder}': all workers must share the disk of the results"
        )
    refuse_other_sources(sources)
    return run_block(replace(_opened(folder, settings, written), own=own), block, threads or share, batch)
