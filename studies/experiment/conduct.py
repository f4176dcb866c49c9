"""An experiment carried out: its blocks on an engine, their parts written as they come."""

import contextlib
import functools
import hashlib
import socket
from collections.abc import Callable, Mapping
from pathlib import Path

from linkplan.models.errors import LinkplanError, PlanFileError
from linkplan.models.reading import read_file
from linkplan.planner.files.plan_folder import read_plan
from linkplan.planner.plan import Plan
from linkplan.studies.compare.tracker_source import refuse_other_sources
from linkplan.studies.experiment.block import block_count, run_block, samples_of
from linkplan.studies.experiment.experiment import Experiment, Settings, experiment_of
from linkplan.studies.experiment.laws import laws_said
from linkplan.studies.experiment.parts import keep_plan, write_part
from linkplan.studies.tasks.engine import Engine, Say
from linkplan.studies.tasks.progress import Progress
from linkplan.studies.tasks.streaming import streamed
from linkplan.studies.tasks.unfinished import PLAN, done

# A plan's files have less, as their own readers ask.
_MAX_BYTES = 64_000_000


def conduct(
    folder: Path,
    settings: Settings,
    sources: Mapping[str, str],
    plan: Callable[[], Plan],
    engine: Engine,
    say: Say,
    threads: int = 0,
    batch: int | None = None,
) -> Experiment:
    """Run the blocks of an experiment that are not done yet, and return it.

    Args:
        folder: of parts, held by this process.
        settings: of the experiment.
        sources: hashes of what trackers of the user's own are written in.
        plan: makes the plan, where the folder has none yet.
        engine: what runs the blocks.
        say: is told what is done, and what is left.
        threads: of the simulator for each block; 0 for the engine's own share.
        batch: simulations stepped together, at the most.

    Raises:
        LinkplanError: when workers die again and again.
        OSError: when the disk refuses a part.
    """
    if not (folder / PLAN).is_dir():
        keep_plan(folder, plan())
    folder = folder.resolve()
    written = _hash_of(folder / PLAN)
    experiment = _opened(folder, settings, written)
    for line in laws_said(experiment):
        say(line)
    there = done(folder)
    progress = Progress(experiment.n, sum(len(samples_of(block, experiment.n)) for block in there), "samples", say)
    work = functools.partial(_work, folder, settings, written, sources, threads, batch)
    todo = [block for block in range(block_count(experiment.n)) if block not in there]
    with contextlib.closing(streamed(engine, work, todo, say)) as results:
        for block, columns in results:
            write_part(folder, block, columns, experiment)
            progress.more(len(samples_of(block, experiment.n)))
    return experiment


@functools.lru_cache(maxsize=1)
def _opened(folder: Path, settings: Settings, written: str) -> Experiment:
    """Return the experiment of a folder's plan, read once: every process reads the same files, known by their hash."""
    del written
    return experiment_of(read_plan(folder / PLAN, anyway=True), settings)


def _hash_of(folder: Path) -> str:
    digest = hashlib.sha256()
    for name in ("plan.json", "trajectory.npz"):
        digest.update(read_file(folder / name, f"'{folder / name}'", _MAX_BYTES, PlanFileError))
    return digest.hexdigest()


def _work(
    folder: Path,
    settings: Settings,
    written: str,
    sources: Mapping[str, str],
    threads: int,
    batch: int | None,
    block: int,
    share: int,
) -> dict[str, list]:
    """Return a block's columns, in whatever process this is."""
    if not (folder / PLAN).is_dir():
        raise LinkplanError(
            f"a worker on {socket.gethostname()} does not see '{folder}': all workers share the disk that results go to"
        )
    refuse_other_sources(sources)
    return run_block(_opened(folder, settings, written), block, threads or share, batch)
