"""Which limit forbids a motion: each kind taken away in turn, and the least that it would have to be."""

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.planner.closed_chain.guess import motion_of
from linkplan.planner.closed_chain.transcribe import renumbered, trajectory_of, transcribe
from linkplan.planner.limits.path_limit import PathLimit
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.history import record, step_of
from linkplan.planner.solvers.solve import build_solver, run_solver, solve
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.mesh import Mesh

# Halvings of the range of a limit's factor: its least is then known to four digits of what a motion without it comes to.
_HALVINGS = 13


def least_of(
    problem: PlanningProblem,
    kind: type[PathLimit],
    motion: Trajectory,
    mesh: Mesh,
    durations: np.ndarray,
) -> Trajectory:
    """Return the motion for which a limit has to be relaxed least: bisection of a common factor on it, solved warm.

    Args:
        problem: one without a motion.
        kind: of the limit.
        motion: made without it; what is returned where none comes nearer.
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
    for _ in range(_HALVINGS):
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
