"""A motion by a few Newton steps from the last plan, with error bounds, for replanning at the rate of control."""

from dataclasses import dataclass

import numpy as np

from linkplan.planner.closed_chain.transcribe import trajectory_of
from linkplan.planner.motion_table import MotionTable, sample_motion
from linkplan.planner.problem.problem import Problem
from linkplan.planner.solvers.newton import NewtonStep
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class NextMotion:
    """A nearly optimal motion, a few Newton steps from the last one: not certified, but with bounds on its error.

    `position_bound` (n_s,) [rad or m], `velocity_bound` (n_s,) and `effort_bound` (n_u,) [N.m or N] bound the differences
    from the optimal motion on the same mesh: of positions and velocities at the mesh's nodes, and of the efforts' Bernstein
    coefficients, hence of efforts everywhere. They are infinite if no bound is known. `newton_s` is the processing time [s]
    of the steps.
    """

    problem: Problem
    trajectory: Trajectory
    position_bound: np.ndarray
    velocity_bound: np.ndarray
    effort_bound: np.ndarray
    duration_error_s: float
    violation: float
    """The largest violation of a row of the program (dynamics, loops, limits), scaled to order one."""
    newton_s: float
    settled: bool
    """Whether the Newton steps converge, so that the bounds hold; if not, call `plan`."""

    @property
    def duration_s(self) -> float:
        """The duration of the motion [s]."""
        return self.trajectory.duration_s

    @property
    def position_error(self) -> dict[str, float]:
        """A bound, by independent joint, on the error [deg or m] of positions at nodes from the optimum on this mesh."""
        joints = self.problem.mechanism.independent_joints
        return {j.name: float(j.shown(x)) for j, x in zip(joints, self.position_bound, strict=True)}

    @property
    def effort_error(self) -> dict[str, float]:
        """A bound, by actuator, on the error [N.m or N] of the effort at any instant from the optimum on this mesh."""
        actuators = self.problem.mechanism.actuators
        return {a.name: float(x) for a, x in zip(actuators, self.effort_bound, strict=True)}

    def sample(self, time_s: float | np.ndarray | None = None) -> MotionTable:
        """Return the motion at times (n,) or a time [s], like `Plan.sample`; by default at ten instants of every interval.

        Raises:
            LinkplanError: if the loops do not close along the motion, or a time is not finite.
        """
        return sample_motion(self.problem, self.trajectory, time_s)

    def __repr__(self) -> str:
        joint, error = next(iter(self.position_error.items()))
        return f"NextMotion({self.problem.name!r}, {self.duration_s:.6g} s, {joint} within {error:.2g})"


def motion_step(problem: Problem, numbered: Transcribed, found: NewtonStep, newton_s: float) -> NextMotion:
    """Return a Newton step of a problem's program as a motion, with error bounds in SI units."""
    units, n_s, error = numbered.units, numbered.formulation.n_s, found.error_bound
    return NextMotion(
        problem=problem,
        trajectory=trajectory_of(numbered, found.optimum.x, problem.limits.effort),
        position_bound=error * units.state[:n_s],
        velocity_bound=error * units.state[n_s : 2 * n_s],
        effort_bound=error * units.effort,
        duration_error_s=error * units.time_s * numbered.program.layout.n_segments,
        violation=found.violation,
        newton_s=newton_s,
        settled=bool(error < 0.1),  # scaled unknowns are of order one
    )
