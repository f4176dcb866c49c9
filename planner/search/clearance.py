"""Motions kept clear of singular poses, where none is found that may come as near to one as it likes.

With time to spare, the least of efforts gathers way or rests next to a dead centre, in the limit on it: there the reduced
dynamics are stiff without end and no mesh is fine enough. With a margin to singular poses, that is drawn in from solve to
solve, the motion stays one that can be computed; what a smaller margin would still save is said to be unknown.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from linkplan.models.poses.along import sampled
from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import Guess, closes, motion_of, poses_along
from linkplan.planner.plan import Plan
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.history import Say, Step
from linkplan.planner.search.attempts import certified
from linkplan.planner.search.first_mesh import first_mesh

# Margins tried in turn, as shares of what start and goal themselves keep.
_MARGINS = (0.5, 0.25, 0.12, 0.06, 0.03)
# The objective has settled where a smaller margin saves less than this share of it.
_SETTLED = 0.02
# A motion nears a singular pose where it comes below this share of the distance at its ends, at so many instants.
_NEAR, _SAMPLES = 0.5, 1001


def kept_clear(problem: PlanningProblem, starts: Iterator[tuple[str, Guess]], history: list[Step], say: Say) -> Plan | None:
    """Return a plan that keeps a margin to singular poses that was not asked for, the message naming it; None without one.

    Args:
        problem: without a margin of its own.
        starts: motions to start from, with a word on each.
        history: where steps are noted.
        say: called with a line of progress now and then.
    """
    if problem.limits.singular_margin > 0 or not problem.mechanism.dynamics.block_singularity.numel_out(0):
        return None
    for what, guess in starts:
        if not closes(problem.mechanism, guess):
            continue
        mesh, durations = first_mesh(problem, guess)
        found, room = [], min(_room_at_ends(problem, guess), 1.0)
        for share in _MARGINS:
            clear = replace(problem, limits=replace(problem.limits, singular_margin=share * room))
            word = f"{what}, {clear.limits.singular_margin:.2g} clear of singular poses"
            solved = attempt(case_of(clear), guess, mesh, durations, word, history, say, warm=bool(found))
            if solved is None or (found and solved.solution.objective > (1 - _SETTLED) * found[-1][1].solution.objective):
                break
            found.append((clear, solved))
            guess = motion_of(solved.motion)
            durations = np.bincount(mesh.segment, weights=np.diff(solved.motion.breaks_s))
        for clear, solved in reversed(found):
            plan = certified(clear, solved, history, say, warm=True)
            if plan.status == "optimal":
                kept = f"kept clear of singular poses by {clear.limits.singular_margin:.2g} of home's |det J_z|"
                return replace(plan, problem=problem, message=f"{plan.message}, {kept}: none was found without that")
    return None


def nears_singular(problem: PlanningProblem, guess: Guess) -> bool:
    """Return whether a motion comes much nearer to a singular pose than its ends are."""
    return _room(problem, guess, np.linspace(0.0, guess.duration_s, _SAMPLES)) < _NEAR * _room_at_ends(problem, guess)


def _room_at_ends(problem: PlanningProblem, guess: Guess) -> float:
    return _room(problem, guess, np.array([0.0, guess.duration_s]))


def _room(problem: PlanningProblem, guess: Guess, times: np.ndarray) -> float:
    """Return the least |det J_z| of a loop at times (n,) [s] of a guess, as a share of home's; infinite without loops."""
    singularity = problem.mechanism.dynamics.block_singularity
    poses = poses_along(problem.mechanism, guess, times)
    share = sampled(singularity, poses)[:, :, 0] / np.array(singularity(problem.mechanism.home)).ravel()
    return float(np.abs(share).min(initial=np.inf))
