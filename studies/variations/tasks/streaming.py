"""Tasks on an engine: every result once, as soon as it is available, even if workers are lost; and their progress."""

import concurrent.futures
import contextlib
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from linkplan.models.deadline import check
from linkplan.models.errors import LinkplanError
from linkplan.planner.plan.folder import versions
from linkplan.studies.variations.tasks.engine import Engine, Pool, Say
from linkplan.studies.variations.tasks.unfinished import done

# After more losses of workers, the cause is assumed to be permanent.
_MOST_DEATHS = 3
# A worker of a cluster may run tasks in several threads, which would share CasADi's functions and the working folder.
_ONE_TASK_LOCK = threading.Lock()

Result = TypeVar("Result")


def streamed(
    engine: Engine, work: Callable[[int, int], Result], tasks: Sequence[int], say: Say
) -> Generator[tuple[int, Result], None, None]:
    """Yield tasks with their results as they arrive.

    The caller closes the generator if it stops early. Closing waits for the workers, and an interrupt of that wait reaches
    the caller.

    Args:
        engine: that runs the tasks.
        work: function of a task's number and the number of the simulator's threads; pickled for other processes.
        tasks: numbers, each once.
        say: called with a line when a worker was lost.

    Raises:
        LinkplanError: if a task is refused, workers are lost repeatedly, or the engine is not available.
    """
    left, deaths = dict.fromkeys(tasks), 0
    while left:
        with engine(len(left), say) as pool:
            try:
                for task, result in _once(pool, work, list(left)):
                    del left[task]
                    yield task, result
            except pool.lost as error:
                deaths += 1
                if deaths > _MOST_DEATHS:
                    raise LinkplanError(
                        f"workers were lost {deaths} times; finished parts are kept; run the same command again to continue"
                    ) from error
                say("a worker was lost; its task runs again")


def _once(pool: Pool, work: Callable[[int, int], Result], tasks: Sequence[int]) -> Iterator[tuple[int, Result]]:
    """Yield tasks with their results from an open pool, until a worker is lost."""
    site, queue, asked = (os.getcwd(), versions()), iter(tasks), {}
    while True:
        while len(asked) < pool.ahead and (task := next(queue, None)) is not None:
            check()
            asked[pool.executor.submit(at_site, *site, work, task, pool.threads)] = task
        if not asked:
            return
        check()
        ready, _ = concurrent.futures.wait(asked, timeout=0.5, return_when="FIRST_COMPLETED")
        for future in sorted(ready, key=asked.__getitem__):
            result = future.result()
            if isinstance(result, Refused):
                raise LinkplanError(result.text)
            yield asked.pop(future), result


def blocks_of(n: int, size: int) -> list[range]:
    """Return 0 to n - 1 in blocks of `size` consecutive numbers, the last one with the rest."""
    return [range(first, min(n, first + size)) for first in range(0, n, size)]


def complete(
    folder: Path,
    tasks: Sequence[range],
    things: str,
    engine: Engine,
    work: Callable[[int, int], Result],
    write: Callable[[int, Result], None],
    say: Say,
) -> None:
    """Run the tasks of a folder of parts that have no part yet, and report the progress.

    Args:
        folder: the folder of parts, locked by this process.
        tasks: the indices of each task's items.
        things: their name.
        engine: runs the tasks.
        work: as for `streamed`.
        write: writes a task's result as its part.
        say: receives progress messages.
    """
    there = done(folder)
    progress = StreamProgress(sum(map(len, tasks)), sum(len(tasks[task]) for task in there), things, say)
    todo = [task for task in range(len(tasks)) if task not in there]
    with contextlib.closing(streamed(engine, work, todo, say)) as results:
        for task, result in results:
            write(task, result)
            progress.more(len(tasks[task]))


class StreamProgress:
    """Counts the finished of `total` things and reports them with the remaining time. Mutable: it counts."""

    def __init__(self, total: int, done: int, things: str, say: Say) -> None:
        self._total, self._done, self._things, self._say = total, done, things, say
        self._begin, self._ran = time.monotonic(), 0
        if 0 < done < total:
            say(f"{done} of {total} {things} are already finished")

    def more(self, n: int) -> None:
        """Count n more."""
        self._ran, self._done = self._ran + n, self._done + n
        left = self._total - self._done
        each = (time.monotonic() - self._begin) / self._ran
        self._say(f"{self._done} of {self._total} {self._things}{f', about {_span(each * left)} left' if left else ''}")


def _span(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 90 * 60 else f"{seconds / 3600:.1f} h"


@dataclass(frozen=True, slots=True)
class Refused:
    """The text of the error of a task, because not every error can be sent from one process to another."""

    text: str


def at_site(folder: str, expected: Mapping[str, str], work: Callable, *arguments: object) -> object:
    """Return the result of `work` in a folder, or its error as `Refused`; `expected` are the versions that it needs."""
    try:
        with _ONE_TASK_LOCK, _in_folder(folder):
            _refuse_other_versions(expected)
            return work(*arguments)
    except LinkplanError as error:
        return Refused(str(error))


def _refuse_other_versions(expected: Mapping[str, str]) -> None:
    mine = versions()
    others = [f"{name} {mine.get(name)}, here {version}" for name, version in expected.items() if mine.get(name) != version]
    if others:
        raise LinkplanError(
            f"a worker on {socket.gethostname()} has {others[0]}; install the same version there, because results could"
            " differ"
        )


@contextlib.contextmanager
def _in_folder(folder: str) -> Iterator[None]:
    """Change to a folder and import modules from it, too."""
    before = os.getcwd()
    if folder == before:
        yield
        return
    try:
        os.chdir(folder)
    except OSError as error:
        raise LinkplanError(
            f"a worker on {socket.gethostname()} does not see '{folder}': all workers share the disk that a command runs on"
        ) from error
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)
        os.chdir(before)
