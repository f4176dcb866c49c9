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
from linkplan.planner.ode.formulation import guesses_of, start_from, units_of
from linkplan.planner.ode.plan import OdePlan, held_by_guess, out_of_time, plan_of
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.refinement.decision import refine
from linkplan.planner.refinement.history import Say, recorded, recording, silent
from linkplan.planner.solvers.solve import INVALID, OUT_OF_TIME, why_stopped
from linkplan.planner.transcription.mesh import broken, uniform

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
    contradiction = _contradiction(problem)
    if contradiction is not None:
        return OdePlan(problem=problem, status="infeasible", message=contradiction)
    with recording(say):
        return replace(_first_plan(replace(problem, solver=problem.solver.begun())), problem=problem)


def _first_plan(problem: OdeProblem) -> OdePlan:
    """Return the plan from the first guess with a motion that passes, or else the first that fails."""
    failed, settings = None, problem.mesh
    mesh = uniform(settings.intervals) if settings.breaks is None else broken(settings.breaks)
    for k, guess in enumerate(problem.solver.deadline.take(guesses_of(problem))):
        case = OdeCase(problem, problem, units_of(problem, guess))
        durations, what = np.array([guess.duration_s]), f"start {k + 1}" if k else "first solve"
        found = attempt(case, start_from(guess, case.units), mesh, durations, what)
        if found is None:
            continue
        plan = _refined_plan(case, found)
        if plan.passed:
            return plan
        failed = failed or plan
    return failed or _nothing_found(problem)


def _refined_plan(case: OdeCase, found: Iterate) -> OdePlan:
    """Return the plan that a first solution is refined to.

    An effort that acts through its sine and cosine alone may leap by whole turns from node to node: the equations hold
    there, and between them its polynomial is wild. Efforts constant over an interval are next to a motion.
    """
    if case.certify(found.motion).integration_error > _WILD_SHARE:
        at = found.motion.times_at(np.array([_FIRST_NODE]))
        held = case.start_from(replace(found.motion, effort=found.motion.effort_at(at)[None]))
        durations = np.array([found.motion.duration_s])
        found = attempt(case, held, found.mesh, durations, "efforts constant at first", warm=True) or found
    reason = held_by_guess(case.asked, found.solution)
    refined = refine(case, found) if reason is None else None
    if refined is not None:
        return plan_of(case.asked, refined)
    return OdePlan(problem=case.asked, status="failed", message=f"failed: {reason}", history=recorded())


def _contradiction(problem: OdeProblem) -> str | None:
    """Return the sentence on a limit that no motion can keep, found without solving, or None."""
    for what, rows in (("start", problem.start), ("goal", problem.goal)):
        for name, (low, high), (least, most) in zip(problem.states, rows, problem.state_limit, strict=True):
            if low > most or high < least:
                asked = low if low > most else high
                return f"infeasible: {what} asks for {name} = {asked:g}, beyond its limits {least:g} to {most:g}"
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
    return OdePlan(problem=problem, status="failed", message=f"failed: {reason}", history=recorded())
