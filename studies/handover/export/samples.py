"""A plan at instants, in the coordinates of MuJoCo and in reduced coordinates."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import accelerations, needed_controls, sampled
from linkplan.planner.plan.plan import MotionTable, Plan, motion_table

# This many keyframes take about a gigabyte.
_MAX_SAMPLES = 1_000_000


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ExportedSamples:
    """A plan's motion at instants (n,) [s] from its start.

    `q` and `rates` (n, n_q) are the positions and speeds of all coordinates [rad or m, and per second], `velocity` and
    `acceleration` (n, n_s) those of the independent ones, `effort` (n, n_u) [N.m or N] that of the actuators. `table` has
    the same values in display units.
    """

    plan: Plan
    time_s: np.ndarray
    table: MotionTable
    q: np.ndarray
    rates: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    effort: np.ndarray

    @property
    def position(self) -> np.ndarray:
        """The independent coordinates' positions (n, n_s) [rad or m]."""
        return self.q[:, self.plan.problem.mechanism.independent]

    def qpos(self) -> np.ndarray:
        """Return MuJoCo's positions (n, nq)."""
        return self.plan.problem.mechanism.qpos_of(self.q)

    def qvel(self) -> np.ndarray:
        """Return MuJoCo's velocities (n, nv)."""
        return self.plan.problem.mechanism.qvel_of(self.q, self.rates)

    def ctrl(self) -> np.ndarray:
        """Return MuJoCo's ctrl (n, nu) for the efforts, 0 for actuators that the plan does not use."""
        mechanism = self.plan.problem.mechanism
        controls = np.zeros((len(self.time_s), mechanism.model.nu))
        needed = needed_controls(mechanism, self.q, self.velocity, self.effort)
        for column, actuator in enumerate(mechanism.actuators):
            controls[:, actuator.channel] = needed[:, column]
        return controls

    def accelerations(self) -> np.ndarray:
        """Return the accelerations of all coordinates (n, n_q)."""
        return accelerations(self.plan.problem.mechanism, self.q, self.velocity, self.acceleration)

    def effort_on(self, mechanism: Mechanism, joints: Sequence[str]) -> np.ndarray:
        """Return the actuators' effort on some independent joints of a mechanism, Gamma^T B u (n, n_joints) [N.m or N]."""
        order = [joint.name for joint in mechanism.independent_joints]
        maps = sampled(mechanism.dynamics.effort_map, self.q)[:, [order.index(name) for name in joints]]
        return np.einsum("ksu,ku->ks", maps, self.effort)


def exported_samples(plan: Plan, every_s: float | None = None) -> ExportedSamples:
    """Return a plan's samples: every `every_s` seconds from its start and at its end, or ten in each interval of its mesh.

    Raises:
        ProblemError: if the time is invalid, or there would be too many samples.
    """
    mechanism, trajectory = plan.problem.mechanism, plan.trajectory
    begin, duration = float(trajectory.breaks_s[0]), trajectory.duration_s
    if every_s is not None and not (np.isfinite(every_s) and 0 < every_s <= duration):
        raise ProblemError(f"every_s must be above 0 and at most the motion's duration of {duration:.6g} s, got {every_s:g}")
    if every_s is not None and duration / every_s > _MAX_SAMPLES:
        raise ProblemError(
            f"at most {_MAX_SAMPLES} samples are written; {duration:.6g} s with every_s = {every_s:g} s would be more"
        )
    time = None
    if every_s is not None:
        # a last step below a thousandth of the others is due to rounding
        time = begin + np.append(np.arange(0.0, duration - 1e-3 * every_s, every_s), duration)
    table = motion_table(plan.problem, plan.require_motion("export"), time)
    joints = mechanism.joints

    def internal(values: dict[str, np.ndarray]) -> np.ndarray:
        return np.column_stack([joint.read(values[joint.name]) for joint in joints])

    at = table.time_s
    return ExportedSamples(
        plan=plan,
        time_s=at,
        table=table,
        q=internal(table.position_deg),
        rates=internal(table.speed_deg_s),
        velocity=trajectory.velocity_at(at),
        acceleration=trajectory.acceleration_at(at),
        effort=trajectory.effort_at(at),
    )
