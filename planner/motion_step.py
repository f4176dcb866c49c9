"""A motion by a few Newton steps from the last plan, with error bounds, for replanning at the rate of control."""

from dataclasses import dataclass

import numpy as np

from linkplan.planner.closed_chain.transcribe import trajectory_of
from linkplan.planner.problem.problem import Problem
from linkplan.planner.solvers.newton import NewtonStep
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MotionStep:
    """A motion close to an optimal one; it is not certified.

    `position_error` (n_s,) [rad or m], `velocity_error` (n_s,) and `effort_error` (n_u,) [N.m or N] bound the differences
    from the optimal motion on the same mesh: of positions and velocities at the mesh's nodes, and of the efforts' Bernstein
    coefficients, hence of efforts everywhere. They are infinite if no bound is known. `violation` is the largest violation
    of a scaled row of the program (dynamics, closure, limits). `newton_s` is the processing time [s] of the steps. `settled`
    says that the errors are small enough to continue from this motion.
    """

    trajectory: Trajectory
    position_error: np.ndarray
    velocity_error: np.ndarray
    effort_error: np.ndarray
    duration_error_s: float
    violation: float
    newton_s: float
    settled: bool


def motion_step(problem: Problem, numbered: Transcribed, found: NewtonStep, newton_s: float) -> MotionStep:
    """Return a Newton step of a problem's program as a motion, with error bounds in SI units."""
    units, n_s, error = numbered.units, numbered.formulation.n_s, found.error_bound
    return MotionStep(
        trajectory=trajectory_of(numbered, found.optimum.x, problem.limits.effort),
        position_error=error * units.state[:n_s],
        velocity_error=error * units.state[n_s : 2 * n_s],
        effort_error=error * units.effort,
        duration_error_s=error * units.time_s * numbered.program.layout.n_segments,
        violation=found.violation,
        newton_s=newton_s,
        settled=bool(error < 0.1),  # scaled unknowns are of order one
    )
