"""From one start to a plan: solved, refined until its certificate passes, repaired where it does not.

A tracking motion is first solved with a small weight on the squared effort rate. Without it, the motion nearest in position
chatters at the ends of its bang arcs (Fuller's phenomenon), and solvers fail. Then the weight is reduced in steps, down to a
thousandth, on finer meshes.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from linkplan.planner.certificate.certificate import certify
from linkplan.planner.certificate.further_checks import surely_collides, unavoidable
from linkplan.planner.closed_chain.case import MechanismCase, case_of, finished
from linkplan.planner.closed_chain.formulate import SMOOTHING_WEIGHT
from linkplan.planner.closed_chain.guess import Guess, closes
from linkplan.planner.closed_chain.transcribe import own_objective
from linkplan.planner.limits.rates import smooth_columns
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import failed, out_of_time
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import Iterate, attempt, with_scheme
from linkplan.planner.refinement.decision import refine
from linkplan.planner.refinement.history import recorded
from linkplan.planner.refinement.state import OPTIMAL_CHANGE, REPORTED_CHANGE, Refined
from linkplan.planner.search.finer_meshes import EXACT_TRACKING_SHARE, refine_several
from linkplan.planner.search.methods import Budget, Search
from linkplan.planner.search.solving import (
    GRID_ERROR_FACTOR,
    INTERVALS_PER_SWING,
    first_mesh,
    graded_mesh,
    with_longer_durations,
)
from linkplan.planner.solvers.solve import NO_MOTION
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.mesh import halved

# The decreasing weights of the smoothing of efforts (continuation).
_SMOOTHING_WEIGHTS = tuple(share * SMOOTHING_WEIGHT for share in (1e-1, 1e-2, 1e-3))
# The mesh of a tracking motion is halved up to this number of intervals.
_MAX_INTERVALS = 160
# An acceleration without jumps takes an interval from one of its limits to the other, so that coarse meshes may have no
# motion: in 1 % more than the least time it needs 80 intervals. The first mesh is halved up to this number of times.
_FINER_MESHES = 2


def plan_from(
    search: Search,
    budget: Budget,
    what: str,
    guess: Guess,
    *,
    worth: float = np.inf,
    least: float = -np.inf,
    repaired: bool = True,
    graded: bool = False,
) -> Plan | None:
    """Return the plan from a start, whether its certificate passes or not; None if no motion is found.

    Args:
        search: the search.
        budget: of the solves.
        what: the name of the start in messages.
        guess: the start.
        worth: refine only solutions with an objective below this,
        least: and at least this, because coarse meshes have false motions that cost far too little.
        repaired: whether every repair is tried on a motion that does not pass; False until the phase plane's least time is
            known.
        graded: whether the first mesh is finer where the start is fast.
    """
    problem = search.within(budget)
    missed = None
    for found in _solved(problem, guess, f"start from {what}" if recorded() else "first solve", search, graded=graded):
        if not least <= found.solution.objective < worth:
            continue
        found, unbounded = with_longer_durations(problem, found)
        if unbounded is not None:
            search.verdicts.append(Plan(problem=search.problem, verdict=unbounded))
            return None
        # The refinement of a motion that was found in few iterations may take more iterations.
        missed = refined(search, search.within(replace(budget, iterations=None)), found, repaired=repaired)
        if missed.passed:
            return missed
    if missed is None or missed.trajectory is None or missed.certificate is None:
        return missed
    if unavoidable(problem, missed.trajectory, missed.certificate):
        search.verdicts.append(missed)  # every other motion has the same contact
    return missed


def of_several(problem: Problem) -> bool:
    """True if motions of several motors are refined by `refine_several`, on a mesh and with limits that allow it.

    One motor that drives several coordinates swings them; such motions are unstable and need more exact meshes.
    """
    return min(problem.mechanism.n_equations, problem.mechanism.n_u) > 1 and problem.mesh.breaks is None


def _solved(problem: Problem, guess: Guess, word: str, search: Search, *, graded: bool) -> Iterator[Iterate]:
    """Yield solutions from a start, the most promising first.

    If the phase plane's switches are known, efforts are fixed between them and only the switch times are unknown. If this
    does not lead to the phase plane's time, the efforts are free; the time on a mesh without switches may be too short by
    the mesh error.
    """
    if not closes(problem, guess):
        return
    case, found, is_first = case_of(problem), [], not recorded()
    if guess.switch_times_s is not None and search.only_time_counts:
        n = max(problem.mesh.intervals, INTERVALS_PER_SWING * guess.swings)
        held = f"{word}, bang efforts fixed"
        along = graded_mesh(guess, guess.switch_times_s, n)
        first = attempt(case, guess, *along, held, bang_efforts=guess.bang_efforts)
        if first is not None and first.solution.objective <= GRID_ERROR_FACTOR * guess.duration_s:
            yield first
        else:
            found.append(first)
    graded = graded and problem.mesh.breaks is None
    mesh = graded_mesh(guess, np.zeros(0), problem.mesh.intervals) if graded else first_mesh(problem, guess)
    found.append(attempt(case, guess, *mesh, word))
    finer = is_first and bool(smooth_columns(problem)) and problem.mesh.breaks is None
    for _ in range(_FINER_MESHES if finer else 0):
        if any(found) or [step.solver_status for step in recorded()[-1:]] != [NO_MOTION]:
            break
        mesh = halved(mesh[0], np.ones(mesh[0].n_intervals, dtype=bool)), mesh[1]
        found.append(attempt(case, guess, *mesh, f"{word}, finer mesh"))
    yield from sorted(
        (one for one in found if one is not None), key=lambda one: abs(one.solution.objective - guess.duration_s)
    )


def refined(search: Search, problem: Problem, found: Iterate, *, repaired: bool = True) -> Plan:
    """Return the plan of a first solution; if its certificate does not pass, the search's repairs are tried in turn."""
    plan = certified(problem, found)
    for repair in search.repairs if repaired else [repair for repair in search.repairs if repair.always]:
        if not plan.passed and repair.tried(problem, plan):
            plan = repair.repair(problem, found) or plan
    return plan


