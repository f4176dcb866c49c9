"""A motion by a few Newton steps from the last plan, for replanning at the rate of control, and how far it may be off."""

from dataclasses import dataclass

import numpy as np

from linkplan.planner.closed_chain.transcribe import trajectory_of
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.solvers.newton import NewtonStep
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed

# A motion whose scaled unknowns may be off by more than this is no step towards an answer.
_SETTLED = 0.1


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MotionStep:
    """A motion close to an optimal one; it is not certified.

    `position_error` (n_s,) [rad or m], `velocity_error` (n_s,) and `effort_error` (n_u,) [N.m or N] bound how far its
    positions and velocities at the mesh's nodes and its efforts' Bernstein coefficients, and so its efforts everywhere, are
    from those of the optimal motion on the same mesh; infinite where nothing is known. `violation` is the most by which a
    scaled row of the program (dynamics, closure, limits) is overstepped. `newton_s` is the time [s] that the steps took.
    """

    trajectory: Trajectory
    position_error: np.ndarray
    velocity_error: np.ndarray
    effort_error: np.ndarray
    duration_error_s: float
    violation: float
    newton_s: float
    settled: bool


def motion_step(problem: PlanningProblem, numbered: Transcribed, found: NewtonStep, newton_s: float) -> MotionStep:
    """Return a Newton step of a problem's program as a motion, with its error bounds in SI units."""
    units, n_s, left = numbered.units, numbered.formulation.n_s, found.left
    return MotionStep(
        trajectory=trajectory_of(numbered, found.optimum.x, problem.limits.effort),
        position_error=left * units.state[:n_s],
        velocity_error=left * units.state[n_s : 2 * n_s],
        effort_error=left * units.effort,
        duration_error_s=left * units.time_s * numbered.program.layout.n_segments,
        violation=found.violation,
        newton_s=newton_s,
        settled=bool(left < _SETTLED),
    )
