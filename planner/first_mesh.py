"""The first mesh of a problem: as fine as it asks for, and fine enough for the swings of a start."""

import numpy as np

from planner.guess import Guess
from planner.mesh import Mesh, broken, segmented, uniform
from planner.problem import PlanningProblem

# Intervals that each swing of a start is given at least.
PER_LEG = 40


def first_mesh(problem: PlanningProblem, guess: Guess, n_intervals: int | None = None) -> tuple[Mesh, np.ndarray]:
    """Return the first mesh of a problem and its segments' durations [s] in a guess."""
    n = n_intervals or max(problem.mesh.intervals, PER_LEG * guess.legs if guess.legs > 1 else 0)
    if guess.knots_s is not None:
        durations = np.diff(guess.knots_s)
        return segmented(durations, n, leg=np.arange(len(durations))), durations
    if problem.mesh.breaks is not None and n_intervals is None:
        return broken(problem.mesh.breaks), np.array([guess.duration_s])
    return uniform(n), np.array([guess.duration_s])
