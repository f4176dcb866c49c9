"""Continuation in the duration, from a motion of least time to a longer one.

Solvers lose long motions under weak actuators. A swing amplifies the error of a coarse mesh, and a false motion between its
nodes is cheaper than any true one. A motion of least time is found reliably. With a little more time the best motion is
near it, and so on from one motion to the next.
"""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import Guess, guess_from, poses_along, stretched
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import attempt, share_gained
from linkplan.planner.refinement.decision import refine
from linkplan.planner.refinement.switches import at_bounds
from linkplan.planner.search.attempts import certified, only_feasible
from linkplan.planner.search.ladder import Budget, KnownMotions, Search, Steps, followed
from linkplan.planner.search.solving import INTERVALS_PER_SWING, graded_mesh, longest, solve_from
from linkplan.planner.search.starts import least_time_motion, no_time, shortest_motion, with_switch_times
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.mesh import Mesh, uniform

# The factor between successive durations. The smallest step, after lost ones, is a quarter in the logarithm.
DURATION_FACTOR = 1.15
# A free duration is long enough if the last step saved less than this share of the objective, or if the motion ends before
# its limit by more than the second share.
MIN_SAVING, _MIN_UNUSED_SHARE = 1e-3, 1e-3


def nears_singular(problem: Problem, guess: Guess) -> bool:
    """True if a motion comes nearer than half the distance of its ends to a singular pose."""
    times = np.linspace(0.0, guess.duration_s, 1001)
    ratios = singularity_ratios(problem, poses_along(problem.mechanism, guess, times, problem.solver.deadline))
    return bool(ratios.min() < 0.5 * ratios[[0, -1]].min())


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Continued:
    """A motion on the way: a start, its mesh and transcription, and the longest duration it was allowed [s].

    `shares` (n_segments,) of the start's duration are those of its mesh's segments.
    """

    start: Guess
    mesh: Mesh
    shares: np.ndarray
    scheme: str
    longest_s: float
    objective: float = np.inf
    motion: Trajectory | None = None  # certified; None for the first one
    held: bool = False  # whether the windows of switch times hold it
    enough: bool = False  # whether the last step saved less than `MIN_SAVING` of the objective
    lost: bool = False  # whether longer motions were lost


def from_continuation(search: Search, budget: Budget) -> Plan | None:
    """Return the plan reached from the motion of least time step by step; None if a step is lost."""
    problem = search.within(budget)
    swung, swings = _quickest(search, budget)
    if swung is None or swung.duration_s > longest(problem):
        return None
    n_intervals = max(2 * problem.mesh.intervals, INTERVALS_PER_SWING * swings)
    at = continued(problem, swung, n_intervals, search.known)
    if at is None:
        return None
    final = replace(problem, mesh=problem.mesh.replace(scheme=at.scheme), guess=None)
    if problem.motion.duration_s is None:  # if the motion ends earlier, this bound changes nothing
        final = replace(final, motion=replace(problem.motion, max_duration_s=at.longest_s))
    durations, what = at.shares * at.start.duration_s, "at its full length"
    found = solve_from(final, at.start, at.mesh, durations, what, warm=True)
    plan = None if found is None else certified(final, found, warm=True)
    if plan is None or not plan.passed:
        return None
    if at.lost:
        why = f"; the best within {at.longest_s:.5g} s: longer motions were lost on the way, better ones may exist"
        return only_feasible(plan, why)
    if at.enough:
        last = f"; the last {DURATION_FACTOR - 1:.0%} of its duration reduced the objective by less than {MIN_SAVING:.1%}"
        said = f"{last}, so longer motions were not tried"
        return replace(plan, message=plan.message + said)
    return plan


def may_be_lengthened(search: Search) -> bool:
    """True if a least-time motion is known, or worth a search, from which longer motions can be continued."""
    problem = search.problem
    if search.quickest is not None:
        return search.quickest.boundaries_s is None and not no_time(search)
    motion = problem.motion
    of_fixed_length = motion.kind == "reach" and motion.duration_s is not None and not motion.stays and not motion.waypoints
    return of_fixed_length and bool(np.all(np.isfinite(problem.limits.effort)))


def _quickest(search: Search, budget: Budget) -> tuple[Guess | None, int]:
    """Return the motion of least time with its switch times, and its swings: the phase plane's, else the ladder's."""
    if search.quickest is not None:
        return least_time_motion(search, budget), search.quickest.swings
    plan = shortest_motion(search)
    return (None if plan is None else with_switch_times(plan)), 1


