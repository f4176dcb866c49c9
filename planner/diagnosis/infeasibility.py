"""The sentences on what a motion would need: the limit, the joint or actuator, the instant, the amount."""

import numpy as np

from linkplan.planner.closed_chain.guess import Guess
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.search.least_limit import LeastLimit

# Samples of a motion, and the share of its duration next to its ends at which it is at rest of itself.
_SAMPLES, _BESIDE_ENDS = 2001, 0.02


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


def share_sentence(problem: PlanningProblem, factor: float, motion: Guess, *, at_all: bool) -> str:
    """Return the sentence on the factor that efforts are short by, with the phase plane's motion at that factor.

    Args:
        problem: of one degree of freedom.
        factor: on the limits of all efforts.
        motion: with that factor.
        at_all: whether no motion keeps the limits in any time; then the instant is named at which this one all but rests.
    """
    (joint,) = problem.mechanism.independent_joints
    time = np.linspace(0.0, motion.duration_s, _SAMPLES)[1:-1]
    speed, ends = np.abs(motion.velocity(time)[:, 0]), _BESIDE_ENDS * motion.duration_s
    inside = (time > ends) & (time < motion.duration_s - ends)
    # Where it turns it rests, but that is its choice: the pose that it barely passes is one on the way through.
    passing = inside & (np.gradient(np.sign(motion.velocity(time)[:, 0])) == 0)
    at = int(np.argmin(np.where(passing if passing.any() else inside, speed, np.inf)))
    place = joint.shown(float(motion.position(time[at : at + 1])[0, 0]))
    if problem.mechanism.n_u == 1 and motion.effort is not None:
        actuator, needed = problem.mechanism.actuators[0], float(motion.effort(time[at : at + 1])[0, 0])
        said = f"{actuator.name} on {actuator.target} would have to give {needed:.4g} {actuator.unit}"
        said += f", {factor:.4g} times its limit of {needed / factor:.4g}"
    else:
        said = f"all efforts would have to be {factor:.4g} times their limits"
    if not at_all:
        return f"by the phase plane {said}, throughout"
    return (
        f"by the phase plane no motion leads there in any time: {said}, to pass {joint.name} = {place:.4g} {joint.unit}"
        f" at t = {time[at]:.3g} s"
    )
