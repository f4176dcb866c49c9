"""What the parts of `make bench` share: medians of wall times, a first solve, words of progress."""

import contextlib
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.transcribe import transcribe
from linkplan.planner.problem.problem import Problem
from linkplan.planner.solvers.solve import Solution, solve
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import uniform

REPEATS = 5
# Ends of the knee's reaches [rad], and the exact least time between them with the shank [s] (tests/data/knee.json).
START, GOAL = np.radians([-49.07, 56.27])
EXACT_TIME = {"knee-sprint": 0.12185126841421788}


def say(text: str) -> None:
    """Print a line of progress to stderr."""
    print(f"bench: {text}", file=sys.stderr, flush=True)


def median_s(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the median processor time [s] of `work` after one run to warm up.

    All is on one thread (OMP_NUM_THREADS=1): the wall's time on a quiet machine, and not the neighbours' on a shared one.
    """
    work()
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return statistics.median(times)


def medians_s(works: Mapping[str, Callable[[], object]], repeats: int = REPEATS) -> dict[str, float]:
    """Return the median processor time [s] of each of several works that are done in turn, after one run to warm up.

    In turn, since a shared machine's clock and caches change within a run: what slows one down slows them all.
    """
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats + 1):
        for name, work in works.items():
            begin = time.process_time()
            work()
            times[name].append(time.process_time() - begin)
    return {name: statistics.median(taken[1:]) for name, taken in times.items()}


def over(value: float, exact: float | None) -> float | None:
    """Return how far a value is beyond the exact one, relative; None where none is known."""
    return None if exact is None else value / exact - 1


def first_program(problem: Problem) -> Transcribed:
    """Return the program of a problem on its first mesh."""
    guess = first_guess(problem, problem.start_pose())
    return transcribe(problem, guess, uniform(problem.mesh.intervals), np.array([guess.duration_s]))


def first_solve(problem: Problem) -> Solution:
    """Transcribe a problem on its first mesh and solve it once: what the peer does too."""
    return solve(first_program(problem), problem.solver)


@contextlib.contextmanager
def own_cache() -> Iterator[str]:
    """Keep compiled functions in a folder of their own, empty at first: what is in the user's does not count."""
    before = os.environ.get("LINKPLAN_CACHE")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["LINKPLAN_CACHE"] = folder
        try:
            yield folder
        finally:
            if before is None:
                del os.environ["LINKPLAN_CACHE"]
            else:
                os.environ["LINKPLAN_CACHE"] = before
