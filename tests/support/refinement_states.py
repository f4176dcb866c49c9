"""States of a refinement for its decisions: iterates of a hinge's quarter turn whose certificates say what a test gives."""

from dataclasses import replace
from functools import cache

import numpy as np
from msgspec import structs

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import CertifiedIterate, ErrorReport, Iterate, RefinementTarget, certify_iterate
from linkplan.planner.refinement.state import RefinementState, observed
from linkplan.planner.solvers.solve import SUCCEEDED, Solution
from linkplan.planner.transcription.mesh import uniform
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem

AIMS = RefinementTarget(
    effort_limit=np.array([[-1.0, 1.0]]),
    switches=False,
    bang_bang=False,
    continuous_efforts=True,
    strictness=1.0,
    tolerance_given=False,
    objective_tolerance=None,
)


@cache
def turn() -> Problem:
    """Return the problem of a quarter turn, which is loaded once."""
    return body_problem(HINGE, QUARTER_TURN + "duration_s = 1.5\n", "mesh.intervals=10")


@cache
def guessed(n: int) -> CertifiedIterate:
    """Return the first guess of the turn on n even intervals as if a solver had converged to it."""
    case = case_of(turn())
    transcribed = case.transcribe(first_guess(case.asked, case.asked.start_pose()), uniform(n), np.array([1.5]))
    solution = Solution(
        transcribed=transcribed, x=transcribed.start, objective=1.0, converged=True, status=SUCCEEDED, iterations=0,
        build_s=0.0, solve_s=0.0,
    )  # fmt: skip
    return certify_iterate(case, Iterate(motion=case.motion(solution), solution=solution))


def iterate(
    *,
    passed: bool = True,
    exact: bool = True,
    growth=(0.0,),
    residual_share=(0.0,),
    overrun=(0.0,),
    effort_overrun=(0.0,),
    n: int = 10,
    objective=1.0,
    tightened=False,
    status: str = SUCCEEDED,
    **report,
) -> CertifiedIterate:
    """Return a certified iterate on n even intervals; shares of errors and overruns are (n,) or the same on all."""
    first, given = guessed(n), (growth, residual_share, overrun, effort_overrun)
    growth, residual, overrun, beyond = (np.broadcast_to(np.array(one, dtype=float), n) for one in given)
    solution = replace(first.found.solution, objective=objective, status=status)
    if tightened:
        formulation = replace(solution.transcribed.formulation, tightening=lambda breaks: np.zeros((len(breaks) - 1, 0)))
        solution = replace(solution, transcribed=replace(solution.transcribed, formulation=formulation))
    certificate = structs.replace(first.certificate, failures=() if passed else ("errs",))
    report = {"growth": growth, "residual_share": residual, "effort_overrun": beyond} | report
    report = {"repairable": True, "leaves_positions": False, "integration_error_deg": 1e-3} | report
    report = ErrorReport(passed=passed, exact=exact, overruns=bool(overrun.any()), overrun=overrun, **report)
    return CertifiedIterate(found=replace(first.found, solution=solution), certificate=certificate, report=report)


def state(at: CertifiedIterate, *, target: RefinementTarget = AIMS, scheme: str = "radau-3", **changes) -> RefinementState:
    """Return a state at an iterate, its history as `changes` say."""
    case = case_of(turn().varied(mesh=turn().mesh.replace(scheme=scheme)))
    object.__setattr__(case, "target", target)  # in place of what follows from the problem
    begin = RefinementState(asked=case, case=case, iterate=at, warm=False)
    return replace(observed(begin, at), **changes)
