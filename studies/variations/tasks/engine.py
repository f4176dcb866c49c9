"""Engines that run tasks in this process or in other processes.

An engine is a function of the number of tasks and a progress function; it returns a context with a `Pool`, which has the
interface of `concurrent.futures`. No result may depend on the engine.
"""

import concurrent.futures
import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from dataclasses import dataclass

from linkplan.models.errors import one_line

Say = Callable[[str], None]
# A larger number of processes is a typing error.
MOST_WORKERS = 1000


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Pool:
    """An open executor, the number of tasks submitted ahead of results, and the simulator's threads for each task.

    `lost` are the errors of a task whose worker was killed or disconnected.
    """

    executor: concurrent.futures.Executor
    ahead: int
    threads: int
    lost: tuple[type[BaseException], ...] = ()


Engine = Callable[[int, Say], AbstractContextManager[Pool]]


class _Here(concurrent.futures.Executor):
    """An executor that runs each task immediately in this thread."""

    def submit(self, fn, /, *args, **kwargs) -> concurrent.futures.Future:
        future = concurrent.futures.Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextlib.contextmanager
def serial(n: int, say: Say) -> Iterator[Pool]:
    """Open this process as the pool: one task after the other, with all cores for the simulator's threads."""
    del n, say
    yield Pool(executor=_Here(), ahead=1, threads=os.cpu_count() or 1)


def processes(workers: int) -> Engine:
    """Return the engine of a pool of newly started processes, which share nothing with this process."""
    if workers == 1:
        return serial

    @contextlib.contextmanager
    def opened(n: int, say: Say) -> Iterator[Pool]:
        if n == 1:
            with serial(n, say) as pool:
                yield pool
            return
        try:
            executor = concurrent.futures.ProcessPoolExecutor(
                max_workers=min(workers, n), mp_context=multiprocessing.get_context("spawn"), initializer=_begin
            )
        except (OSError, ImportError, NotImplementedError) as error:  # some containers have no /dev/shm for locks
            say(f"cannot start other processes ({one_line(error)}): this process runs all tasks")
            with serial(n, say) as pool:
                yield pool
            return
        try:
            threads = max(1, (os.cpu_count() or 1) // workers)
            yield Pool(executor=executor, ahead=2 * workers, threads=threads, lost=(BrokenProcessPool,))
        finally:
            executor.shutdown(wait=True, cancel_futures=True)

    return opened


def _begin() -> None:
    """Make a worker ignore interrupts, which its parent handles, and end with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault("MUJOCO_GL", "disable")
    parent = multiprocessing.parent_process()
    if parent is not None:

        def follow() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()
