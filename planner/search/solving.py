"""One solve of a mechanism's problem from a guess: what every rung begins with."""

from typing import Any

import numpy as np

from linkplan.planner.closed_chain.case import case_of, held_arcs_of
from linkplan.planner.closed_chain.guess import closes
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.transcription.mesh import Mesh

__all__ = ["Iterate", "solve_from"]


def solve_from(
    problem: Problem,
    guess: Any,  # a `Guess`: the case's own starts
    mesh: Mesh,
    durations: np.ndarray,
    what: str,
    *,
    warm: bool = False,
    bang_efforts: np.ndarray | None = None,
) -> Iterate | None:
    """Solve a problem once and return the iterate; None without a motion. `attempt` describes the arguments.

    A guess along which the loops do not close leads to none. Arcs along limits on power and pin force are held.
    """
    if not closes(problem, guess):
        return None
    fixed = None if guess.power_arcs is None else held_arcs_of(problem, guess)
    return attempt(case_of(problem), guess, mesh, durations, what, warm=warm, bang_efforts=bang_efforts, fixed=fixed)
