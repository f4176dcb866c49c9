"""An experiment carried out: blocks in this process or on a pool of processes, their parts written as they come."""

import concurrent.futures
import functools
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from linkplan.models.errors import LinkplanError
from linkplan.models.interrupts import check
from linkplan.planner.files.plan_folder import read_plan
from linkplan.planner.plan import Plan
from linkplan.studies.experiment.block import block_count, run_block, samples_of
from linkplan.studies.experiment.experiment import Experiment, Settings, experiment_of
from linkplan.studies.experiment.parts import PLAN, done, keep_plan, write_part

Say = Callable[[str], None]
# Processes that die again and again are no accident.
_MOST_DEATHS = 3


def conduct(
    folder: Path,
    settings: Settings,
    plan: Callable[[], Plan],
    workers: int,
    threads: int,
    say: Say,
    batch: int | None = None,
) -> Experiment:
    """Run the blocks of an experiment that are not done yet, and return it.

    Args:
        folder: of parts, held by this process.
        settings: of the experiment.
        plan: makes the plan, where the folder has none yet.
        workers: processes; 1 for this one.
        threads: of the simulator in each; 0 for an equal share of the cores.
        say: is told what is done, and what is left.
        batch: simulations stepped together, at the most.

    Raises:
        LinkplanError: when a worker process dies again and again.
        OSError: when the disk refuses a part.
    """
    if not (folder / PLAN).is_dir():
        keep_plan(folder, plan())
    experiment = opened(folder, settings)
    threads = threads or max(1, (os.cpu_count() or 1) // workers)
    blocks = block_count(experiment.n)
    there = done(folder)
    todo = [block for block in range(blocks) if block not in there]
    if there and todo:
        say(f"{_samples(there, experiment.n)} of {experiment.n} samples are done already")
    begin, ran = time.monotonic(), 0
    for block, columns in _results(folder, settings, experiment, todo, workers, threads, batch, say):
        write_part(folder, block, columns)
        there.add(block)
        ran += len(samples_of(block, experiment.n))
        left = experiment.n - _samples(there, experiment.n)
        about = f", about {_span((time.monotonic() - begin) / ran * left)} left" if left else ""
        say(f"{experiment.n - left} of {experiment.n} samples{about}")
    return experiment


def opened(folder: Path, settings: Settings) -> Experiment:
    """Return the experiment of a folder's plan: every process reads the same file."""
    return experiment_of(read_plan(folder / PLAN, anyway=True), settings)


_opened_once = functools.lru_cache(maxsize=1)(opened)  # in a worker, whose folder stays the same


def _results(
    folder: Path,
    settings: Settings,
    experiment: Experiment,
    todo: list[int],
    workers: int,
    threads: int,
    batch: int | None,
    say: Say,
) -> Iterator[tuple[int, Mapping[str, list]]]:
    """Yield blocks with their results as they come."""
    if workers == 1 or len(todo) < 2:
        for block in todo:
            check()
            yield block, run_block(experiment, block, threads, batch)
        return
    left, deaths = list(todo), 0
    while left:
        try:
            for block, columns in _pooled(folder, settings, left, workers, threads, batch):
                left.remove(block)
                yield block, columns
        except BrokenProcessPool as error:
            deaths += 1
            if deaths > _MOST_DEATHS:
                raise LinkplanError(
                    f"worker processes were killed {deaths} times; what is done is kept, and the same command goes on"
                    " from it"
                ) from error
            say("a worker process was killed; what it was at is run again")


def _pooled(
    folder: Path, settings: Settings, blocks: list[int], workers: int, threads: int, batch: int | None
) -> Iterator[tuple[int, Mapping[str, list]]]:
    """Yield blocks with their results from a pool of processes, each begun anew: nothing is shared with this one."""
    pool = concurrent.futures.ProcessPoolExecutor(
        max_workers=min(workers, len(blocks)), mp_context=multiprocessing.get_context("spawn"), initializer=_begin
    )
    try:
        asked = {pool.submit(_work, folder, settings, block, threads, batch): block for block in blocks}
        waiting = set(asked)
        while waiting:
            check()
            ready, waiting = concurrent.futures.wait(waiting, timeout=0.5, return_when="FIRST_COMPLETED")
            for future in sorted(ready, key=lambda future: asked[future]):
                yield asked[future], future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _begin() -> None:
    """Let a worker leave interrupts to its parent, and end when that is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault("MUJOCO_GL", "disable")
    parent = multiprocessing.parent_process()
    if parent is not None:

        def follow() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()


def _work(folder: Path, settings: Settings, block: int, threads: int, batch: int | None) -> dict[str, list]:
    return run_block(_opened_once(folder, settings), block, threads, batch)


def _samples(blocks: set[int], n: int) -> int:
    return sum(len(samples_of(block, n)) for block in blocks)


def _span(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
