"""Sentences on the efforts that a motion would need: actuator, time and amount; and durations that are far too short."""

from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.poses.along import demanded, least_effort, sampled
from linkplan.planner.closed_chain.guess import Guess, even_poses
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.ladder import Search
from linkplan.planner.search.least_limit import LeastLimit
from linkplan.planner.search.shortest import shortest_motion
from linkplan.planner.search.solving import longest

# A duration below this share of the shortest motion's is surely infeasible: least times found are local, but within
# percents.
_INFEASIBLE_DURATION_SHARE = 0.1


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
    velocity, ends = motion.velocity(time)[:, 0], 0.02 * motion.duration_s
    speed, inside = np.abs(velocity), (time > ends) & (time < motion.duration_s - ends)
    # The critical pose is one that the motion barely passes: its speed is least there, and it does not turn back.
    least = np.concatenate([[False], speed[1:-1] <= np.minimum(speed[:-2], speed[2:]), [False]])
    passing = inside & least & (np.gradient(np.sign(velocity)) == 0)
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


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PathEffort:
    """The smooth path's largest excess over an effort limit: the factor, the factor without gravity, and a sentence."""

    factor: float
    inertial_factor: float
    sentence: str


def far_too_short(search: Search) -> tuple[str, dict[str, float]] | None:
    """Return a sentence and its numbers if a reach is given only a small share of its least duration; else None.

    With one degree of freedom the phase plane gives the shortest motion at once. With more it is planned if the smooth path
    needs far larger efforts than allowed.
    """
    problem, asked = search.problem, longest(search.problem)
    motion = problem.motion
    if motion.kind != "reach" or motion.stays or not np.isfinite(asked) or not np.all(np.isfinite(problem.limits.effort)):
        return None
    if any(waypoint.time_s is not None for waypoint in motion.waypoints):
        return None
    path = path_effort(problem, search.smooth)
    # Efforts of inertia grow with the square of the pace.
    if path is None or path.inertial_factor < 1 / _INFEASIBLE_DURATION_SHARE**2:
        return None
    shortest, about = _shortest(search)
    if shortest is None or asked > _INFEASIBLE_DURATION_SHARE * shortest:
        return None
    sentence = (
        f"infeasible: {asked:.4g} s is {shortest / asked:.3g} times too short: {path.sentence};"
        f" the shortest feasible duration is {about}{shortest:.4g} s"
    )
    return sentence, {"shortest_duration_s": shortest, "smooth_path_limit_factor": path.factor}


def _shortest(search: Search) -> tuple[float | None, str]:
    """Return the least known duration [s], or None, and the word "about " if it is approximate."""
    if search.quickest is not None and search.quickest.boundaries_s is None:
        return search.quickest.duration_s, "about "
    found = shortest_motion(search)
    return (None, "") if found is None else (found.trajectory.duration_s, "")


def path_effort(problem: Problem, guess: Guess) -> PathEffort | None:
    """Return the largest effort that a path needs relative to its limit, and undriven efforts; None if loops open."""
    mechanism, limit = problem.mechanism, problem.limits.effort
    try:
        time, q = even_poses(problem, guess)
    except AssemblyError:
        return None
    v, a = guess.velocity(time), guess.acceleration(time)
    tau, maps = demanded(mechanism, q, v, a)
    effort = least_effort(tau, maps)
    missed = tau - np.einsum("ksu,ku->ks", maps, effort)
    held = least_effort(sampled(mechanism.dynamics.inverse_dynamics, q, 0 * v, 0 * a)[:, :, 0], maps)
    bound = np.where(effort > 0, limit[:, 1], limit[:, 0])
    widest = np.abs(limit).max(axis=1)  # the scale if an actuator gives nothing in the needed direction
    factors = np.abs(effort) / np.where(bound == 0, widest, np.abs(bound))
    inertial = np.abs(effort - held) / widest
    at, column = np.unravel_index(int(np.argmax(factors)), factors.shape)
    actuator = mechanism.actuators[column]
    sentence = (
        f"along the smooth path from start to goal {actuator.name} on {actuator.target} would have to give"
        f" {effort[at, column]:.4g} {actuator.unit} at t = {time[at]:.3g} s,"
    )
    if bound[at, column] == 0:
        sentence += " a direction in which it gives nothing"
    else:
        sentence += f" {factors[at, column]:.4g} times its limit of {bound[at, column]:.4g}"
    k, row = np.unravel_index(int(np.argmax(np.abs(missed))), missed.shape)
    if abs(missed[k, row]) > 1e-6 * np.abs(effort).max():
        joint = mechanism.independent_joints[row]
        sentence += (
            f", and no actuator gives the {missed[k, row]:.4g} {'N.m' if joint.kind == 'hinge' else 'N'} on {joint.name}"
        )
    return PathEffort(factor=float(factors.max()), inertial_factor=float(inertial.max()), sentence=sentence)
