"""The refinement: one loop that applies the next action until it is "stop", and the decision on it, a pure function.

| action | when | source |
|---|---|---|
| ReadSwitches | efforts jump, and their times are no unknowns yet or were read from a coarser mesh | Betts 2010, 4.4 |
| ImposeRanges | a state leaves its range between the nodes | Bernstein coefficients enclose the state |
| RaiseDegree | the error is even: the motion is smooth; or halving does not reduce it | Patterson, Hager and Rao 2015 |
| Halve | the error is large on some intervals, or the needed effort is beyond its limit | Betts and Huffman 1998 |
| Tighten | only an overrun between the nodes is left, or halving did not remove it | constraint tightening |
| ReleaseArcs | the multipliers on a held arc have the wrong sign | Pontryagin's principle; Betts 2010, 4.4 |
| Loosen | the motion passes within tightened limits | the same, on the finer mesh |
| ReduceEffortOverrun | between nodes the best motion needs more effort than a proof allows | Nocedal and Wright 2006, 18.1 |

The first row whose condition holds decides; a mesh is halved before limits are tightened.
"""

import numpy as np

from linkplan.models.deadline import check
from linkplan.planner.refinement.actions import (
    Action,
    Halve,
    ImposeRanges,
    Loosen,
    RaiseDegree,
    ReadSwitches,
    ReduceEffortOverrun,
    ReleaseArcs,
    Tighten,
)
from linkplan.planner.refinement.case import Case, CertifiedIterate, Iterate, certify_iterate
from linkplan.planner.refinement.constrained_arcs import arcs_against_their_limits
from linkplan.planner.refinement.marking import (
    EVEN_SHARE,
    MARKED_SHARE,
    degree_of,
    grown,
    higher_for,
    higher_on_arcs,
    marked_for,
    most_overrun,
    overrunning,
    raised,
    rough_of,
)
from linkplan.planner.refinement.state import OPTIMAL_CHANGE, Refined, RefinementState, observed
from linkplan.planner.refinement.switches import is_bang_bang, settle_switch_times

# A boundary layer of a ten-thousandth of the motion takes eight halvings; no refinement in the benchmarks took more rounds.
MAX_ROUNDS = 24
# A mesh that has grown by this factor without passing will not pass by growing further.
MAX_GROWTH = 120
# Without a user's tolerance, a mesh of this number of intervals is fine enough. The larger number is used while the
# objective changes too much for an optimal plan or, if efforts jump inside intervals, by more than this share.
ENOUGH_INTERVALS, ENOUGH_ROUGH_INTERVALS, CHANGE_WORTH_INTERVALS = 100, 200, 1e-4
# Largest numbers of repeated readings of switches, and of releases of arcs.
MAX_READINGS, MAX_RELEASES = 3, 3
# From this number of rounds after the last reading of switches on, limits are tightened while the mesh is still halved.
HALVINGS_BEFORE_TIGHTENING = 4
# Limits are loosened while tightening costs more than this share of the objective, on at most this number of intervals,
# until this number of loosenings in a row gain nothing. The last constant limits the number of tightenings after each
# loosening.
COST_OF_TIGHTENING, MAX_LOOSENED_INTERVALS, MAX_IDLE_LOOSENINGS, TIGHTENINGS_BETWEEN = 1e-6, 240, 2, 2
# Halving an interval divides its error by a hundred at the usual degree: a large overrun takes three rounds.
MAX_RESTORATIONS = 6
# The highest degree if efforts jump inside intervals.
MAX_ROUGH_DEGREE = 5


def next_action(state: RefinementState) -> Action | None:
    """Return the next action, or None to stop."""
    if state.restored:
        return _towards_a_proof(state)
    return _towards_a_certificate(state) or _towards_the_optimum(state) or _towards_a_proof(state)


def _towards_a_certificate(state: RefinementState) -> Action | None:
    """Return the next action on a motion that does not pass, or whose objective has not settled."""
    at, report = state.iterate, state.iterate.report
    if state.ended or state.rounds >= MAX_ROUNDS or (report is not None and not at.passed and not report.repairable):
        return None
    if state.loosened is not None:
        return Tighten() if not at.passed and at.overruns and state.tightenings < TIGHTENINGS_BETWEEN else None
    if state.finished:
        return _within_efforts(state) or (ReadSwitches() if _may_read_better(state) else None)
    over = overrunning(at)
    if over.any() and _switches_are_open(state) and state.rounds % 2 == 0 and state.rounds > 0 and state.readings < 2:
        return ReadSwitches()
    if report is not None and report.leaves_positions and not (state.position_rows or state.rows_lost):
        return ImposeRanges()
    return _finer(state, over)


