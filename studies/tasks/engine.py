"""What runs tasks: an engine opens a pool with the interface of `concurrent.futures`. This process, or processes beside it.

Another engine is one more function of this shape: of the number of tasks and of what is told the progress, to a context
with a `Pool`. No result may depend on the engine.
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
# More processes than this are a slip of the hand.
MOST_WORKERS = 1000


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Pool:
    """An executor that is open: tasks to hand it ahead of results, and the simulator's threads that each has for its own.

    `lost` are the errors of a task whose worker was killed, or went away.
    """

    executor: concurrent.futures.Executor
    ahead: int
    threads: int
    lost: tuple[type[BaseException], ...] = ()


Engine = Callable[[int, Say], AbstractContextManager[Pool]]


class _Here(concurrent.futures.Executor):
    """An executor that runs each task in this thread, at once."""

    def submit(self, fn, /, *args, **kwargs) -> concurrent.futures.Future:
        future = concurrent.futures.Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextlib.contextmanager
def here(n: int, say: Say) -> Iterator[Pool]:
    """Open this process itself: one task after the other, with all cores for the simulator's threads."""
    del n, say
    yield Pool(executor=_Here(), ahead=1, threads=os.cpu_count() or 1)


def processes(workers: int) -> Engine:
    """Return the engine of a pool of processes, each begun anew: nothing is shared with this one."""
    if workers == 1:
        return here

    @contextlib.contextmanager
    def opened(n: int, say: Say) -> Iterator[Pool]:
        if n == 1:
            with here(n, say) as pool:
                yield pool
            return
        try:
            executor = concurrent.futures.ProcessPoolExecutor(
                max_workers=min(workers, n), mp_context=multiprocessing.get_context("spawn"), initializer=_begin
            )
        except (OSError, ImportError, NotImplementedError) as error:  # some containers have no /dev/shm for their locks
            say(f"no processes beside this one can be begun ({one_line(error)}): this one does it all")
            with here(n, say) as pool:
                yield pool
            return
        try:
            threads = max(1, (os.cpu_count() or 1) // workers)
            yield Pool(executor=executor, ahead=2 * workers, threads=threads, lost=(BrokenProcessPool,))
        finally:
            executor.shutdown(wait=True, cancel_futures=True)

    return opened


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
