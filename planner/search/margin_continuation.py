"""Continuation in the margin to singular poses, where no motion is found that may come as near to one as it likes.

With time to spare, the least of efforts builds up energy or rests next to a dead centre, in the limit on it: there the
reduced dynamics are stiff without bound and no mesh is fine enough. With a margin to singular poses, made smaller from
solve to solve, the motion stays one that can be computed; what a smaller margin would still save is said to be unknown.
"""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.poses.along import sampled
from linkplan.planner.closed_chain.guess import Guess, closes, motion_of, poses_along
from linkplan.planner.plan import Plan
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.history import Say, Step
from linkplan.planner.search.attempts import certified
from linkplan.planner.search.continuation import Steps, followed
from linkplan.planner.search.first_mesh import first_mesh
from linkplan.planner.search.ladder import Budget, Search
from linkplan.planner.search.solving import Iterate, solve_from
from linkplan.planner.transcription.mesh import Mesh

# Margins tried, as shares of what start and goal themselves keep: from the largest, by halves, to the least.
_LARGEST, _HALF, _SMALLEST, _MARGINS = 0.48, 0.5, 0.03, 5
# The objective has settled where a smaller margin saves less than this share of it.
_SETTLED = 0.02
# A motion nears a singular pose where it comes below this share of the distance at its ends, at so many instants.
_NEAR, _SAMPLES = 0.5, 1001


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Clear:
    """A motion that keeps a margin, and the problem that asks for it; the start alone, before the first."""

    problem: PlanningProblem
    start: Guess
    durations: np.ndarray
    found: Iterate | None = None


def may_be_kept_clear(problem: PlanningProblem) -> bool:
    """Return whether a margin to singular poses could be kept that was not asked for."""
    return problem.limits.singular_margin == 0 and bool(problem.mechanism.dynamics.block_singularity.numel_out(0))


def from_margins(search: Search, budget: Budget) -> Plan | None:
    """Return a plan that keeps a margin to singular poses which was not asked for and which its message names."""
    problem = search.within(budget)
    for what, guess in search.first_starts():
        if not closes(problem, guess):
            continue
        for clear in reversed(kept_clear(problem, what, guess, search.history, search.say)):
            plan = certified(clear.problem, clear.found, search.history, search.say, warm=True)
            if plan.passed:
                margin = clear.problem.limits.singular_margin
                kept = f"kept clear of singular poses by {margin:.2g} of home's |det J_z|"
                message = f"{plan.message}, {kept}: none was found without that"
                return replace(plan, problem=search.problem, status="feasible", message=message)
    return None


def kept_clear(problem: PlanningProblem, what: str, guess: Guess, history: list[Step], say: Say) -> list[_Clear]:
    """Return motions that keep ever smaller margins to singular poses, each begun from the one before.

    Args:
        problem: without a margin of its own.
        what: the start, in words.
        guess: a motion to start from that closes the loops.
        history: where solves are noted.
        say: called with a line of progress now and then.
    """
    mesh, durations = first_mesh(problem, guess)
    room = min(_singular_margin(problem, guess, np.array([0.0, guess.duration_s])), 1.0)

    def solve(at: _Clear, share: float) -> _Clear | None:
        return _with_margin(problem, mesh, at, share * room, what, history, say)

    def settled(before: _Clear, after: _Clear, whole: bool) -> bool:
        del whole
        if before.found is None:
            return False
        return after.found.solution.objective > (1 - _SETTLED) * before.found.solution.objective

    steps = Steps(begin=_LARGEST / _HALF, end=_SMALLEST, factor=_HALF, least=_HALF, most=_MARGINS)
    path = followed(_Clear(problem=problem, start=guess, durations=durations), steps, solve, enough=settled)
    passed = path.stages[1:]
    if len(passed) > 1 and settled(passed[-2], passed[-1], True):
        passed = passed[:-1]  # what it saves is not worth being nearer
    return list(passed)


def _with_margin(
    problem: PlanningProblem, mesh: Mesh, at: _Clear, margin: float, what: str, history: list[Step], say: Say
) -> _Clear | None:
    clear = replace(problem, limits=replace(problem.limits, singular_margin=margin))
    word = f"{what}, {margin:.2g} clear of singular poses"
    warm = at.found is not None
    found = solve_from(clear, at.start, mesh, at.durations, word, history, say, warm=warm)
    if found is None:
        return None
    durations = np.bincount(mesh.segment, weights=np.diff(found.motion.breaks_s))
    return _Clear(problem=clear, start=motion_of(found.motion), durations=durations, found=found)


def nears_singular(problem: PlanningProblem, guess: Guess) -> bool:
    """Return whether a motion comes much nearer to a singular pose than its ends are."""
    nearest = _singular_margin(problem, guess, np.linspace(0.0, guess.duration_s, _SAMPLES))
    return nearest < _NEAR * _singular_margin(problem, guess, np.array([0.0, guess.duration_s]))


def _singular_margin(problem: PlanningProblem, guess: Guess, times: np.ndarray) -> float:
    """Return the least |det J_z| of a kinematic loop at times (n,) [s] of a guess, as a share of home's; else infinite."""
    singularity = problem.mechanism.dynamics.block_singularity
    poses = poses_along(problem.mechanism, guess, times, problem.solver.deadline)
    share = sampled(singularity, poses)[:, :, 0] / np.array(singularity(problem.mechanism.home)).ravel()
    return float(np.abs(share).min(initial=np.inf))
