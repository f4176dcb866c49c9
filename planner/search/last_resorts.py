"""Rungs for problems that no start solves: a coarser mesh, and the motion of least peak effort."""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.closed_chain.guess import Guess, motion_of
from linkplan.planner.plan import Plan
from linkplan.planner.search.attempts import certified
from linkplan.planner.search.continuation import Steps, followed
from linkplan.planner.search.first_mesh import first_mesh
from linkplan.planner.search.ladder import Budget, Search
from linkplan.planner.search.solving import Found, solve_from

# Continuation in the effort limits begins no nearer to them than this; its first step is the whole way, a quarter of it (in
# its logarithm) the least, and so many are taken at the most.
_BELOW, _LEAST_STEP, _STEPS = 0.999, 0.25, 6
# A mesh so many times coarser, and no coarser than that, is solved first where the fine one is not found from any start.
_COARSER, _COARSEST = 4, 6


def mesh_may_be_coarser(search: Search) -> bool:
    """Return whether the first mesh is fine enough for a coarser one to be worth a try."""
    return first_mesh(search.problem, search.smooth)[0].n_intervals > _COARSER * _COARSEST


def from_a_coarser_mesh(search: Search, budget: Budget) -> Plan | None:
    """Return the plan that a coarser first mesh leads to; None where it does not pass."""
    problem, guess = search.within(budget), search.smooth
    n_intervals = first_mesh(problem, guess)[0].n_intervals // _COARSER
    mesh, durations = first_mesh(problem, guess, n_intervals)
    found = solve_from(problem, guess, mesh, durations, "a coarser mesh", search.history, search.say)
    plan = None if found is None else certified(problem, found, search.history, search.say)
    return plan if plan is not None and plan.passed else None


def efforts_suffice(search: Search) -> bool:
    """Return whether a motion was found whose efforts stay within their limits, when these alone were sought to be small."""
    return search.least_limit is not None and search.least_limit.factor <= 1.0


def from_least_peak_effort(search: Search, budget: Budget) -> Plan | None:
    """Return the plan that the motion of least peak effort leads to, by limits that grow to those asked for."""
    problem, least = search.within(budget), search.least_limit

    def solve(at: _Limited, factor: float) -> _Limited | None:
        whole = factor == 1.0
        limits = problem.limits if whole else replace(problem.limits, effort=factor * problem.limits.effort)
        what = "start from the motion of least peak effort" + ("" if whole else f", {factor:.4g} of the limits")
        found = solve_from(
            replace(problem, limits=limits), at.start, least.mesh, at.durations, what, search.history, search.say
        )
        if found is None:
            return None
        durations = np.bincount(least.mesh.segment, np.diff(found.motion.breaks_s))
        return _Limited(start=motion_of(found.motion), durations=durations, found=found)

    begin = min(least.factor, _BELOW)
    steps = Steps(begin=begin, end=1.0, factor=1.0 / begin, least=begin**-_LEAST_STEP, most=_STEPS)
    path = followed(_Limited(start=motion_of(least.trajectory), durations=least.durations), steps, solve)
    return certified(problem, path.stages[-1].found, search.history, search.say) if path.arrived else None


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Limited:
    """A motion within a share of the effort limits, as a start; its solution, but for the first."""

    start: Guess
    durations: np.ndarray  # (n_segments,) [s]
    found: Found | None = None
