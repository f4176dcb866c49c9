"""What a planned motion does, by a second route: its effort's rate, its pin's force in MuJoCo, its actuators' power."""

import numpy as np

from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.samples import actuator_speeds
from linkplan.planner.plan.plan import Plan
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
