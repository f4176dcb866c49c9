"""Plans that a proof refutes: their motions are refined at the instants where it refutes a limit, and proved again.

These instants become samples of the certificate, and their intervals are halved, so that the refinement treats them like
samples that fail.
"""

from collections.abc import Callable
from dataclasses import replace

from linkplan.models.deadline import ONE_THREAD, Deadline, OutOfTimeError
from linkplan.planner.plan.plan import Plan
from linkplan.planner.refinement.history import Say, recording
from linkplan.planner.search.attempts import certified_at
from linkplan.planner.search.without_solver import slower

# A peak moves a little when its motion is refined; a second or third round finds it there.
_MAX_ROUNDS = 4


def proved_after_refinement(plan: Plan, proved: Callable[[Plan], Plan], deadline: Deadline, say: Say) -> Plan:
    """Return a plan with its proof. If the proof refutes a limit, the motion is refined there until another one is proved.

    If that does not help, the result is the refuted plan.

    Args:
        plan: passes its certificate.
        proved: returns a plan with its proof, or the same plan if there is no time for one.
        deadline: of the refinement.
        say: called with lines on the progress.
    """
    first = found = proved(plan)
    shares: tuple[float, ...] = ()
    for _ in range(_MAX_ROUNDS):
        further = _refuted_shares(found)
        if not further or deadline.passed:
            break
        shares += further
        finer = _refined(plan, shares, deadline, say)
        if finer is None:
            break
        plan, found = finer, proved(finer)
    return found if found.passed else first


def _refuted_shares(plan: Plan) -> tuple[float, ...]:
    """Return the shares of a motion's duration at which its proof refutes a claim; none if it refutes nothing."""
    motion, refuted = plan.require_motion("prove"), () if plan.proof is None else plan.proof.of("refuted")
    times = {one.time_s for one in refuted if one.time_s is not None}
    return tuple((time - motion.breaks_s[0]) / motion.duration_s for time in sorted(times))


def _refined(plan: Plan, shares: tuple[float, ...], deadline: Deadline, say: Say) -> Plan | None:
    """Return a plan refined at shares of its duration, or in slightly more time; None if no motion passes."""
    problem = plan.problem.varied(solver=plan.problem.solver.replace(deadline=deadline))
    with ONE_THREAD, recording(say):
        try:
            finer = certified_at(problem, plan, shares)
            if finer is None or not finer.passed:
                finer = slower(problem, [plan.require_motion("refine")])
        except OutOfTimeError:
            return None
    if finer is None:
        return None
    finer = replace(finer, problem=plan.problem, history=plan.history + finer.history, details=plan.details | finer.details)
    return replace(finer, verdict=plan.verdict) if plan.status == "feasible" else finer
