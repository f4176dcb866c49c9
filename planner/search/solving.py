"""The first solve of every method, from a guess: its mesh, and free durations.

The mesh has the problem's number of intervals, or more for a guess with swings. If the guess bounds a free duration, the
motion is solved again with a longer one; an unbounded duration is reported.
"""

import itertools
from typing import Any

import numpy as np

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import Guess, closes, guess_from, stretched, with_force_times
from linkplan.planner.plan.verdict import Verdict, failed
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.refinement.switches import LONGER, bounded_by_guess
from linkplan.planner.transcription.mesh import Mesh, broken, segmented, uniform

# The smallest number of intervals for each swing of a guess.
INTERVALS_PER_SWING = 40
# A duration longer than that of the phase plane's motion by this factor is feasible: the grid's error is a thousandth, or a
# hundredth along speed limits.
GRID_ERROR_FACTOR, GRID_ERROR_FACTOR_AT_SPEED_LIMIT = 1.001, 1.01


def solve_from(
    problem: Problem,
    guess: Any,  # a `Guess`
    mesh: Mesh,
    durations: np.ndarray,
    what: str,
    *,
    warm: bool = False,
) -> Iterate | None:
    """Solve a problem once and return the iterate; None without a motion. `attempt` describes the arguments.

    It is also None if the loops do not close along the guess.
    """
    if not closes(problem, guess):
        return None
    return attempt(case_of(problem), guess, mesh, durations, what, warm=warm)


def first_mesh(problem: Problem, guess: Guess) -> tuple[Mesh, np.ndarray]:
    """Return the first mesh of a problem and its segments' durations [s] in a guess."""
    n = max(problem.mesh.intervals, INTERVALS_PER_SWING * guess.swings if guess.swings > 1 else 0)
    durations = np.array([guess.duration_s]) if guess.boundaries_s is None else np.diff(guess.boundaries_s)
    if problem.mesh.breaks is not None and guess.boundaries_s is None:
        return broken(problem.mesh.breaks), durations
    mesh = uniform(n) if guess.boundaries_s is None else segmented(durations, n, phase=np.arange(len(durations)))
    return with_force_times(problem, mesh, durations), durations


def graded_mesh(guess: Guess, switch_times_s: np.ndarray, n_intervals: int) -> tuple[Mesh, np.ndarray]:
    """Return a mesh with switch times (n_switches,) [s] within a guess's phases, and its segments' durations [s].

    The mesh is finer where the guess is fast, because near a singular pose a motion may cover half of its path in a
    hundredth of its time. Every interval has an equal share of the sum of time, path and change of speed.
    """
    boundaries = np.array([0.0, guess.duration_s]) if guess.boundaries_s is None else guess.boundaries_s
    ends = np.sort(np.concatenate([boundaries, switch_times_s]))
    # Samples of a guess at which its speed is measured.
    times = np.linspace(0.0, guess.duration_s, 4001)
    progress = np.concatenate([[0.0], np.cumsum(_pace(guess, times))])
    return _spread(times, n_intervals * progress / progress[-1], ends, boundaries)


def _pace(guess: Guess, times: np.ndarray) -> np.ndarray:
    """Return the shares (n - 1,) of a guess between its samples, in the sum of time, path and change of speed."""
    position, velocity = guess.position(times), guess.velocity(times)
    pace = np.diff(times)[:, None] / guess.duration_s
    for values in (position, velocity):
        steps = np.abs(np.diff(values, axis=0))
        pace = np.hstack([pace, steps / np.maximum(steps.sum(axis=0), np.finfo(float).tiny)])
    return pace.mean(axis=1)


def _spread(times: np.ndarray, progress: np.ndarray, ends: np.ndarray, boundaries: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """Return the mesh of segments between `ends` [s] with an interval for each unit of progress (n,) at times (n,) [s]."""
    at_ends = np.interp(ends, times, progress)
    fraction, segment = [], []
    for k, (begin, end) in enumerate(itertools.pairwise(at_ends)):
        count = max(3, int(np.round(end - begin)))  # at least three per segment, as in `segmented`
        breaks = np.interp(np.linspace(begin, end, count + 1), progress, times)
        breaks[[0, -1]] = ends[k], ends[k + 1]
        fraction.append(np.diff(breaks) / (ends[k + 1] - ends[k]))
        segment += [k] * count
    phase = np.searchsorted(boundaries, ends[:-1], side="right") - 1
    return Mesh(fraction=np.concatenate(fraction), segment=np.array(segment), phase=phase), np.diff(ends)


def with_longer_durations(problem: Problem, found: Iterate) -> tuple[Iterate, Verdict | None]:
    """Return a solution that is not bounded by the guessed duration, and the verdict on an unbounded duration, or None."""
    unbounded, longer = unbounded_duration(problem, found), found.motion.duration_s
    for _ in range(2):
        if unbounded is None:
            break
        longer *= 30.0
        duration = min(longer, problem.motion.max_duration_s or np.inf)
        start = stretched(guess_from(found.motion), duration)
        shares = found.solution.x[found.solution.transcribed.program.layout.durations()]
        further = solve_from(problem, start, found.mesh, duration * shares / shares.sum(), "from a longer motion")
        if further is None:
            break
        # If one step lowers the objective to a thousandth, it falls without limit: the duration is unbounded.
        falls = further.solution.objective < 1e-3 * found.solution.objective and problem.motion.max_duration_s is None
        found, unbounded = further, unbounded if falls else unbounded_duration(problem, further)
    return found, unbounded


def unbounded_duration(problem: Problem, found: Iterate) -> Verdict | None:
    """Return the verdict on a free duration that grew to the bound due to its guess, or None.

    This bound is a hundred times the guess and not the user's. The objective still falls there, so there is no best motion.
    """
    motion = problem.motion
    if motion.duration_s is not None or bounded_by_guess(found.solution, 0.0, motion.max_duration_s or np.inf) != LONGER:
        return None
    what = problem.objective.name.replace("_", " ")
    without = f"the objective is unbounded in the duration: the longer the motion, the smaller its {what}"
    tried = f"up to the longest motion tried, {found.motion.duration_s:.4g} s"
    return failed(f"{without}, {tried}; set motion.max_duration_s", "duration")


def longest(problem: Problem) -> float:
    """Return the largest duration of a motion [s]."""
    return problem.motion.duration_s or problem.motion.max_duration_s or np.inf


def may_swing(problem: Problem) -> bool:
    """True if a motion may build up energy by swings that no start has tried.

    For one degree of freedom the phase plane has tried all swings.
    """
    return problem.mechanism.dof > 1 and not np.isfinite(longest(problem))
