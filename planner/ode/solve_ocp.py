"""Solving a user's optimal-control problem: the transcription, refinement and certificate that mechanisms get.

problem = OdeProblem(name="double integrator", rate=lambda x, u, p, t: [x[1], u[0]], start=[0, 0], goal=[1, 0],
                     effort_limit=[[-1, 1]], duration_s=(0.1, 10), final_cost=lambda x0, xT, T, p: T)
plan = plan_ode(problem).require()        # plan.objective is 2, with one switch at T / 2
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.errors import InfeasibleError
from linkplan.planner.ode.case import OdeCase
from linkplan.planner.ode.certificate import OdeCertificate, sizes_of
from linkplan.planner.ode.costates import is_affine
from linkplan.planner.ode.first_solution import FirstSolution
from linkplan.planner.ode.formulation import completed, start_of, straight_guess, units_of
from linkplan.planner.ode.integration import is_unstable
from linkplan.planner.ode.problem import OdeProblem, StateGuess
from linkplan.planner.ode.starts import (
    integrated,
    is_open,
    of_least_effort,
    of_least_time,
    of_other_durations,
    perturbed,
    piecewise_constant,
    sampled_guess,
    stretched,
    unbounded_duration,
)
from linkplan.planner.ode.switches import has_arcs, switch_by_costates
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.history import Say, Step, progress, record, recorded, recording, silent, step_of
from linkplan.planner.refinement.refine import refine
from linkplan.planner.refinement.refined import Refined
from linkplan.planner.solvers.outcome import OF_TIME, OUT_OF_TIME, why_stopped
from linkplan.planner.solvers.solve import solve
from linkplan.planner.transcription.mesh import broken, uniform

# Iterations and time of starts that are tried beside others or after others failed: at least this time [s], or this
# multiple of the time of the last solve. Solves that succeeded took less than a second on programs of this size.
_MAX_ITERATIONS = 200
_MIN_PATIENCE_S = 1.0
_PATIENCE_FACTOR = 5.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class OdePlan:
    """A solution with its certificate, or none and the reason.

    `status` is "optimal", "feasible" (certified, but less exact than was asked, or with an objective that still moves by
    more: `message` says by how much), "infeasible" or "failed".
    """

    problem: OdeProblem
    status: str
    message: str
    objective: float | None = None
    trajectory: OdeTrajectory | None = None
    certificate: OdeCertificate | None = None
    history: tuple[Step, ...] = ()

    def require(self) -> "OdePlan":
        """Return this plan if it is optimal.

        Raises:
            InfeasibleError: carrying the plan, if it is not.
        """
        if self.status != "optimal":
            raise InfeasibleError(self.message, self)
        return self


def plan_ode(problem: OdeProblem, say: Say = silent) -> OdePlan:
    """Return the solution of a problem; one without an answer says why in `message`.

    The guesses are tried in turn; without one the start is a straight line, at several durations if the problem does not
    bound them. If no guess leads to a solution, a motion of least effort and perturbed guesses are tried.
    If `solver.starts` is above 1, that many starts are solved: the guesses and perturbations of them, the same in every
    run. The
    best is refined.
    """
    contradiction = _contradiction(problem)
    if contradiction is not None:
        return OdePlan(problem=problem, status="infeasible", message=contradiction)
    with recording(say):
        plan = _planned(replace(problem, solver=problem.solver.begun()))
    return replace(plan, problem=problem)


def _planned(problem: OdeProblem) -> OdePlan:
    """Return the solution of a problem whose solves end at its deadline."""
    given = [completed(problem, guess) for guess in problem.guesses] or [straight_guess(problem)]
    if problem.solver.starts > 1:
        found = _first_solutions(problem, perturbed(problem, given, problem.solver.starts))
    else:
        found = _in_turn(problem, given)
    failed, tried = None, np.zeros(0)
    best_first = sorted(found, key=lambda one: (one.found.solution.objective, one.number))
    for one in problem.solver.certificate_deadline.take(best_first):
        objective = one.found.solution.objective
        # Objectives within this relative difference belong to the same motion.
        if np.any(np.abs(tried - objective) <= 1e-4 * abs(objective)):
            continue  # the same motion, that did not pass
        tried = np.append(tried, objective)
        plan = _refined(problem, one)
        if plan.status == "optimal" or one.away is not None:
            return plan
        failed = plan if failed is None or (failed.status, plan.status) == ("failed", "feasible") else failed
    return failed or _explain(problem, given[0])


def _in_turn(problem: OdeProblem, given: list[StateGuess]) -> list[FirstSolution]:
    """Return first solutions from the guesses, and from further starts where those lead to none or time is open."""
    found = _first_solutions(problem, given, enough=1)
    stopped = not found and why_stopped(_last_status(), problem.solver.max_time_s) is not None
    if stopped or (found and not is_open(problem)):
        return found
    if not found:
        # Efforts that are free to swing along singular arcs lead far away from there.
        calm = replace(problem, mesh=replace(problem.mesh, effort="linear")) if is_affine(problem) else problem
        found = _first_solutions(calm, integrated(problem), enough=1, first=len(given))
        if found and not is_open(problem):
            return found
    patience = min(problem.solver.max_time_s, max(_MIN_PATIENCE_S, _PATIENCE_FACTOR * recorded()[-1].solve_s))
    patient = replace(problem, solver=replace(problem.solver, max_iterations=_MAX_ITERATIONS, max_time_s=patience))
    others = of_other_durations(problem, given[0]) if is_open(problem) else []
    # Perturbed guesses if the duration is open, or if no other start leads to a solution.
    others += list(perturbed(problem, given, len(given) + 4))[len(given) :]
    if np.all(np.isfinite(problem.effort_limit)):
        # If all efforts are limited, starts of other durations may find a better optimum; without a solution the least
        # effort limits give the reason.
        return found + _first_solutions(patient, others if is_open(problem) else [], first=len(given))
    found += _from_least_effort(patient, given[0])
    return found or _first_solutions(patient, others, enough=1, first=len(given))


def _last_status() -> str:
    """Return the status of the last solve; without a solve the time was up."""
    steps = recorded()
    return steps[-1].solver_status if steps else OUT_OF_TIME


def _from_least_effort(problem: OdeProblem, guess: StateGuess) -> list[FirstSolution]:
    """Return the solution that is begun from the motion of least squared effort, if there is one."""
    for one in _first_solutions(of_least_effort(problem), [guess]):
        case = OdeCase(problem, problem, one.case.units)
        motion = one.found.motion
        start, durations = case.start_from(motion), np.diff(motion.breaks_s[[0, -1]])
        solved = attempt(case, start, one.found.mesh, durations, "start from least effort")
        if solved is not None:
            return [FirstSolution(case=case, found=solved, number=1)]
    return []


def _first_solutions(
    problem: OdeProblem, starts: Iterable[StateGuess], *, enough: int | None = None, first=0
) -> list[FirstSolution]:
    """Return the solutions that starts lead to on the first mesh, the first `enough` of them."""
    found: list[FirstSolution] = []
    for number, guess in enumerate(problem.solver.deadline.take(starts), first):
        case = OdeCase(problem, problem, units_of(problem, guess))
        mesh = uniform(problem.mesh.intervals) if problem.mesh.breaks is None else broken(problem.mesh.breaks)
        word = f"start {number + 1}" if number or problem.solver.starts > 1 else "first solve"
        solved = attempt(case, start_of(guess, case.units), mesh, np.array([guess.duration_s]), word)
        away, times = None, 0
        # Restarts of a motion whose duration ended at the bound of its guess; each is a factor of up to 100.
        while solved is not None and times < 3:
            held_at, before = unbounded_duration(problem, solved), solved.solution.objective
            if held_at is None:
                break
            # Guessed too short or too long by far: from what was found, with time in its own units.
            rescaled = sampled_guess(solved.motion)
            case = OdeCase(problem, problem, units_of(problem, rescaled))
            durations, what = np.array([rescaled.duration_s]), f"{word}, restarted from the bound on its duration"
            solved, times = attempt(case, start_of(rescaled, case.units), mesh, durations, what), times + 1
            # Still a fraction of what it was, after time grew or shrank by what is beyond all guessing: there is no end.
            # The duration has no bound if a restart reduces the objective below this share.
            falls = solved is not None and times > 1 and solved.solution.objective < 0.5 * before
            away = held_at if falls else None
        if solved is not None:
            found.append(FirstSolution(case=case, found=solved, number=number, away=away))
            if len(found) == enough:
                break
    return found


def _calmed(first: FirstSolution) -> FirstSolution:
    """Return a first solution whose efforts are no wild polynomials between its nodes."""
    case, motion = first.case, first.found.motion
    before = case.certify(motion).integration_error
    # A first solution whose integrated state ends this share of its size away has wild efforts between the nodes.
    if before <= 1e-3:
        return first
    durations, what = np.diff(motion.breaks_s[[0, -1]]), "efforts piecewise constant at first"
    solved = attempt(case, piecewise_constant(case, motion), first.found.mesh, durations, what, warm=True)
    if solved is None or case.certify(solved.motion).integration_error >= before:
        return first
    return replace(first, found=solved)


def _eased(first: FirstSolution) -> FirstSolution:
    """Return a first solution with efforts that are linear over intervals, where it has arcs on which they could chatter.

    On a singular arc only higher derivatives of the costates determine an effort that enters affinely. A polynomial through
    the nodes of an interval can oscillate there, a straight line cannot.
    """
    case, asked, motion = first.case, first.case.asked, first.found.motion
    if case.problem.mesh.effort != "polynomial" or not is_affine(asked) or not has_arcs(motion, asked.effort_limit):
        return first
    case = replace(case, problem=replace(asked, mesh=replace(asked.mesh, effort="linear")))
    start, durations = case.start_from(motion), np.diff(motion.breaks_s[[0, -1]])
    solved = attempt(case, start, first.found.mesh, durations, "efforts linear over intervals", warm=True)
    if solved is None:
        return first
    before, after = (case.certify(one).integration_error for one in (motion, solved.motion))
    # Efforts linear over intervals replace polynomials if they reduce the integration error to this share.
    return replace(first, found=solved, case=case) if after < 0.01 * before else first


def _finest(problem: OdeProblem, first: FirstSolution) -> Refined[OdeTrajectory, OdeCertificate]:
    """Refine a first solution; one with switch times is taken as it is."""
    if not first.case.has_switch_times:
        solved = replace(problem, mesh=first.case.problem.mesh)
        first = replace(first, case=OdeCase(solved, problem, first.case.units))
        first = switch_by_costates(_eased(_calmed(first)))
    guess = sampled_guess(first.found.motion)
    unstable = is_unstable(problem, first.found.motion, sizes_of(guess.state))
    if unstable:
        # In its own units, and from next to the coarser mesh: the solver loses such a motion more easily than others.
        first = replace(first, case=replace(first.case, units=units_of(problem, guess)))
    refined = refine(first.case, first.found, warm=unstable)
    assert refined is not None  # a user's solution always has a certificate
    return refined


def _refined(problem: OdeProblem, first: FirstSolution) -> OdePlan:
    """Return the plan that a first solution is refined to."""
    refined = _finest(problem, first)
    trajectory, certificate, objective = refined.motion, refined.certificate, refined.solution.objective
    away = first.away or unbounded_duration(problem, refined)
    status, message = "optimal", f"optimum {objective:.10g} in {trajectory.duration_s:.8g} s"
    best = f"feasible: the best certified motion, {objective:.10g} in {trajectory.duration_s:.8g} s, keeps every limit"
    if certificate.integration_restarts:
        message += (
            "; the motion is unstable: a small error grows more than ten thousandfold along it, so that only feedback can"
            f" follow it; the integration was restarted {certificate.integration_restarts} time(s)"
        )
    if away is not None:
        status, message = "failed", f"failed: {away}"
    elif not certificate.passed:
        status = "failed"
        message = f"failed: the solver converged, the certificate does not pass: {'; '.join(certificate.failures)}"
    elif certificate.integration_error > problem.tolerance:
        status = "feasible"
        message = (
            f"{best}, but the integrated state ends {certificate.integration_error:.3g} of its size from the solution, more"
            f" than the tolerance {problem.tolerance:g}{_moved(refined)}"
        )
    elif not refined.settled:
        status = "feasible"
        message = f"{best}, but objective_tolerance = {problem.objective_tolerance:g} was not reached{_moved(refined)}"
    return OdePlan(
        problem=problem,
        status=status,
        message=message if status == "optimal" else message + _out_of_time(problem),
        objective=objective,
        trajectory=trajectory,
        certificate=certificate,
        history=recorded(),
    )


def _out_of_time(problem: OdeProblem) -> str:
    """Return the words on a time limit that has passed; empty before it has."""
    if not problem.solver.deadline.passed:
        return ""
    return f"; the plan ran out of its {problem.solver.max_time_s:g} s {OF_TIME}"


def _moved(refined: Refined[OdeTrajectory, OdeCertificate]) -> str:
    """Return the words on what the objective changed by between the last two meshes whose motions pass."""
    if refined.moved == 0.0:
        return ""
    return f"; its objective changed by {refined.moved:.2g} of itself from mesh to mesh at the last"


def _contradiction(problem: OdeProblem) -> str | None:
    """Return the sentence on a limit that no motion can keep, found without solving, or None."""
    for what, rows in (("start", problem.start), ("goal", problem.goal)):
        for name, (low, high), (least, most) in zip(problem.states, rows, problem.state_limit, strict=True):
            if low > most or high < least:
                asked = low if low > most else high
                return f"infeasible: {what} asks for {name} = {asked:g}, beyond its limits {least:g} to {most:g}"
    return None


def _explain(problem: OdeProblem, guess: StateGuess) -> OdePlan:
    """Return the plan of a problem that no start solved: from the motion of the least limits, or the reason."""
    # The status of the first start: later ones had less time.
    steps = recorded()
    status = steps[0].solver_status if steps else OUT_OF_TIME
    stopped = why_stopped(status, problem.solver.max_time_s)
    if stopped is None and np.all(np.isfinite(problem.effort_limit)):
        progress("no solution found; looking for the least effort that admits one")
        case = OdeCase(problem, problem, units_of(problem, guess))
        mesh, durations = uniform(problem.mesh.intervals), np.array([guess.duration_s])
        transcribed = case.transcribe(start_of(guess, case.units), mesh, durations, least_limit=True)
        solution = solve(transcribed, problem.solver)
        record(step_of("least effort limit", transcribed, solution))
        factor = float(solution.x[transcribed.program.layout.extra()][0])
        if solution.converged and factor > 1:
            found = f"efforts of {factor:.4g} times their limits are the least with which a motion was found"
            fixed = problem.duration[0] == problem.duration[1]
            shorter = _least_time(problem, guess) if fixed else None
            if shorter is not None:
                return _lengthened(problem, shorter)
            # If the duration is free, a motion may build up energy by swings that no start has tried, and the factor proves
            # nothing.
            message = f"infeasible: {found}" if fixed else f"failed: no solution was found; {found}, which is no proof"
            status = "infeasible" if fixed else "failed"
            message += _out_of_time(problem)
            return OdePlan(problem=problem, status=status, message=message, history=recorded())
        if solution.converged:
            start = case.start_from(case.motion(solution))
            solved = attempt(case, start, mesh, durations, "start from the least limits")
            if solved is not None:
                return _refined(problem, FirstSolution(case=case, found=solved))
    reason = stopped or f"no start led to a solution ({status}){_out_of_time(problem)}"
    return OdePlan(problem=problem, status="failed", message=f"failed: {reason}", history=recorded())


def _least_time(problem: OdeProblem, guess: StateGuess) -> Refined[OdeTrajectory, OdeCertificate] | None:
    """Return the motion of least time between a problem's ends where one passes that is no longer than what was asked."""
    progress("looking for the shortest feasible duration")
    quick = of_least_time(problem)
    for one in sorted(_in_turn(quick, [guess]), key=lambda one: one.found.solution.objective):
        refined = _finest(quick, one)
        if refined.certificate.passed:
            return refined if refined.motion.duration_s <= problem.duration[1] else None
    return None


def _lengthened(problem: OdeProblem, shorter: Refined[OdeTrajectory, OdeCertificate]) -> OdePlan:
    """Return the plan begun from a shorter motion on its own mesh; one that is not found is not called infeasible."""
    mesh, motion = shorter.solution.transcribed.program.mesh, stretched(shorter.motion, problem.duration[1])
    case = OdeCase(problem, problem, units_of(problem, sampled_guess(motion)), has_switch_times=True)
    durations = np.bincount(mesh.segment, weights=np.diff(motion.breaks_s))
    solved = attempt(case, case.start_from(motion), mesh, durations, "start from the least time")
    if solved is not None:
        return _refined(problem, FirstSolution(case=case, found=solved))
    message = (
        f"failed: no start led to a solution of {problem.duration[1]:.8g} s; a motion of {shorter.motion.duration_s:.8g} s"
        f" is known, the shortest found{_out_of_time(problem)}"
    )
    return OdePlan(problem=problem, status="failed", message=message, history=recorded())
