"""From starts to plans: each is solved and refined until its certificate passes; where it does not, the next is tried."""

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from linkplan.planner.certificate.collisions import unavoidable
from linkplan.planner.closed_chain.answer import finished
from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import Guess, closes, motion_of
from linkplan.planner.plan import Plan
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.case import Found, attempt
from linkplan.planner.refinement.history import Say, Step
from linkplan.planner.refinement.refine import refine
from linkplan.planner.search.durations import longer
from linkplan.planner.search.first_mesh import PER_LEG, first_mesh, graded_mesh
from linkplan.planner.solvers.solve import INVALID, OUT_OF_TIME


def first_of(
    problem: PlanningProblem, starts: Iterator[tuple[str, Guess]], history: list[Step], say: Say, below: float = np.inf
) -> Plan | None:
    """Return the first plan that a start leads to and that passes; else one that was found and does not; else None.

    Solutions whose objective is not `below` what is known already are not refined.
    """
    failed = None
    for number, (what, guess) in enumerate(starts):
        if number >= 1 and (problem.motion.duration_s is not None or failed is not None) and what.startswith("bend"):
            break  # what a fixed duration forbids, other starts forbid too: the reason is looked for first
        if not closes(problem.mechanism, guess):
            continue
        word = "first solve" if number == 0 else f"start from {what}"
        patient = problem if number == 0 else replace(problem, solver=problem.solver.hurried())
        solved = _solved(patient, guess, word, history, say)
        if not solved and history and history[-1].solver_status in (OUT_OF_TIME, INVALID):
            return None
        missed = None
        for found in solved:
            if found.solution.objective >= below:
                continue
            found, away = longer(patient, found, history, say)
            if away is not None:
                return Plan(problem=problem, status="failed", message=away, history=tuple(history))
            # Where time alone counts the phase plane's start comes next: the first is not worth a second way.
            patiently = number > 0 or list(problem.objective.weights) != ["time"]
            missed = _refined(problem, found, history, say, again=patiently)
            if missed.status == "optimal":
                return missed
        if missed is None:
            continue
        if missed.trajectory is not None and unavoidable(problem, missed.trajectory, missed.certificate):
            return missed  # other motions pass there too
        if failed is not None:
            break  # a second motion that does not pass: others will not either
        failed = missed
    return failed


def _solved(patient: PlanningProblem, guess: Guess, word: str, history: list[Step], say: Say) -> list[Found]:
    """Return solutions from a start, the better first."""
    mesh, durations = first_mesh(patient, guess)
    found = attempt(case_of(patient), guess, mesh, durations, word, history, say)
    solved = [] if found is None else [found]
    if guess.cuts_s is not None and list(patient.objective.weights) == ["time"]:
        # Its switches are known: with cuts there and efforts held between them, the instants alone are to be found.
        cut, lengths = graded_mesh(guess, guess.cuts_s, max(patient.mesh.intervals, PER_LEG * guess.legs))
        for warm, how in ((False, "efforts held"), (True, "efforts held, next to it")):
            what = f"{word}, {how}"
            held = attempt(case_of(patient), guess, cut, lengths, what, history, say, pinned=guess.held, warm=warm)
            if held is not None:
                solved.append(held)
                break
    return sorted(solved, key=lambda found: found.solution.objective)


def _refined(problem: PlanningProblem, found: Found, history: list[Step], say: Say, *, again: bool) -> Plan:
    """Return the plan of a first solution; where its certificate does not pass, refined in other ways too."""
    plan, bends = certified(problem, found, history, say), True
    if unsound(plan) and case_of(problem).aims.switches and not case_of(problem, bends=False).aims.switches:
        # Cuts at bends are worth a thousandth at the most: a motion that is lost with them is planned without.
        plan, bends = certified(problem, found, history, say, bends=False), False
    if unsound(plan) and again:
        warm = certified(problem, found, history, say, warm=True, bends=bends)
        plan = warm if warm.status == "optimal" else plan
    if plan.status == "failed":
        plan = _plainer(problem, plan, found, history, say) or plan
    return plan


def best_of(problem: PlanningProblem, starts: Iterator[tuple[str, Guess]], history: list[Step], say: Say) -> Plan | None:
    """Return the best plan of as many starts as the problem asks for; None where none leads to one."""
    wanted, found = problem.solver.starts, []
    closed = (start for start in starts if closes(problem.mechanism, start[1]))
    for number, (what, guess) in enumerate(itertools.islice(closed, wanted)):
        mesh, durations = first_mesh(problem, guess)
        word = f"start {number + 1} of {wanted}, {what}"
        solved = attempt(case_of(problem), guess, mesh, durations, word, history, say)
        if solved is not None:
            found.append((solved.solution.objective, number, solved))
    failed = None
    for _, number, solved in sorted(found, key=lambda item: item[:2]):
        say(f"refining start {number + 1}")
        solved, away = longer(problem, solved, history, say)
        if away is not None:
            return Plan(problem=problem, status="failed", message=away, history=tuple(history))
        plan = certified(problem, solved, history, say)
        if plan.status == "optimal":
            return replace(
                plan, details={**plan.details, "starts": wanted, "starts_solved": len(found), "best_start": number + 1}
            )
        failed = failed or plan
    return failed


def unsound(plan: Plan) -> bool:
    """Return whether a motion's certificate does not pass, for reasons that another way of solving may mend."""
    return plan.certificate is not None and plan.certificate.mendable


def certified(
    problem: PlanningProblem,
    found: Found,
    history: list[Step],
    say: Say,
    *,
    warm: bool = False,
    bends: bool = True,
) -> Plan:
    """Return the plan of a solution, refined until its certificate passes; `bends` as of `case_of`."""
    refined = refine(case_of(problem, bends=bends), found, history, say, warm=warm)
    if refined is None:
        return Plan(
            problem=problem,
            status="failed",
            message="failed: the motion that the solver returned leaves the branch on which the mechanism was assembled",
            history=tuple(history),
        )
    solution = refined.solution
    plan = finished(problem, refined.motion, refined.certificate, solution.objective, history, None)
    return replace(plan, solved=replace(solution.transcribed, start=solution.x))


def _plainer(problem: PlanningProblem, plan: Plan, found: Found, history: list[Step], say: Say) -> Plan | None:
    """Return a plan with an effort that is constant over intervals, where polynomials overrun limits between their nodes.

    Along an arc on a limit of force or power a polynomial effort swings about what keeps it, from node to node.
    """
    overrun = plan.certificate is not None and not all(margin.kept for margin in plan.certificate.margins)
    if problem.mesh.effort != "polynomial" or not overrun:
        return None
    plain = replace(problem, mesh=replace(problem.mesh, effort="constant"), solver=problem.solver.hurried())
    durations = np.bincount(found.mesh.segment, np.diff(found.motion.breaks_s))
    what = "efforts constant over intervals"
    again = attempt(case_of(plain), motion_of(found.motion), found.mesh, durations, what, history, say)
    held = None if again is None else certified(plain, again, history, say)
    return replace(held, problem=problem) if held is not None and held.status == "optimal" else None
