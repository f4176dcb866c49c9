"""One solve of a mechanism's problem from a guess: what every rung begins with."""

from typing import Any

import numpy as np

from linkplan.planner.closed_chain.case import case_of, held_arcs_of
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.transcription.mesh import Mesh

__all__ = ["Iterate", "solve_from"]


def solve_from(
    problem: PlanningProblem,
    guess: Any,  # a `Guess`: the case's own starts
    mesh: Mesh,
    durations: np.ndarray,
    what: str,
    *,
    warm: bool = False,
    bang_efforts: np.ndarray | None = None,
) -> Iterate | None:
    """Return what one solve of a problem leads to; None where it finds no motion. Arguments as of `attempt`.

    The arcs of a guess along limits on power and pin force are held.
    """
    fixed = None if guess.power_arcs is None else held_arcs_of(problem, guess)
    return attempt(case_of(problem), guess, mesh, durations, what, warm=warm, bang_efforts=bang_efforts, fixed=fixed)
