"""Solving a user's optimal-control problem: the search, refinement and certificate that mechanisms get.

problem = OdeProblem(name="double integrator", rate=lambda x, u, p, t: [x[1], u[0]], start=[0, 0], goal=[1, 0],
                     effort_limit=[[-1, 1]], duration_s=(0.1, 10), final_cost=lambda x0, xT, T, p: T)
plan = plan_ode(problem).require()        # plan.objective is 2, with one switch at T / 2
"""

from collections.abc import Sequence
from dataclasses import replace

from linkplan.planner.ode import rungs
from linkplan.planner.ode.plan import OdePlan, plan_without_motion
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.search import OdeSearch
from linkplan.planner.refinement.history import Say, recorded, recording, silent
from linkplan.planner.search.rungs import HURRIED, PATIENT, Rung, try_in_turn
from linkplan.planner.solvers.outcome import OUT_OF_TIME, why_stopped

__all__ = ["RUNGS", "OdePlan", "plan_ode"]

# The first rung that finds a motion ends the search, whether its certificate passes or not.
RUNGS: tuple[Rung[OdeSearch], ...] = (
    Rung(
        name="several starts, the best of them (multistart)",
        tried=lambda search: search.problem.solver.starts > 1,
        climb=rungs.from_several_starts,
        budget=PATIENT,
    ),
    Rung(
        name="the guesses given, then the straight line",
        tried=lambda search: search.problem.solver.starts == 1,
        climb=rungs.from_guesses,
        budget=PATIENT,
    ),
    Rung(name="motions under constant efforts", climb=rungs.from_constant_efforts, budget=PATIENT),
    Rung(
        name="continuation in the effort limits, or in the duration",
        tried=lambda search: search.efforts_limited,
        climb=rungs.from_least_limits,
        budget=PATIENT,
    ),
    Rung(
        name="the straight line at other durations and with other efforts, and perturbed guesses",
        climb=rungs.from_further_guesses,
        budget=HURRIED,
    ),
)


def plan_ode(problem: OdeProblem, say: Say = silent, ladder: Sequence[Rung[OdeSearch]] = RUNGS) -> OdePlan:
    """Return the solution of a problem; one without an answer says why in `message`.

    Args:
        problem: the problem; `solver.max_time_s` limits the whole plan. With `solver.starts` above 1 that many starts are
            solved: the guesses, the straight line and perturbations of them, the same in every run. The best is refined.
        say: called with a line of progress from time to time.
        ladder: the attempts, in order.
    """
    contradiction = _contradiction(problem)
    if contradiction is not None:
        return OdePlan(problem=problem, status="infeasible", message=contradiction)
    with recording(say):
        search = OdeSearch(problem=replace(problem, solver=problem.solver.begun()))
        try_in_turn(search, ladder)
        plan = search.plans[0] if search.plans else _nothing_found(search.problem)
    return replace(plan, problem=problem)


def _contradiction(problem: OdeProblem) -> str | None:
    """Return the sentence on a limit that no motion can keep, found without solving, or None."""
    for what, rows in (("start", problem.start), ("goal", problem.goal)):
        for name, (low, high), (least, most) in zip(problem.states, rows, problem.state_limit, strict=True):
            if low > most or high < least:
                asked = low if low > most else high
                return f"infeasible: {what} asks for {name} = {asked:g}, beyond its limits {least:g} to {most:g}"
    return None


def _nothing_found(problem: OdeProblem) -> OdePlan:
    """Return the plan of a problem that no start solved; the first start had more time than later ones."""
    steps = recorded()
    status = steps[0].solver_status if steps else OUT_OF_TIME
    stopped = why_stopped(status, problem.solver.max_time_s)
    if stopped is not None:
        return OdePlan(problem=problem, status="failed", message=f"failed: {stopped}", history=steps)
    return plan_without_motion(problem, "failed", f"no start led to a solution ({status})")