def certified(
    problem: Problem,
    found: Iterate,
    *,
    warm: bool = False,
    kinks: bool = True,
    enclosed: bool = False,
) -> Plan:
    """Return the plan of a solution, refined until its certificate passes; `case_of` describes `kinks` and `enclosed`."""
    colliding = surely_collides(problem, found.motion)
    if colliding is not None:
        return finished(problem, found.motion, colliding, found.solution.objective, None)
    case = case_of(problem, kinks=kinks, enclosed=enclosed)
    if problem.objective.is_smoothed and problem.objective.has("tracking"):
        better, change = _unsmoothed(case, found, warm)
    else:
        better, change = _refined(case, found, warm=warm), None
    return _plan_of(problem, better, change)


def certified_at(problem: Problem, plan: Plan, shares: tuple[float, ...]) -> Plan | None:
    """Return a plan refined at shares of its duration, where a proof refutes it; None if a finer mesh has no motion.

    Its certificate has samples there, too. A plan without a program has no finer mesh.
    """
    if plan.solved is None:
        return None
    solved, motion = plan.solved, plan.require_motion("refine")
    of = {"smoothing": solved.origin.smoothing, "ties": solved.origin.ties, "sampled_at": shares}
    case = replace(with_scheme(case_of(problem), solved.scheme.name), **of)
    marked = np.histogram(motion.breaks_s[0] + np.array(shares) * motion.duration_s, motion.breaks_s)[0] > 0
    mesh, durations = solved.program.mesh, np.bincount(solved.program.mesh.segment, np.diff(motion.breaks_s))
    what = "finer mesh where the proof refutes a limit"
    found = attempt(case, case.start_from(motion), halved(mesh, marked), durations, what, warm=True)
    return None if found is None else _plan_of(problem, refine(case, found, warm=True), None)


def _plan_of(problem: Problem, better: Refined | None, change: float | None) -> Plan:
    """Return the plan of a refined motion; `change` is its objective's relative change on a finer mesh, if known."""
    if better is None:
        verdict = failed("the motion that the solver returned leaves the branch on which the mechanism was assembled")
        if problem.solver.judging_deadline.passed:
            verdict = out_of_time(problem.solver.max_time_s)
        return Plan(problem=problem, verdict=verdict, history=recorded())
    solution = better.solution
    objective = own_objective(solution.transcribed, solution.objective, better.motion)
    moved = better.moved if change is None else change
    against = better.arcs_with_wrong_sign
    optimal = not len(against) and moved <= OPTIMAL_CHANGE
    plan = finished(problem, better.motion, better.certificate, objective, None, optimal=optimal)
    said = f"on a finer mesh its objective still changed by {100 * moved:.1g} %" if moved > REPORTED_CHANGE else ""
    at_arc = ""
    if len(against):
        at_arc = (
            f"on the arc at t = {against[0]:.4g} s the optimum would leave the limit (Pontryagin's principle): not a"
            " local optimum"
        )
    if plan.passed:
        plan = plan.adding(said, at_arc)
    return replace(plan, solved=replace(solution.transcribed, start=solution.x))