def _beyond_efforts(at: CertifiedIterate) -> np.ndarray:
    """Return the intervals (n,) whose effort overrun is near or above the proof's allowance.

    There are none if no interval exceeds the allowance.
    """
    overrun = np.zeros(at.n_intervals) if at.report is None else at.report.effort_overrun
    return (overrun > MARKED_SHARE) & bool(overrun.max(initial=0.0) > 1.0)


def _within_efforts(state: RefinementState) -> Action | None:
    """Return the action on an exact motion that needs more effort than a proof allows, if it costs little."""
    beyond = _beyond_efforts(state.iterate)
    if not beyond.any() or state.target.enclosed:
        return None
    higher = raised(state.case.problem.mesh) if beyond.mean() >= EVEN_SHARE else None
    if higher is not None and degree_of(higher) <= MAX_ROUGH_DEGREE:
        return RaiseDegree(higher)
    return Halve(beyond) if grown(state.iterate.found.mesh, beyond) <= ENOUGH_INTERVALS else None


def _towards_a_proof(state: RefinementState) -> Action | None:
    """Return the action on the best motion if its effort overrun exceeds the proof's allowance."""
    best = state.best
    if best is None or best.report is None or state.restored >= MAX_RESTORATIONS or (state.restored and state.ended):
        return None
    # A corrected motion must be well within the allowance, because its largest effort may lie between the samples.
    beyond = best.report.effort_overrun > MARKED_SHARE if state.restored else _beyond_efforts(best)
    return ReduceEffortOverrun(beyond) if beyond.any() else None


def _finer(state: RefinementState, over: np.ndarray) -> Action | None:
    """Return the action on the errors of the mesh and on the intervals (n,) that overrun a limit."""
    at = state.iterate
    inexact, uneven = _inexact(state, over)
    higher = _higher_scheme(state, inexact if state.target.enclosed else inexact | uneven, over)
    if higher is not None:
        return RaiseDegree(higher)
    marked = _marked(state, uneven if state.target.enclosed and uneven.any() else inexact | uneven, over)
    if at.overruns and (not marked.any() or (state.target.enclosed and _should_tighten(state, inexact, marked))):
        return Tighten()
    if not marked.any():
        marked = np.ones(at.n_intervals, dtype=bool)
    if grown(at.found.mesh, marked) > _most_intervals(state):
        if at.passed:
            return ReadSwitches() if _may_read_better(state) and _switches_are_open(state) else None
        may = not (state.error_falls or state.degree_lost or state.target.enclosed)
        higher = raised(state.case.problem.mesh) if may else None
        return None if higher is None else RaiseDegree(higher)
    late = state.rounds - state.read_in >= HALVINGS_BEFORE_TIGHTENING * (2 if over.any() else 1)
    return Halve(marked, tightens=late and at.overruns and not state.target.enclosed, tells=not np.any(uneven & ~marked))


def _should_tighten(state: RefinementState, inexact: np.ndarray, marked: np.ndarray) -> bool:
    """Return True if tightening enclosed limits costs less than the objective's tolerance, or the mesh is large.

    Only motions that pass show that the objective has settled. Tightening costs about the share of the overrun.
    """
    at = state.iterate
    cheap = at.report is not None and at.report.overrun.max(initial=0.0) <= (state.objective_tolerance or 0.0)
    return (cheap and not inexact.any()) or grown(at.found.mesh, marked) > _comfortable(state)


def _towards_the_optimum(state: RefinementState) -> Action | None:
    """Return the next action on a motion that passes: release arcs that are fixed too long, and loosen limits."""
    best = state.best
    if best is None:
        return None
    if state.releases < MAX_RELEASES and len(arcs_against_their_limits(best.found.solution)):
        return ReleaseArcs()
    return Loosen() if _may_loosen(state) else None


def _may_loosen(state: RefinementState) -> bool:
    """Return True if the best motion is within tightened limits, and loosening them may gain something."""
    best, loose = state.best.found, state.loosened
    if (
        best.solution.transcribed.formulation.tightening is None
        or state.target.bang_bang
        or state.loosenings_without_gain >= MAX_IDLE_LOOSENINGS
    ):
        return False
    if loose is None:
        return True
    gain = best.solution.objective - loose.found.solution.objective
    grows = loose.overruns and grown(loose.found.mesh, most_overrun(loose)) <= MAX_LOOSENED_INTERVALS
    return grows and gain > COST_OF_TIGHTENING * abs(best.solution.objective)


