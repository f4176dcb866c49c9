"""The answer to a user's optimal-control problem, by the transcription, refinement and certificate that mechanisms get.

problem = OdeProblem(name="double integrator", rate=lambda x, u, p, t: [x[1], u[0]], start=[0, 0], goal=[1, 0],
                     effort_limit=[[-1, 1]], duration_s=(0.1, 10), final_cost=lambda x0, xT, T, p: T)
plan = plan_ode(problem).require()        # plan.objective is 2, with one switch at T / 2

There is no search beyond the guesses and the straight line between the given values of start and goal.
"""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.deadline import one_thread_at_a_time
from linkplan.models.errors import InfeasibleError
from linkplan.planner.ode.case import OdeCase
from linkplan.planner.ode.certificate import OdeCertificate, functions_not_finite
from linkplan.planner.ode.formulation import guesses_of, units_of
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.refinement.decision import refine
from linkplan.planner.refinement.history import Say, Step, recorded, recording, silent
from linkplan.planner.refinement.state import Refined
from linkplan.planner.refinement.switch_search import LONGER, bounded_by_guess
from linkplan.planner.solvers.solve import INVALID, OF_TIME, OUT_OF_TIME, SOLVER_TOLERANCE, why_stopped
from linkplan.planner.transcription.mesh import Mesh, broken, uniform

# Efforts are wild between the nodes if the integrated state ends this share of its size away. They are read then at this
# share of an interval: the first node of radau-3.
_WILD_SHARE, _FIRST_NODE = 1e-3, 0.155


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class OdePlan:
    """A solution with its certificate, or none and the reason.

    `status` is "optimal", "feasible" (certified, but less exact than was asked, or with an objective that still moves by
    more: `message` says by how much), "infeasible" or "failed". `objective_error` estimates the error of the objective, in
    its units: by its change from mesh to mesh, and by its distance from the objective of the integrated motion. A plan that
    failed has no objective; its trajectory and certificate, if any, show what does not hold.
    """

    problem: OdeProblem
    status: str
    message: str
    objective: float | None = None
    objective_error: float | None = None
    trajectory: OdeTrajectory | None = None
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
            InfeasibleError: carrying the plan, if it is not.
        """
        if self.status != "optimal":
            raise InfeasibleError(self.message, self)
        return self


def plan_of(problem: OdeProblem, refined: Refined) -> OdePlan:
    """Return the plan of a refined motion."""
    certificate, objective, intervals = refined.certificate, refined.solution.objective, len(refined.motion.breaks_s) - 1
    status, reason = _verdict(problem, refined)
    # At most ten times the largest of the last changes, if each mesh leaves at most nine tenths of the error before. The
    # solver leaves about its tolerance at every limit that binds.
    error = abs(objective) * max(10.0 * refined.objective_error, SOLVER_TOLERANCE * intervals)
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


def without_motion(problem: OdeProblem, reason: str, status: str = "failed") -> OdePlan:
    """Return the plan of a problem without a motion."""
    return OdePlan(problem=problem, status=status, message=f"{status}: {reason}", history=recorded())


def _verdict(problem: OdeProblem, refined: Refined) -> tuple[str, str]:
    """Return the status of a refined motion and the reason for it; if it is optimal, what else there is to say."""
    certificate, tolerance, held_back = refined.certificate, problem.tolerance, held_by_guess(problem, refined)
    if held_back is not None:
        return "failed", held_back
    if not certificate.passed:
        return "failed", f"the solver converged, the certificate does not pass: {'; '.join(certificate.failures)}"
    moved = f"; on the last finer mesh its objective changed by {100 * refined.moved:.2g} %" * bool(refined.moved)
    if certificate.integration_error > tolerance:
        return "feasible", (
            f"the integrated state ends {certificate.integration_error:.3g} of its size from the solution, more than the"
            f" tolerance {tolerance:g}{moved}"
        )
    if problem.objective_tolerance is not None and not refined.settled:
        return "feasible", f"objective_tolerance = {problem.objective_tolerance:g} was not reached{moved}"
    unstable = (
        "; the motion is unstable: a small error grows more than ten thousandfold along it, so that only feedback can"
        f" follow it; the integration was restarted {certificate.integration_restarts} time(s)"
    )
    return "optimal", unstable * bool(certificate.integration_restarts)


def held_by_guess(problem: OdeProblem, at: Iterate | Refined) -> str | None:
    """Return the words on a duration that ended at a bound which is its guess's, not the user's; None elsewhere."""
    bound = bounded_by_guess(at.solution, *problem.duration)
    if bound is None:
        return None
    side = "above" if bound == LONGER else "below"
    return (
        f"the {bound} the motion the better, up to {at.motion.duration_s:.4g} s, where the search from its guess ends:"
        f" give a {bound} guess, or bound duration_s from {side}"
    )


def known_digits(value: float, error: float) -> str:
    """Return a number with the digits that an error leaves, at most ten; three if the error is not known."""
    if value == 0 or not np.isfinite(error):
        return f"{value:.3g}"
    # A digit is printed if its unit is at least twice the error: it may then be wrong by one.
    unit = np.ceil(np.log10(max(2.0 * error, np.finfo(float).tiny)))
    digits = int(np.floor(np.log10(abs(value))) - unit + 1)
    return f"{value:.{min(digits, 10)}g}" if digits > 0 else "0"


def out_of_time(problem: OdeProblem) -> str:
    """Return the words on a time limit that has passed; empty before it has."""
    if not problem.solver.deadline.passed:
        return ""
    return f"; the plan ran out of its {problem.solver.max_time_s:g} s {OF_TIME}"


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
