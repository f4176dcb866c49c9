"""Sentences on the efforts that a motion would need: actuator, time and amount."""

import numpy as np

from linkplan.planner.closed_chain.guess import Guess
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.least_limit import LeastLimit


def effort_sentence(problem: Problem, least: LeastLimit) -> tuple[str, dict[str, float]]:
    """Return a sentence on the efforts that a motion would need, and its numbers."""
    limit, trajectory = problem.limits.effort, least.trajectory
    time = trajectory.dense_times(8)
    u = trajectory.effort_at(time)
    # The motion of least effort is bang-bang: name the actuator with the largest excess, at its first such time.
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


def share_sentence(problem: Problem, factor: float, motion: Guess, *, at_all: bool) -> str:
    """Return a sentence on the factor by which effort limits are too small, for the phase plane's motion at that factor.

    Args:
        problem: with one degree of freedom.
        factor: on all effort limits.
        motion: the motion with that factor.
        at_all: no motion of any duration keeps the limits; the sentence then names the pose that this one barely passes.
    """
    (joint,) = problem.mechanism.independent_joints
    time = np.linspace(0.0, motion.duration_s, 2001)[1:-1]
    # The motion rests at both ends; 2 % of the duration there are not searched.
    speed, ends = np.abs(motion.velocity(time)[:, 0]), 0.02 * motion.duration_s
    inside = (time > ends) & (time < motion.duration_s - ends)
    # The critical pose is one that the motion barely passes, not one at which it turns back.
    passing = inside & (np.gradient(np.sign(motion.velocity(time)[:, 0])) == 0)
    at = int(np.argmin(np.where(passing if passing.any() else inside, speed, np.inf)))
    place = joint.shown(float(motion.position(time[at : at + 1])[0, 0]))
    if problem.mechanism.n_u == 1 and motion.effort is not None:
        actuator, needed = problem.mechanism.actuators[0], float(motion.effort(time[at : at + 1])[0, 0])
        need = f"{actuator.name} on {actuator.target} would have to give {needed:.4g} {actuator.unit}"
        need += f", {factor:.4g} times its limit of {needed / factor:.4g}"
    else:
        need = f"all efforts would have to be {factor:.4g} times their limits"
    if not at_all:
        return f"by the phase plane {need}, throughout"
    return (
        f"by the phase plane no motion leads there in any time: {need}, to pass {joint.name} = {place:.4g} {joint.unit}"
        f" at t = {time[at]:.3g} s"
    )
