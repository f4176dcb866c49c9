"""A plan's motion, sampled for the plots, the phase plane and the checklist of a page."""

from dataclasses import dataclass

import numpy as np

from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.samples import actuator_speeds, closure_forces
from linkplan.planner.plan import Plan

# A position [rad or m], a speed [per second] or an effort [N.m or N] that is never larger is zero: the rest is rounding.
LEAST_SHOWN = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Motion:
    """A plan at instants (n,) [s]; at a jump in effort there is an instant on each side.

    `position`, `velocity`, `acceleration` (n, n_s) of the independent joints [rad or m, and per second]; `pose`, `rates`
    (n, n_q) of all joints; `effort` (n, n_u) [N.m or N], `power` (n, n_u) [W]; `closure_force` (n, n_closures) [N].
    """

    time_s: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    pose: np.ndarray
    rates: np.ndarray
    effort: np.ndarray
    power: np.ndarray
    closure_force: np.ndarray


def motion_of(plan: Plan) -> Motion:
    """Return a plan's motion at instants spread over every interval: 12 steps each, but 300 to 700 steps in all.

    Raises:
        AssemblyError: if the kinematic loops do not close along the motion.
    """
    problem, trajectory = plan.problem, plan.trajectory
    n = len(trajectory.breaks_s) - 1
    steps = int(np.clip(max(12, 300 // n), 1, max(2, 700 // n)))
    time = trajectory.dense_times(steps)
    s, v, a = (at(time) for at in (trajectory.position_at, trajectory.velocity_at, trajectory.acceleration_at))
    u = trajectory.effort_at(time)
    u = np.where(np.abs(u).max(axis=0) > LEAST_SHOWN, u, 0.0)
    q = follow(problem.mechanism, s, trajectory.start_pose)
    return Motion(
        time_s=time,
        position=s,
        velocity=v,
        acceleration=a,
        pose=q,
        rates=joint_rates(problem.mechanism, q, v),
        effort=u,
        power=u * actuator_speeds(problem, q, v),
        closure_force=closure_forces(problem, q, v, a, u),
    )
