"""The sentences on what a motion would need: the limit, the joint or actuator, the instant, the amount."""

import numpy as np

from linkplan.models.poses.along import joint_rates
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.search.least_limit import LeastLimit
from linkplan.planner.trajectory import Trajectory


def effort_sentence(problem: PlanningProblem, least: LeastLimit) -> tuple[str, dict[str, float]]:
    """Return the sentence on efforts that a motion would need, and its figures."""
    limit, trajectory = problem.limits.effort, least.trajectory
    time = trajectory.dense_times(8)
    u = trajectory.effort_at(time)
    # The least effort is bang-bang: name the actuator that is furthest beyond its limit, at the first such instant.
    over = np.maximum(u - limit[:, 1], limit[:, 0] - u)
    column = int(np.argmax(over.max(axis=0)))
    at = int(np.flatnonzero(over[:, column] > 0.999 * over[:, column].max())[0])
    actuator = problem.mechanism.actuators[column]
    needed, bound = float(u[at, column]), float(limit[column, 1] if u[at, column] > 0 else limit[column, 0])
    sentence = (
        f"{actuator.name} on {actuator.target} would have to give"
        f" {abs(needed):.4g} {actuator.unit} at t = {time[at]:.3g} s, {abs(needed - bound):.4g} {actuator.unit} beyond its"
        f" limit of {abs(bound):.4g}"
    )
    return sentence, {"needed_effort": abs(needed), "needed_limit_factor": least.factor}


def overrun_sentence(problem: PlanningProblem, trajectory: Trajectory, poses: np.ndarray, what: str) -> str | None:
    """Return the sentence on the joint that a motion takes furthest beyond its speed limit or range, or None."""
    mechanism = problem.mechanism
    time = trajectory.dense_times(8)
    bounds = problem.limits.speed if what == "speed" else problem.limits.position
    values = joint_rates(mechanism, poses, trajectory.velocity_at(time)) if what == "speed" else poses
    over = np.maximum(values - bounds[:, 1], bounds[:, 0] - values)
    joint_index = int(np.argmax(over.max(axis=0)))
    at = int(np.argmax(over[:, joint_index]))
    if over[at, joint_index] <= 0:
        return None
    joint = mechanism.joints[joint_index]
    unit = joint.unit + ("/s" if what == "speed" else "")
    value = values[at, joint_index]
    bound = bounds[joint_index, 1] if value > bounds[joint_index, 1] else bounds[joint_index, 0]
    verb = "move at" if what == "speed" else "reach"
    return (
        f"joint {joint.name} would have to {verb} {joint.shown(value):.4g} {unit} at t = {time[at]:.3g} s,"
        f" {abs(joint.shown(value - bound)):.4g} {unit} beyond its limit of {joint.shown(bound):.4g}"
    )
