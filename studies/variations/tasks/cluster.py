"""The engine of a Dask cluster, given by its scheduler's address. Dask is loaded when the engine is opened.

Dask itself repeats the tasks of a killed worker on another worker.
"""

import contextlib
import gc
import logging
import sys
from collections.abc import Iterator
from concurrent.futures import CancelledError

from linkplan.models.errors import LinkplanError, ProblemError, one_line
from linkplan.models.extras import load_extra
from linkplan.planner.plan.folder import versions
from linkplan.planner.problem.settings import whole
from linkplan.studies.variations.tasks.engine import MOST_WORKERS, Engine, Pool, Say, processes

# A running scheduler answers within milliseconds.
_PATIENCE_S = 10


def engine_of(workers: int, address: str | None) -> Engine:
    """Return the engine of a number of processes on this machine or, if its address is given, of a cluster.

    Raises:
        ProblemError: for an invalid number of processes, or if an address and more than one process are given.
    """
    whole(workers, "workers", 1, MOST_WORKERS)
    if address is None:
        return processes(workers)
    if workers != 1:
        raise ProblemError(
            f"workers are processes on this machine, but a cluster has its own workers; got workers={workers} too"
        )
    return cluster(address)


def cluster(address: str) -> Engine:
    """Return the engine of the cluster whose scheduler is at an address, such as tcp://head:8786.

    Raises:
        MissingPackageError: if Dask is not installed.
    """
    distributed = load_extra("distributed", "a cluster")

    @contextlib.contextmanager
    def opened(n: int, say: Say) -> Iterator[Pool]:
        del n
        with _quiet("distributed"), contextlib.ExitStack() as stack:
            client = _client(distributed, address)
            stack.callback(client.close)
            workers = client.scheduler_info(n_workers=-1)["workers"]
            if not workers:
                say(f"the cluster at {address} has no workers yet: waiting for one")
            try:
                client.run(versions)
            except Exception as error:  # a worker without linkplan can raise any error
                raise LinkplanError(
                    f"workers at {address} cannot run linkplan: {type(error).__name__}: {one_line(error)}"
                ) from error
            executor = client.get_executor(pure=False)
            stack.callback(executor.shutdown, wait=False)
            threads = min((worker["nthreads"] for worker in workers.values()), default=1)
            # All tasks are submitted at once, because a cluster may grow. Tasks are cancelled if the scheduler ends.
            lost = (distributed.KilledWorker, CancelledError)
            yield Pool(executor=executor, ahead=sys.maxsize, threads=threads, lost=lost)

    return opened


def _client(distributed, address: str):
    try:
        return distributed.Client(address, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = one_line(error)[:200]
    # An unconnected client closes itself when it is garbage-collected. If this happened in the thread of the next client's
    # loop while that client starts, both would wait for the same lock.
    gc.collect()
    raise LinkplanError(f"no Dask scheduler answers at '{address}' ({reason}); an address is like tcp://head:8786")


@contextlib.contextmanager
def _quiet(name: str) -> Iterator[None]:
    """Keep a library's log off stderr: errors are reported in one line instead."""
    names = [other for other in logging.root.manager.loggerDict if other == name or other.startswith(f"{name}.")]
    before = [(logger, logger.level) for logger in map(logging.getLogger, (name, *names))]
    for logger, _ in before:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in before:
            logger.setLevel(level)
