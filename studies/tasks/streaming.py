"""Tasks on an engine: every result once, as soon as it is there, whatever becomes of single workers."""

import concurrent.futures
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import TypeVar

from linkplan.models.errors import LinkplanError
from linkplan.models.interrupts import check
from linkplan.studies.tasks.engine import Engine, Pool, Say
from linkplan.studies.tasks.site import Refused, at_site, this_site

# Workers that die again and again are no accident.
_MOST_DEATHS = 3

Result = TypeVar("Result")


def streamed(
    engine: Engine, work: Callable[[int, int], Result], tasks: Sequence[int], say: Say
) -> Generator[tuple[int, Result], None, None]:
    """Yield tasks with their results as they come.

    Whoever reads them closes the stream when it is left early: workers are waited for then, and an interrupt of that wait
    is to reach the caller.

    Args:
        engine: what runs them.
        work: of a task's number and the simulator's threads that it may take; pickled where the engine is not this process.
        tasks: numbers, each once.
        say: is told when a worker was lost.

    Raises:
        LinkplanError: when a task is refused, when workers die again and again, or the engine cannot be had.
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
                        f"workers were lost {deaths} times; what is done is kept, and the same command goes on from it"
                    ) from error
                say("a worker was lost; what it was at is run again")


def _once(pool: Pool, work: Callable[[int, int], Result], tasks: Sequence[int]) -> Iterator[tuple[int, Result]]:
    """Yield tasks with their results from an open pool, until one is lost."""
    site, queue, asked = this_site(), iter(tasks), {}
    while True:
        while len(asked) < pool.ahead and (task := next(queue, None)) is not None:
            check()
            asked[pool.executor.submit(at_site, site, work, task, pool.threads)] = task
        if not asked:
            return
        check()
        ready, _ = concurrent.futures.wait(asked, timeout=0.5, return_when="FIRST_COMPLETED")
        for future in sorted(ready, key=asked.__getitem__):
            result = future.result()
            if isinstance(result, Refused):
                raise LinkplanError(result.text)
            yield asked.pop(future), result