def without_solving(
    problem: Problem,
    motion: Trajectory,
    objective: float,
    said: str,
    *further: str,
    best: str | None = None,
) -> Plan:
    """Return the plan of a motion that was constructed without a solve: "feasible" if its certificate passes.

    `said` are its words, `further` phrases after them. It is "optimal", with the words `best`, if its efforts equal those by
    inverse dynamics.
    """
    certificate = certify(problem, motion)
    # Efforts that differ by at most this share of the largest effort count as equal.
    optimal = best is not None and certificate.dynamics_residual <= 1e-6 * np.abs(motion.effort).max()
    words = best if optimal else said
    return finished(problem, motion, certificate, objective, words, optimal=optimal, further=() if optimal else further)


def unsound(plan: Plan) -> bool:
    """True if a motion's certificate does not pass for reasons that another solve may remove."""
    return plan.certificate is not None and plan.certificate.repairable


def from_next_to_it(problem: Problem, found: Iterate) -> Plan | None:
    """Return the plan whose finer meshes start warm at the coarser solution; None if it does not pass."""
    # Ignore kinks of efforts that do not jump: they change the objective by at most 0.1 %.
    plan = certified(problem, found, warm=True, kinks=False)
    return plan if plan.passed else None


def may_be_enclosed(problem: Problem, plan: Plan) -> bool:
    """True if limits are overrun between the nodes and rows on coefficients may prevent it."""
    margins = () if plan.certificate is None else plan.certificate.margins
    overrun = any(margin.of.facts.enclosable and not margin.kept for margin in margins)
    return problem.mesh.effort == "polynomial" and overrun and not case_of(problem).enclosed


def enclosed(problem: Problem, found: Iterate) -> Plan | None:
    """Return the plan with enclosable limits at every instant; None if it does not pass."""
    plan = certified(problem, found, enclosed=True)
    return plan if plan.passed else None


def objective_of(at: Iterate) -> float:
    """Return the objective of a motion without the weights on its effort rate and on ties."""
    return own_objective(at.solution.transcribed, at.solution.objective, at.motion)


def _smoothed(
    case: MechanismCase, at: Iterate, smoothing: float, *, finer: bool = False
) -> tuple[MechanismCase, Iterate] | None:
    """Solve with a weight on the effort rate, on intervals that are all halved if `finer`; None if no motion is found."""
    mesh = halved(at.mesh, np.full(at.mesh.n_intervals, finer))
    now = replace(with_scheme(case, at.solution.transcribed.scheme.name), smoothing=smoothing)
    what = f"smoothing of efforts {smoothing / SMOOTHING_WEIGHT:.3g} of the first" + (", finer mesh" if finer else "")
    found = attempt(now, now.start_from(at.motion), mesh, at.durations, what, warm=True)
    return None if found is None else (now, found)


def _refined(case: MechanismCase, found: Iterate, *, warm: bool) -> Refined | None:
    """Return the refined motion of a solution, by the refinement for its number of motors; None without one."""
    return refine_several(case, found) if of_several(case.asked) else refine(case, found, warm=warm)


def _unsmoothed(case: MechanismCase, first: Iterate, warm: bool) -> tuple[Refined | None, float | None]:
    """Return a refined tracking motion with its smoothing removed, and the relative change of its objective on a finer mesh.

    The weight falls to a tenth from solve to solve. The result is the motion with the least weight that passes after its
    refinement, or the first one if none passes.
    """
    nothing = EXACT_TRACKING_SHARE * first.solution.transcribed.units.objective
    solves = [(case, first)]
    for weight in _SMOOTHING_WEIGHTS if objective_of(first) > nothing else ():
        lighter = _smoothed(*solves[-1], weight)
        if lighter is None:
            break
        solves.append(lighter)
    at, change = None, None
    for case, found in reversed(solves):
        at = _refined(case, found, warm=warm or found is not first)
        if at is not None and at.certificate.passed:
            break
    if at is None or not at.certificate.passed or of_several(case.asked):  # its meshes are already fine enough
        return at, None
    while 2 * at.mesh.n_intervals <= _MAX_INTERVALS and objective_of(at) > nothing:
        solved = _smoothed(case, at, case.smoothing, finer=True)
        finer = None if solved is None else refine(*solved, warm=True)
        if finer is None or not finer.certificate.passed or objective_of(finer) > objective_of(at):
            break
        change, at = objective_of(at) / objective_of(finer) - 1, finer
        if change <= REPORTED_CHANGE:
            break
    return at, change
