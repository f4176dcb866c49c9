"""Free durations: motions bounded by their guess are solved again with longer ones, unbounded ones are reported."""

from dataclasses import dataclass

import numpy as np

from linkplan.planner.closed_chain.guess import motion_of
from linkplan.planner.phase_plane.bang_bang_motions import stretched
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import Iterate
from linkplan.planner.refinement.switch_search import LONGER, bounded_by_guess
from linkplan.planner.search.rungs import Steps, followed
from linkplan.planner.search.solving import solve_from
from linkplan.planner.solvers.solve import Solution

# A duration longer than that of the phase plane's motion by this factor is long enough: the error of its grid is a
# thousandth, and a hundredth along speed limits.
GRID_ERROR_FACTOR, GRID_ERROR_FACTOR_AT_SPEED_LIMIT = 1.001, 1.01


def with_longer_durations(problem: Problem, found: Iterate) -> tuple[Iterate, str | None]:
    """Return a solution that no guessed duration holds back, and the sentence on one without end, or None."""

    def solve(at: _BoundedByGuess, longer: float) -> _BoundedByGuess | None:
        if at.unbounded is None:
            return None
        duration = min(longer, problem.motion.max_duration_s or np.inf)
        start = stretched(motion_of(at.found.motion), duration)
        shares = at.found.solution.x[at.found.solution.transcribed.program.layout.durations()]
        what = "from a longer motion"
        further = solve_from(problem, start, at.found.mesh, duration * shares / shares.sum(), what)
        if further is None:
            return None
        # The duration has no end if the objective falls to a thousandth at once.
        falls = further.solution.objective < 1e-3 * at.found.solution.objective and problem.motion.max_duration_s is None
        return _BoundedByGuess(
            found=further, unbounded=at.unbounded if falls else unbounded_duration(problem, further.solution)
        )

    begin = _BoundedByGuess(found=found, unbounded=unbounded_duration(problem, found.solution))
    duration = found.motion.duration_s
    steps = Steps(begin=duration, end=np.inf, factor=30.0, halvings=0, most=2)
    at = followed(begin, steps, solve).stages[-1]
    return at.found, at.unbounded


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _BoundedByGuess:
    """A solution, and the sentence on its free duration where that grew to the end of what its guess allows."""

    found: Iterate
    unbounded: str | None


def unbounded_duration(problem: Problem, solution: Solution) -> str | None:
    """Return the sentence on a free duration that grew to the end of what its guess allows; None elsewhere.

    That end is a hundred times the guess and not the user's: there the objective still falls, and no best motion is found.
    """
    motion, transcribed = problem.motion, solution.transcribed
    if motion.duration_s is not None or bounded_by_guess(solution, 0.0, motion.max_duration_s or np.inf) != LONGER:
        return None
    duration = float(solution.x[transcribed.program.layout.durations()].sum()) * transcribed.units.time_s
    what = problem.objective.name.replace("_", " ")
    without = f"failed: the objective is unbounded in the duration, the longer the motion the less its {what}"
    return f"{without}: still at {duration:.4g} s; set motion.max_duration_s"


def longest(problem: Problem) -> float:
    """Return the longest that a motion may take [s]."""
    return problem.motion.duration_s or problem.motion.max_duration_s or np.inf


def may_swing(problem: Problem) -> bool:
    """True if a motion may build up energy by swings that no start has tried.

    For one degree of freedom the phase plane has tried all swings.
    """
    return problem.mechanism.dof > 1 and not np.isfinite(longest(problem))
