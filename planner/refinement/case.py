"""What is refined, and one solve of it.

What is planned for stands behind `Case`: a mechanism's problem and a user's differential equation are refined by the
same code.
"""

from typing import Any, NamedTuple, Protocol

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.planner.problem.planning_problem import MeshSettings, SolverSettings
from linkplan.planner.refinement.history import Say, Step, step_of
from linkplan.planner.solvers.solve import Solution, solve
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Mesh


class Case(Protocol):
    """A problem as refinement sees it. Motions, starts and certificates are its own."""

    mesh: MeshSettings
    solver: SolverSettings
    effort_limit: np.ndarray  # (n_u, 2)
    switches: bool  # whether efforts may jump between their limits: cuts are then looked for
    bangs: bool  # whether they are at their limits wherever no other limit binds: such arcs may be as short as may be
    ramps: bool  # whether efforts pass from one limit to the other without a jump, be it in less than an interval
    tolerance_given: bool  # whether the user asked for a tolerance
    objective_tolerance: float | None  # on the objective's change from mesh to mesh, relative

    def transcribe(self, start: Any, mesh: Mesh, durations: np.ndarray, **options: Any) -> Transcribed:
        """Return the program from a start; options are position_rows, pinned, held and least_limit."""
        ...

    def motion(self, solution: Solution, limit: np.ndarray) -> Any | None:
        """Return the motion of a solution, efforts cut at `limit`; None where it is none."""
        ...

    def start_from(self, motion: Any) -> Any:
        """Return a motion as a start."""
        ...

    def certify(self, motion: Any) -> Any | None:
        """Return a motion's certificate: passed, growth, residual_share; None where it has none."""
        ...

    def strictness(self) -> float:
        """Return how many times more exact than a certificate demands the integrated state is to be."""
        ...

    def exact(self, certificate: Any) -> bool:
        """Return whether a certificate's integration error is within the tolerance."""
        ...

    def noted(self, step: Step, certificate: Any) -> Step:
        """Return a step with the certificate's error in it."""
        ...

    def leaves_positions(self, certificate: Any) -> bool:
        """Return whether states leave their bounds between the nodes."""
        ...

    def overruns(self, certificate: Any) -> bool:
        """Return whether a limit is left between the nodes that tightening mends."""
        ...

    def mendable(self, certificate: Any) -> bool:
        """Return whether another mesh may mend why a certificate does not pass."""
        ...

    def overrun(self, certificate: Any) -> np.ndarray:
        """Return by what share of themselves limits are overrun between the nodes, at most, on each interval (n,)."""
        ...

    def tightened(self, certificate: Any, motion: Any) -> "Case":
        """Return the case with limits drawn in by what a motion overran them."""
        ...

    def with_scheme(self, name: str) -> "Case":
        """Return the case with another transcription."""
        ...


class Found(NamedTuple):
    """A motion and its solution."""

    motion: Any
    solution: Solution

    @property
    def mesh(self) -> Mesh:
        """The mesh of the solve."""
        return self.solution.transcribed.program.mesh


def attempt(
    case: Case,
    start: Any,
    mesh: Mesh,
    durations: np.ndarray,
    what: str,
    history: list[Step],
    say: Say,
    *,
    warm: bool = False,
    close: bool = False,
    **options: Any,
) -> Found | None:
    """Return the motion and solution of one solve, noted in the history; None where it found none.

    The solver begins as in `linkplan.planner.solvers.solve.build_solver`; options are those of `Case.transcribe`.
    """
    say(f"{what}: {case.mesh.scheme}, {mesh.n_intervals} intervals, {mesh.n_segments} segment(s)")
    try:
        transcribed = case.transcribe(start, mesh, durations, **options)
    except AssemblyError:  # a start whose loops open between the instants at which it was looked at
        return None
    solution = solve(transcribed, case.solver, warm=warm, close=close)
    history.append(step_of(what, transcribed, solution))
    if not solution.converged:
        return None
    motion = case.motion(solution, case.effort_limit)
    return None if motion is None else Found(motion, solution)
