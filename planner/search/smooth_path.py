"""The smooth path itself as an answer: a motion with the efforts that it needs, which no solver has improved.

Large robots with a drive for each freedom move along almost any slow path. The solver may still run out of time on their
programs of ten thousand unknowns, or stall next to an optimum that no digit of the objective shows.
"""

from dataclasses import replace

import numpy as np

from linkplan.models.deadline import Deadline
from linkplan.models.errors import AssemblyError
from linkplan.models.poses.along import HOLDING_TOLERANCE, needed_effort
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.certificate.further_checks import negligible_objective, objective_value
from linkplan.planner.closed_chain.case import finished
from linkplan.planner.closed_chain.guess import even_poses
from linkplan.planner.closed_chain.prescribed import SQUARES_AT_REST, holding_at, motion_along
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import progress
from linkplan.planner.search.attempts import without_solving
from linkplan.planner.search.ladder import Search
from linkplan.planner.search.solving import first_mesh
from linkplan.planner.solvers.solve import OUT_OF_TIME


def along_smooth_path(search: Search) -> Plan | None:
    """Return the smooth path from start to goal as a "feasible" plan; None if its certificate does not pass.

    Raises:
        OutOfTimeError: if the deadline for judging motions passes.
    """
    asked = search.problem
    if asked.motion.kind != "reach" or search.verdicts:
        return None
    # A search that is out of time has this motion at hand, however late the solver's first iteration let it end.
    problem = replace(asked, solver=asked.solver.replace(deadline=Deadline().within(asked.solver.max_time_s)))
    try:
        if not _is_carried(problem, search):
            return None
        progress("the smooth path itself")
        mesh, durations = first_mesh(problem, search.smooth)
        motion = motion_along(problem, search.smooth, mesh.breaks(durations))
        objective, _ = objective_value(problem, motion)
        within = f" within {asked.solver.max_time_s:g} s" if search.stopped == OUT_OF_TIME else ""
        said = (
            f"motion of {motion.duration_s:.6g} s along the smooth path, which satisfies every limit; the solver found no"
            f" better one{within}"
        )
        plan = without_solving(problem, motion, objective, said)
    except AssemblyError:
        return None
    return plan if plan.passed else None


def at_rest(search: Search) -> Plan | None:
    """Return the rest as the plan of a reach that ends where it starts; None where no rest answers it.

    It is "optimal" where it costs nothing. Elsewhere a motion may cost less: a swing may spare effort against a weight.
    """
    problem, motion = search.problem, search.problem.motion
    duration = motion.duration_s or motion.min_duration_s
    moves = motion.start_speed is not None and np.any(motion.start_speed)
    if motion.start is None or not motion.stays or moves or duration is None or problem.mechanism.forces is not None:
        return None
    holding = holding_at(problem, motion.start)
    if not holding.holds:
        return None
    rest = holding.lasting(duration)
    objective, _ = objective_value(problem, rest)
    free = set(problem.objective.weights) <= SQUARES_AT_REST and objective <= negligible_objective(problem, rest)
    said = f"rest of {duration:.6g} s: constant efforts hold the start"
    said = said if free else f"{said}; that no motion costs less was not shown"
    plan = finished(problem, rest, certify(problem, rest), objective, said, optimal=free)
    return plan if plan.passed else None


def _is_carried(problem: Problem, search: Search) -> bool:
    """Tell if the actuators carry the smooth path within their limits at its samples."""
    times, poses = even_poses(problem, search.smooth)
    v, a = search.smooth.velocity(times), search.smooth.acceleration(times)
    effort, missing = needed_effort(problem.mechanism, poses, v, a, times)
    low, high = problem.limits.effort.T
    largest = np.abs(effort).max(initial=0.0)
    return bool(
        np.all((effort >= low) & (effort <= high)) and np.abs(missing).max(initial=0.0) <= HOLDING_TOLERANCE * largest
    )