def _switches_are_open(state: RefinementState) -> bool:
    fixed = state.iterate.found.fixed
    return state.target.switches and not (fixed is not None and fixed.everything)


def _may_read_better(state: RefinementState) -> bool:
    """Return True if switches read from a motion that passes may be better: efforts were free, or bounds were reached."""
    may = state.readings < MAX_READINGS and not state.arcs_known
    return may and is_bang_bang(state.case, state.iterate.found.solution.transcribed)


def _inexact(state: RefinementState, over: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the intervals (n,) on which the motion is not exact, and those that only the objective requires."""
    at, fixed = state.iterate, state.iterate.found.fixed
    inexact, uneven = marked_for(at, state.target.strictness), np.zeros(at.n_intervals, dtype=bool)
    if state.target.enclosed:
        return inexact, uneven if state.settled else rough_of(at.found.motion) | state.off_limit_intervals
    inexact |= state.off_limit_intervals
    if at.passed and not state.settled and (fixed is None or not (inexact | over).any()):
        # If arcs are fixed between switch times, limits become active and inactive at the switch times.
        uneven = rough_of(at.found.motion)
    return inexact, uneven


def _marked(state: RefinementState, inexact: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Return the intervals (n,) to halve, of those that are inexact and those on which limits are overrun."""
    at, fixed = state.iterate, state.iterate.found.fixed
    if state.target.enclosed:  # efforts jump inside intervals: the certificate's requirements come first
        needed = marked_for(at, 1.0)
        return needed if needed.any() or at.report is None else inexact
    if over.any() and _switches_are_open(state):
        inexact = over  # an arc shorter than an interval must be resolved before its ends can be unknowns
    # If all efforts are fixed on arcs, any overrun is mesh error. Tightening by it would make the motion slower.
    held = fixed is not None and fixed.everything and bool(fixed.paths.any())
    fits = grown(at.found.mesh, inexact | over) <= (_most_intervals(state, held=held) if held else _comfortable(state))
    return inexact | over if fits else inexact


def _higher_scheme(state: RefinementState, inexact: np.ndarray, over: np.ndarray) -> str | None:
    """Return the scheme of higher degree if it is better than a finer mesh, else None."""
    at = state.iterate
    if state.degree_lost:
        return None
    higher = None if state.target.enclosed else higher_on_arcs(state.case, at, over)
    if higher is None and not (over.any() and _switches_are_open(state)):
        higher = higher_for(state.case, at.report, inexact)
    return None if higher is not None and state.target.enclosed and degree_of(higher) > MAX_ROUGH_DEGREE else higher


def _comfortable(state: RefinementState) -> int:
    """Return the number of intervals beyond which a motion that passes its certificate is not refined."""
    target = state.target
    if target.tolerance_given:
        return MAX_GROWTH * state.asked.problem.mesh.intervals
    rough = state.change > CHANGE_WORTH_INTERVALS if state.target.enclosed else state.moved > OPTIMAL_CHANGE
    return ENOUGH_ROUGH_INTERVALS if rough else ENOUGH_INTERVALS


def _most_intervals(state: RefinementState, *, held: bool = False) -> int:
    """Return the number of intervals beyond which the mesh is not refined."""
    wanders = not (
        state.error_falls or state.target.has_boundary_layers or state.iterate.report is None or state.iterate.report.exact
    )
    wanders = wanders and not state.target.enclosed and not overrunning(state.iterate).any()
    most = MAX_GROWTH * state.asked.problem.mesh.intervals
    return _comfortable(state) if (state.best is not None or wanders) and not held else most


def refine(case: Case, found: Iterate, *, warm: bool = False) -> Refined | None:
    """Return the best motion towards the tolerance, or None without a certificate.

    The certificate may not pass: then the motion is the last one tried.

    Args:
        case: the problem, with its own limits.
        found: the first solution.
        warm: whether finer meshes start close to the coarser solution, which is less exact but does not lose an unstable
            motion.
    """
    state = first_state(case, found, warm=warm)
    while (action := next_action(state)) is not None:
        check()
        state = action.apply(state)
    return state.result


def first_state(case: Case, found: Iterate, *, warm: bool) -> RefinementState:
    """Return the first state of a solution, with switch times as unknowns where efforts jump."""
    if case.target.switches:
        found = settle_switch_times(case, found)
    at = certify_iterate(case, found)
    return observed(RefinementState(asked=case, case=case, iterate=at, warm=warm), at)
