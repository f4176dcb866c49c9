"""Continuation in the effort limits, from the motion of least peak effort, for problems that no start solves."""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.closed_chain.guess import Guess, motion_of
from linkplan.planner.plan import Plan
from linkplan.planner.search.attempts import certified
from linkplan.planner.search.continuation import Steps, followed
from linkplan.planner.search.ladder import Budget, Search
from linkplan.planner.search.solving import Iterate, solve_from

# Continuation in the effort limits begins at most at this factor. Its first step is the whole way; the smallest one is a
# quarter of it in the logarithm.
_MAX_FIRST_FACTOR, _MAX_STEPS = 0.999, 6


def efforts_suffice(search: Search) -> bool:
    """True if the motion of least peak effort keeps the effort limits."""
    return search.least_limit is not None and search.least_limit.factor <= 1.0


def from_least_peak_effort(search: Search, budget: Budget) -> Plan | None:
    """Return the plan that the motion of least peak effort leads to, by limits that grow to those asked for."""
    problem, least = search.within(budget), search.least_limit

    def solve(at: _Limited, factor: float) -> _Limited | None:
        whole = factor == 1.0
        limits = problem.limits if whole else replace(problem.limits, effort=factor * problem.limits.effort)
        what = "start from the motion of least peak effort" + ("" if whole else f", {factor:.4g} of the limits")
        found = solve_from(replace(problem, limits=limits), at.start, least.mesh, at.durations, what)
        if found is None:
            return None
        durations = np.bincount(least.mesh.segment, np.diff(found.motion.breaks_s))
        return _Limited(start=motion_of(found.motion), durations=durations, found=found)

    begin = min(least.factor, _MAX_FIRST_FACTOR)
    steps = Steps(begin=begin, end=1.0, factor=1.0 / begin, halvings=2, most=_MAX_STEPS)
    path = followed(_Limited(start=motion_of(least.trajectory), durations=least.durations), steps, solve)
    found = path.stages[-1].found
    return certified(problem, found) if path.arrived and found is not None else None


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Limited:
    """A motion within a share of the effort limits, as a start; its solution, but for the first."""

    start: Guess
    durations: np.ndarray  # (n_segments,) [s]
    found: Iterate | None = None
