"""From a first solution to a certified one: one loop that applies what `decision` decides until it says stop."""

from linkplan.models.deadline import check
from linkplan.planner.refinement.case import Case, CertificateT, Iterate, MotionT, certify_iterate
from linkplan.planner.refinement.decision import next_action
from linkplan.planner.refinement.state import Refined, RefinementState, observed
from linkplan.planner.refinement.switch_search import settle_switch_times


def refine(
    case: Case[MotionT, CertificateT], found: Iterate[MotionT], *, warm: bool = False
) -> Refined[MotionT, CertificateT] | None:
    """Return the best motion towards the tolerance, or None without a certificate.

    The certificate may not pass: then the motion is the last one tried.

    Args:
        case: what is refined, with the limits as they are asked.
        found: the first solution.
        warm: whether finer meshes are solved from next to the coarser one's answer: less exact, but an unstable motion is
            not lost on the way.
    """
    state = first_state(case, found, warm=warm)
    while (action := next_action(state)) is not None:
        check()
        state = action.apply(state)
    return state.result


def first_state(
    case: Case[MotionT, CertificateT], found: Iterate[MotionT], *, warm: bool
) -> RefinementState[MotionT, CertificateT]:
    """Return the state that a first solution leads to: with switch times as unknowns where efforts jump."""
    if case.target.switches:
        found = settle_switch_times(case, found)
    at = certify_iterate(case, found)
    return observed(RefinementState(asked=case, case=case, at=at, warm=warm), at)
