"""The answer to a user's optimal-control problem, by the transcription, refinement and certificate that mechanisms get.

The first of the guesses and the straight line that leads to a motion that passes is the answer; there is no other search.
"""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.deadline import one_thread_at_a_time
from linkplan.models.errors import PlanError
from linkplan.planner.ode.case import case_of, guesses_of
from linkplan.planner.ode.certificate import OdeCertificate, functions_not_finite
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.refinement.decision import refine
from linkplan.planner.refinement.history import Say, Step, recorded, recording, silent
from linkplan.planner.refinement.state import OPTIMAL_CHANGE, Refined
from linkplan.planner.refinement.switches import LONGER, bounded_by_guess
from linkplan.planner.solvers.solve import INVALID, OF_TIME, OUT_OF_TIME, SOLVER_TOLERANCE, why_stopped
from linkplan.planner.transcription.collocation import Curves
from linkplan.planner.transcription.mesh import broken, uniform

# If the integrated state ends this share of its size away, efforts are meaningless between the nodes. They are then read at
# this share of an interval: the first node of radau-3.
_WILD_SHARE, _FIRST_NODE = 1e-3, 0.155


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class OdePlan:
    """A solution with its certificate, or the reason why there is none.

    `status` is "optimal", "feasible" (certified, but less accurate than required, or with an objective that still changes
    from mesh to mesh; `message` gives the amount) or "failed". `objective_error` estimates the error of the objective, in
    its units: by its change from mesh to mesh, and by its distance from the objective of the integrated motion. A plan that
    failed has no objective; its trajectory and certificate, if any, show what does not hold.
    """

    problem: OdeProblem
    status: str
    message: str
    objective: float | None = None
    objective_error: float | None = None
    trajectory: Curves | None = None
    certificate: OdeCertificate | None = None
    history: tuple[Step, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether it has a motion that passes its certificate, optimal or not."""
        return self.status in ("optimal", "feasible")

    @property
    def duration_s(self) -> float | None:
        """The duration of the motion [s]; None without a motion that passes."""
        return self.trajectory.duration_s if self.trajectory is not None and self.passed else None

    def require(self) -> "OdePlan":
        """Return this plan if it is optimal.

        Raises:
            PlanError: carrying the plan, if it is not.
        """
        if self.status != "optimal":
            raise PlanError(self.message, self)
        return self


def plan_of(problem: OdeProblem, refined: Refined) -> OdePlan:
    """Return the plan of a refined motion."""
    certificate, objective, intervals = refined.certificate, refined.solution.objective, len(refined.motion.breaks_s) - 1
    status, reason = _verdict(problem, refined)
    # The solver leaves about its tolerance at every limit that binds.
    error = abs(objective) * max(_error_of_meshes(refined), SOLVER_TOLERANCE * intervals)
    error += abs(objective - certificate.integrated_objective)
    value = f"{known_digits(objective, error)} in {refined.motion.duration_s:.6g} s"
    estimate = f"the estimated error of the objective is {error:.1g}"
    if not np.isfinite(error):
        estimate = "the error of the objective is not known, because only one mesh has a motion"
    message = {
        "optimal": f"optimum {value}; {estimate}{reason}",
        "feasible": f"feasible: the best certified motion, {value}, satisfies every limit, but {reason}; {estimate}",
        "failed": f"failed: {reason}",
    }[status]
    return OdePlan(
        problem=problem,
        status=status,
        message=message if status == "optimal" else message + out_of_time(problem),
        objective=None if status == "failed" else objective,
        objective_error=float(error) if status != "failed" and np.isfinite(error) else None,
        trajectory=refined.motion,
        certificate=certificate,
        history=recorded(),
    )


def without_motion(problem: OdeProblem, reason: str) -> OdePlan:
    """Return the plan of a problem without a motion."""
    return OdePlan(problem=problem, status="failed", message=f"failed: {reason}", history=recorded())


def _error_of_meshes(refined: Refined) -> float:
    """Return the error of an objective as a share: ten times the largest of the last changes from mesh to mesh.

    It is at most that if each mesh leaves at most nine tenths of the error before. It is infinite after one mesh.
    """
    return 10.0 * refined.objective_error


def _verdict(problem: OdeProblem, refined: Refined) -> tuple[str, str]:
    """Return the status of a refined motion and the reason for it; if it is optimal, a further remark."""
    certificate, tolerance, held_back = refined.certificate, problem.tolerance, held_by_guess(problem, refined)
    if held_back is not None:
        return "failed", held_back
    if not certificate.passed:
        return "failed", f"the solver converged, but the certificate does not pass: {'; '.join(certificate.failures)}"
    moved = f"; on the last finer mesh its objective changed by {100 * refined.moved:.2g} %" * bool(refined.moved)
    if certificate.integration_error > tolerance:
        return "feasible", (
            f"the integrated state ends {certificate.integration_error:.3g} of its size from the solution, more than the"
            f" tolerance {tolerance:g}{moved}"
        )
    if problem.objective_tolerance is not None and not refined.settled:
        return "feasible", f"objective_tolerance = {problem.objective_tolerance:g} was not reached{moved}"
    if OPTIMAL_CHANGE < _error_of_meshes(refined) < np.inf:
        return "feasible", f"its objective is known to no better than {100 * OPTIMAL_CHANGE:g} %{moved}"
    unstable = (
        "; the motion is unstable: a small error grows more than ten thousandfold along it, so that only feedback can"
        f" follow it; the integration was restarted {certificate.integration_restarts} time(s)"
    )
    return "optimal", unstable * bool(certificate.integration_restarts)


def held_by_guess(problem: OdeProblem, at: Iterate | Refined) -> str | None:
    """Return a sentence if the duration ended at a bound that follows from its guess and not from the user; else None."""
    bound = bounded_by_guess(at.solution, *problem.duration)
    if bound is None:
        return None
    side = "above" if bound == LONGER else "below"
    return (
        f"the {bound} the motion the better, up to {at.motion.duration_s:.4g} s, where the search from its guess ends:"
        f" give a {bound} guess, or bound duration_s from {side}"
    )


def known_digits(value: float, error: float) -> str:
    """Return a number with the digits that an error leaves, from one to ten, and 0 if the error is larger than the number.

    If the error is not known, three digits are printed.
    """
    if value == 0 or not np.isfinite(error):
        return f"{value:.3g}"
    # A digit is printed if its unit is at least twice the error: it may then be wrong by one.
    unit = np.ceil(np.log10(max(2.0 * error, np.finfo(float).tiny)))
    digits = int(np.floor(np.log10(abs(value))) - unit + 1)
    return f"{value:.{min(max(digits, 1), 10)}g}" if error < abs(value) else "0"


def out_of_time(problem: OdeProblem) -> str:
    """Return a clause on the time limit if it has passed; empty otherwise."""
    if not problem.solver.deadline.passed:
        return ""
    return f"; the plan ran out of its {problem.solver.max_time_s:g} s {OF_TIME}"


@one_thread_at_a_time
def plan_ode(problem: OdeProblem, say: Say = silent) -> OdePlan:
    """Return the solution of a problem; one without an answer says why in `message`.

    Args:
        problem: the problem; `solver.max_time_s` limits the whole plan.
        say: called with a line of progress from time to time.
    """
    with recording(say):
        begun, failed = replace(problem, solver=problem.solver.begun()), None
        for k, guess in enumerate(begun.solver.deadline.take(guesses_of(begun))):
            plan = _plan_from(begun, guess, f"start {k + 1}" if k else "first solve")
            if plan is not None and plan.passed:
                return replace(plan, problem=problem)
            failed = failed or plan
        return replace(failed or _nothing_found(begun), problem=problem)


def _plan_from(problem: OdeProblem, guess: Curves, what: str) -> OdePlan | None:
    """Return the plan that a guess leads to, or None if the solver finds no motion from it.

    An effort that acts only through its sine and cosine may jump by whole turns from node to node: the equations hold at the
    nodes, but the polynomial between them is meaningless. Efforts that are constant over an interval avoid this.
    """
    case, breaks = case_of(problem, guess), problem.mesh.breaks
    mesh = uniform(problem.mesh.intervals) if breaks is None else broken(breaks)
    found = attempt(case, case.start_from(guess), mesh, np.array([guess.duration_s]), what)
    if found is None:
        return None
    if case.certify(found.motion).integration_error > _WILD_SHARE:
        efforts = found.motion.effort_at(found.motion.times_at(np.array([_FIRST_NODE])))
        start, duration = case.start_from(replace(found.motion, effort=efforts[None])), np.array([found.motion.duration_s])
        found = attempt(case, start, found.mesh, duration, "efforts constant at first", warm=True) or found
    reason = held_by_guess(problem, found)
    refined = refine(case, found) if reason is None else None
    return without_motion(problem, reason or "no certificate") if refined is None else plan_of(problem, refined)


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
