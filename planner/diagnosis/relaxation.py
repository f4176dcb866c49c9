"""The least relaxation of one kind of limit that admits a motion."""

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.planner.closed_chain.guess import motion_of
from linkplan.planner.closed_chain.transcribe import renumbered, trajectory_of, transcribe
from linkplan.planner.limits.path_limit import PathLimit
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import record, step_of
from linkplan.planner.solvers.solve import build_solver, run_solver, solve
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.mesh import Mesh


def least_of(
    problem: Problem,
    kind: type[PathLimit],
    motion: Trajectory,
    mesh: Mesh,
    durations: np.ndarray,
) -> Trajectory:
    """Return the motion with the least relaxation of a limit, by bisection of a common factor with warm solves.

    Args:
        problem: a problem without a motion.
        kind: the kind of limit.
        motion: a motion planned without the limit; returned if no motion is closer to the limit.
        mesh: of the solves.
        durations: of the mesh's segments in the motion [s].
    """
    factor = kind.factor(problem, motion)
    if factor is None:
        return motion
    near, far = 1.0, factor
    transcribed = transcribe(kind.scaled(problem, far), motion_of(motion), mesh, durations)
    best = solve(transcribed, problem.solver)
    record(step_of(f"least {kind.key}", transcribed, best))
    if not best.converged:
        return motion
    solver = build_solver(transcribed.program, problem.solver, warm=True)
    for _ in range(13):  # resolves the factor to four digits of its range
        if problem.solver.deadline.passed:
            break
        middle = 0.5 * (near + far)
        trial = run_solver(solver, renumbered(best.transcribed, kind.scaled(problem, middle), best.x))
        if trial.converged:
            best, far = trial, middle
        else:
            near = middle
    record(step_of(f"least {kind.key}", best.transcribed, best))
    try:
        return trajectory_of(best.transcribed, best.x, problem.limits.effort)
    except AssemblyError:
        return motion
