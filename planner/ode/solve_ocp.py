"""Solving a user's optimal-control problem: the transcription, refinement and certificate that mechanisms get.

problem = OdeProblem(name="double integrator", rate=lambda x, u, p, t: [x[1], u[0]], start=[0, 0], goal=[1, 0],
                     effort_limit=[[-1, 1]], duration_s=(0.1, 10), final_cost=lambda x0, xT, T, p: T)
plan = plan_ode(problem).require()        # plan.objective is 2, with one switch at T / 2

There is no search beyond the guesses and the straight line between the given values of start and goal.
"""

from dataclasses import replace

import numpy as np

from linkplan.models.deadline import one_thread_at_a_time
from linkplan.planner.ode.case import OdeCase
from linkplan.planner.ode.certificate import functions_not_finite
from linkplan.planner.ode.formulation import guesses_of, units_of
from linkplan.planner.ode.plan import OdePlan, held_by_guess, out_of_time, plan_of, without_motion
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.refinement.decision import refine
from linkplan.planner.refinement.history import Say, recorded, recording, silent
from linkplan.planner.solvers.solve import INVALID, OUT_OF_TIME, why_stopped
from linkplan.planner.transcription.mesh import Mesh, broken, uniform

__all__ = ["OdePlan", "plan_ode"]

# Efforts are wild between the nodes if the integrated state ends this share of its size away. They are read then at this
# share of an interval: the first node of radau-3.
_WILD_SHARE, _FIRST_NODE = 1e-3, 0.155


@one_thread_at_a_time
def plan_ode(problem: OdeProblem, say: Say = silent) -> OdePlan:
    """Return the solution of a problem; one without an answer says why in `message`.

    Args:
        problem: the problem; `solver.max_time_s` limits the whole plan. The first of the guesses and the straight line that
            leads to a motion that passes is the answer.
        say: called with a line of progress from time to time.
    """
    with recording(say):
        return replace(_first_plan(replace(problem, solver=problem.solver.begun())), problem=problem)


def _first_plan(problem: OdeProblem) -> OdePlan:
    """Return the plan from the first guess with a motion that passes, or else the first that fails."""
    contradiction = _contradiction(problem)
    if contradiction is not None:
        return without_motion(problem, contradiction, "infeasible")
    failed, settings = None, problem.mesh
    mesh = uniform(settings.intervals) if settings.breaks is None else broken(settings.breaks)
    for k, guess in enumerate(problem.solver.deadline.take(guesses_of(problem))):
        case = OdeCase(problem, units_of(problem, guess))
        found = _solved(case, guess, mesh, f"start {k + 1}" if k else "first solve")
        if found is None:
            continue
        plan = _refined_plan(case, found)
        if plan.passed:
            return plan
        failed = failed or plan
    return failed or _nothing_found(problem)


def _solved(case: OdeCase, motion: OdeTrajectory, mesh: Mesh, what: str, *, warm: bool = False) -> Iterate | None:
    return attempt(case, case.start_from(motion), mesh, np.array([motion.duration_s]), what, warm=warm)


def _refined_plan(case: OdeCase, found: Iterate) -> OdePlan:
    """Return the plan that a first solution is refined to.

    An effort that acts through its sine and cosine alone may leap by whole turns from node to node: the equations hold
    there, and between them its polynomial is wild. Efforts constant over an interval are next to a motion.
    """
    if case.certify(found.motion).integration_error > _WILD_SHARE:
        at = found.motion.times_at(np.array([_FIRST_NODE]))
        held = replace(found.motion, effort=found.motion.effort_at(at)[None])
        found = _solved(case, held, found.mesh, "efforts constant at first", warm=True) or found
    reason = held_by_guess(case.problem, found)
    refined = refine(case, found) if reason is None else None
    return without_motion(case.problem, f"{reason}") if refined is None else plan_of(case.problem, refined)


def _contradiction(problem: OdeProblem) -> str | None:
    """Return the sentence on a limit that no motion can keep, found without solving, or None."""
    for what, rows in (("start", problem.start), ("goal", problem.goal)):
        for name, (low, high), (least, most) in zip(problem.states, rows, problem.state_limit, strict=True):
            if low > most or high < least:
                asked = low if low > most else high
                return f"{what} asks for {name} = {asked:g}, beyond its limits {least:g} to {most:g}"
    return None


def _nothing_found(problem: OdeProblem) -> OdePlan:
    """Return the plan of a problem that no guess solved."""
    status = recorded()[0].solver_status if recorded() else OUT_OF_TIME
    reason = why_stopped(status, problem.solver.max_time_s)
    unknown = functions_not_finite(problem, guesses_of(problem)[0]) if status == INVALID else []
    if unknown:
        reason = f"the solver met a number that is not finite (NaN): {'; '.join(unknown)} along the first guess"
    if reason is None:
        reason = f"no start led to a solution ({status}): give `guesses`{out_of_time(problem)}"
    return without_motion(problem, reason)
