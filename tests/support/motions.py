"""What a planned motion does, by a second route: its effort's rate, its pin's force in MuJoCo, its actuators' power."""

import numpy as np

from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.samples import actuator_speeds
from linkplan.planner.plan.plan import Plan
from linkplan.planner.trajectory import Trajectory
from tests.support.mechanisms import simulated


def effort_rate(plan: Plan, time: np.ndarray) -> np.ndarray:
    """Return u' (n, n_u) inside the intervals, from the Bernstein coefficients' differences."""
    effort, breaks = plan.trajectory.effort, plan.trajectory.breaks_s
    degree = len(effort) - 1
    index = np.searchsorted(breaks, time, side="right") - 1
    widths = np.diff(breaks)[index]
    tau = (time - breaks[index]) / widths
    points = degree * np.diff(effort, axis=0)[:, index] / widths[:, None]
    while len(points) > 1:
        points = points[:-1] + tau[:, None] * np.diff(points, axis=0)
    return points[0]


def pin_forces(plan: Plan, time: np.ndarray) -> np.ndarray:
    """Return the size (n,) [N] of the knee's pin force by MuJoCo: of its stiff constraint, driven as planned."""
    problem, motion = plan.problem, plan.trajectory
    mechanism = problem.mechanism
    poses = follow(mechanism, motion.position_at(time), motion.start_pose)
    speeds = motion.velocity_at(time)
    efforts = motion.effort_at(time)
    found = []
    for q, v, u in zip(poses, speeds, efforts, strict=True):
        rates = np.array(mechanism.dynamics.velocity_map(q)) @ v
        found.append(np.linalg.norm(simulated(mechanism.model, q, rates, u).row_force))
    return np.array(found)


def power(plan: Plan, time: np.ndarray) -> np.ndarray:
    """Return the actuators' mechanical power (n, n_u) [W]."""
    motion = plan.trajectory
    poses = follow(plan.problem.mechanism, motion.position_at(time), motion.start_pose)
    return motion.effort_at(time) * actuator_speeds(plan.problem, poses, motion.velocity_at(time))


def motion_along(breaks_s, position, *, velocity=None, effort=0.0, start_pose=None, periodic: bool = False) -> Trajectory:
    """Return a motion by the Bernstein coefficients (degree + 1, n) or (degree + 1, n, n_s) of its positions.

    Without others, its velocity is the derivative, its pose at the start the first position. One number is the effort of
    as many actuators as coordinates; other efforts are coefficients (degree + 1, n) or (degree + 1, n, n_u).
    """
    n = len(breaks_s) - 1
    position = np.array(position, dtype=float).reshape(len(position), n, -1)
    slope = (len(position) - 1) * np.diff(position, axis=0) / np.diff(breaks_s)[:, None]
    effort = np.array(effort) if np.ndim(effort) else np.full((1, n, position.shape[2]), effort)
    return Trajectory(
        breaks_s=np.array(breaks_s, dtype=float),
        position=position,
        velocity=slope if velocity is None else np.reshape(velocity, (-1, *position.shape[1:])),
        effort=effort.reshape(len(effort), n, -1),
        start_pose=position[0, 0] if start_pose is None else np.array(start_pose, dtype=float),
        periodic=periodic,
    )
