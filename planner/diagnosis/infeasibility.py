"""Why there is no motion: the limit, the joint, the time, the amount; and what would make one possible."""

from dataclasses import dataclass

import numpy as np

from linkplan.models.poses.along import joint_rates
from linkplan.planner.closed_chain.guess import Guess, motion_of
from linkplan.planner.closed_chain.transcribe import trajectory_of, transcribe
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.history import Step, step_of
from linkplan.planner.refinement.switch_search import NO_WORSE, cut_mesh
from linkplan.planner.refinement.switches import find_cuts, pinned_efforts
from linkplan.planner.solvers.solve import solve
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.mesh import Mesh


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LeastLimit:
    """The smallest common factor on the effort limits with which a problem has a motion, that motion, and its mesh."""

    factor: float
    trajectory: Trajectory
    mesh: Mesh
    durations: np.ndarray  # (n_segments,) [s]


def least_limit(
    problem: PlanningProblem, guess: Guess, mesh: Mesh, durations: np.ndarray, history: list[Step]
) -> LeastLimit | None:
    """Return the least factor on the effort limits that admits a motion, or None where none was found.

    Solved twice: on the mesh as given, then with cuts at the switches that it showed, where the factor is exact.
    """
    limit = problem.limits.effort
    if not np.all(np.isfinite(limit)):
        return None
    best, pinned = None, None
    for _ in range(2):
        transcribed = transcribe(problem, guess, mesh, durations, least_limit=True, pinned=pinned)
        solution = solve(transcribed, problem.solver)
        history.append(step_of("least effort limit", transcribed, solution))
        if not solution.converged:
            break
        factor = float(solution.x[transcribed.program.layout.extra()][0])
        if best is not None and factor > best.factor * (1 + NO_WORSE):
            break
        best = LeastLimit(
            factor=factor,
            trajectory=trajectory_of(transcribed, solution.x, factor * limit),
            mesh=mesh,
            durations=solution.x[transcribed.program.layout.durations()] * transcribed.units.time_s,
        )
        knots = best.trajectory.breaks_s[mesh.knots()]
        cuts = find_cuts(best.trajectory, factor * limit, knots)
        if len(cuts) == 0:
            break
        mesh, durations = cut_mesh(knots, cuts, mesh.n_intervals)
        pinned = pinned_efforts(best.trajectory, factor * limit, np.cumsum(durations)[:-1]) / factor
        for bound in limit.T:  # as the limits' own numbers, free of rounding
            pinned = np.where(np.isclose(pinned, bound, rtol=1e-9), bound, pinned)
        guess = motion_of(best.trajectory)
    return best


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
