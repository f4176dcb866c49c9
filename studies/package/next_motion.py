"""`NextMotion`: the result of `Planner.step`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkplan.paths import times_of
from linkplan.planner import plan as planned
from linkplan.planner.motion_step import MotionStep
from linkplan.planner.motion_table import MotionTable, motion_table
from linkplan.planner.problem.problem import Problem


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class NextMotion:
    """A nearly optimal motion, a few Newton steps from the last one: not certified, but with bounds on its error."""

    problem: Problem
    step: MotionStep

    @property
    def settled(self) -> bool:
        """Whether the Newton steps converge, so that the bounds hold; if not, call `plan`."""
        return self.step.settled

    @property
    def duration_s(self) -> float:
        """The duration of the motion [s]."""
        return self.step.trajectory.duration_s

    @property
    def violation(self) -> float:
        """The largest violation of a row of the program (dynamics, loops, limits), scaled to order one."""
        return self.step.violation

    @property
    def position_error(self) -> dict[str, float]:
        """A bound, by independent joint, on the error [deg or m] of positions at nodes from the optimum on this mesh."""
        joints = self.problem.mechanism.independent_joints
        return {j.name: float(j.shown(x)) for j, x in zip(joints, self.step.position_error, strict=True)}

    @property
    def effort_error(self) -> dict[str, float]:
        """A bound, by actuator, on the error [N.m or N] of the effort at any instant from the optimum on this mesh."""
        actuators = self.problem.mechanism.actuators
        return {a.name: float(x) for a, x in zip(actuators, self.step.effort_error, strict=True)}

    def sample(self, time_s: float | np.ndarray | None = None) -> MotionTable:
        """Return the motion at times (n,) or a time [s], like `Plan.sample`; by default at ten instants of every interval.

        Raises:
            LinkplanError: if the loops do not close along the motion, or a time is not finite.
        """
        time = times_of(time_s)
        motion = planned.Plan(
            problem=self.problem, status="failed", message="not certified", trajectory=self.step.trajectory
        )
        table = motion_table(motion, None if time is None else np.atleast_1d(time))
        return table.single() if time is not None and time.ndim == 0 else table

    def __repr__(self) -> str:
        joint, error = next(iter(self.position_error.items()))
        return f"NextMotion({self.problem.name!r}, {self.duration_s:.6g} s, {joint} within {error:.2g})"