def continued(problem: Problem, quickest: Guess, n_intervals: int, known: KnownMotions) -> Continued | None:
    """Return the best motion of a problem, continued from a motion of least time; None if it is lost.

    If the duration is free, every motion on the way solves the problem, and the last one is returned if longer ones are
    lost.

    Args:
        problem: of a fixed duration, or of a free one.
        quickest: a motion that keeps the dynamics in less time.
        n_intervals: of the first mesh.
        known: the motions on the way are added to it.
    """
    fixed, least = problem.motion.duration_s is not None, problem.motion.min_duration_s or 0.0

    def solve(at: Continued, allowed: float) -> Continued | None:
        found = _step(problem, at, allowed)
        # Switch times at the ends of their windows are solved for again, at most so often.
        for _ in range(5):
            if found is None or not found.held:
                break
            before, found = found, _step(problem, found, allowed) or found
            if _saved_little(before, found):
                break  # the bounds are not decisive, or nothing more can be gained
        if found is not None and found.motion is not None:
            known.add(found.motion)
        return found

    def enough(before: Continued, after: Continued, whole: bool) -> bool:
        if fixed or after.held or after.longest_s < least:
            return False
        return after.start.duration_s < (1 - _MIN_UNUSED_SHARE) * after.longest_s or (whole and _saved_little(before, after))

    def finer(at: Continued) -> Continued:
        if nears_singular(problem, at.start):
            return at  # near a singular pose no mesh is fine enough
        # Bounds on switch times do not restrict a free duration.
        switches = (np.cumsum(at.shares) * at.start.duration_s)[:-1] if fixed else np.empty(0)
        # A lost step is tried again on twice as many intervals, up to this number.
        mesh, durations = graded_mesh(at.start, switches, min(2 * at.mesh.n_intervals, 320))
        return replace(at, mesh=mesh, shares=durations / durations.sum())

    # Near the least time a motion is nearly bang-bang, and a mesh without its switches may have no solution.
    mesh, shares = uniform(n_intervals), np.ones(1)
    if quickest.switch_times_s is not None:
        mesh, durations = graded_mesh(quickest, quickest.switch_times_s, n_intervals)
        shares = durations / durations.sum()
    begin = Continued(start=quickest, mesh=mesh, shares=shares, scheme=problem.mesh.scheme, longest_s=quickest.duration_s)
    whole = min(DURATION_FACTOR, longest(problem) / quickest.duration_s)
    steps = Steps(begin=quickest.duration_s, end=longest(problem), factor=whole, halvings=2)
    path = followed(begin, steps, solve, enough=enough, after_loss=finer)
    at = path.stages[-1]
    if not path.arrived:
        return None if fixed or len(path.stages) == 1 or at.longest_s < least else replace(at, lost=True)
    to_the_full = (1 - _MIN_UNUSED_SHARE) * at.longest_s <= at.start.duration_s < longest(problem)
    return replace(at, enough=not fixed and to_the_full and len(path.stages) > 1 and _saved_little(path.stages[-2], at))


def _saved_little(before: Continued, after: Continued) -> bool:
    return share_gained(before.objective, after.objective) < MIN_SAVING


def _step(problem: Problem, at: Continued, allowed: float) -> Continued | None:
    """Return the best motion within a duration, started from a shorter one; None if it is lost."""
    fixed, least = problem.motion.duration_s is not None, problem.motion.min_duration_s
    motion = replace(problem.motion, min_duration_s=least if least is not None and least <= allowed else None)
    motion = replace(motion, duration_s=allowed) if fixed else replace(motion, max_duration_s=allowed)
    # Integration error allowed for the motions on the way [deg].
    mesh = problem.mesh.replace(tolerance_deg=0.01, scheme=at.scheme, breaks=None)
    case = case_of(replace(problem, motion=motion, mesh=mesh, guess=None))
    start = stretched(at.start, allowed) if fixed else at.start
    durations = at.shares * start.duration_s
    what = f"the least-time motion continued to {allowed:.4g} s"
    found = attempt(case, start, at.mesh, durations, what, warm=True)
    better = None if found is None else refine(case, found, warm=True)
    if better is None or not better.certificate.passed:
        return None
    return Continued(
        start=guess_from(better.motion),
        mesh=better.mesh,
        shares=better.durations / better.durations.sum(),
        scheme=better.solution.transcribed.scheme.name,
        longest_s=allowed,
        objective=better.solution.objective,
        motion=better.motion,
        held=not fixed and better.mesh.n_segments > 1 and at_bounds(better.solution),
    )
