"""The rung of waiting: the motion of least time, and rest before or after it for as long as is left.

Where a longer motion is asked for and start or goal can be held at rest, that is a motion: no start that the solver could be
given is nearer to one. It is begun on the least-time motion's own mesh, with one segment more for the rest.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import close_at
from linkplan.planner.closed_chain.guess import Guess, motion_of
from linkplan.planner.plan import Plan
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.search.attempts import refined
from linkplan.planner.search.ladder import Budget, Search
from linkplan.planner.search.least_time import shortest_motion
from linkplan.planner.search.solving import solve_from
from linkplan.planner.transcription.mesh import Mesh

# Efforts that hold a pose are within their limits and miss no more than this share of the largest; a wait shorter than this
# share of the duration is none.
_HELD, _NO_WAIT = 1e-9, 1e-9
# Intervals of the rest.
_RESTING = 10


def may_wait(search: Search) -> bool:
    """Return whether a motion of fixed duration starts or ends in rest that efforts within their limits can hold."""
    motion = search.problem.motion
    if motion.kind != "reach" or motion.duration_s is None or motion.stays or motion.waypoints:
        return False
    return any(_held(search.problem, end) is not None for end in ("start", "goal"))


def from_waiting(search: Search, budget: Budget) -> Plan | None:
    """Return the plan that the least-time motion leads to with a rest before or after it; None where neither passes."""
    quick = shortest_motion(search)
    if quick is None or quick.solved is None or quick.solved.program.mesh.n_phases > 1:
        return None
    problem = search.within(budget)
    wait = problem.motion.duration_s - quick.trajectory.duration_s
    if wait <= _NO_WAIT * problem.motion.duration_s:
        return None
    for what, guess, mesh, durations in _waits(problem, quick, wait):
        for warm in (True, False):
            found = solve_from(
                replace(problem, guess=None), guess, mesh, durations, what, search.history, search.say, warm=warm
            )
            plan = None if found is None else refined(search, problem, found)
            if plan is not None and plan.status == "optimal":
                return plan
    return None


def _waits(problem: PlanningProblem, quick: Plan, wait: float) -> Iterator[tuple[str, Guess, Mesh, np.ndarray]]:
    motion, mesh = motion_of(quick.trajectory), quick.solved.program.mesh
    lengths = np.bincount(mesh.segment, weights=np.diff(quick.trajectory.breaks_s))
    rest = np.full(_RESTING, 1.0 / _RESTING)
    for end in ("start", "goal"):
        effort = _held(problem, end)
        if effort is None:
            continue
        first = end == "start"
        segment = [np.zeros(_RESTING, dtype=int), mesh.segment + 1]
        if not first:
            segment = [mesh.segment, np.full(_RESTING, mesh.n_segments)]
        parts = (rest, mesh.fraction) if first else (mesh.fraction, rest)
        longer = Mesh(fraction=np.concatenate(parts), segment=np.concatenate(segment))
        durations = np.concatenate([[wait], lengths] if first else [lengths, [wait]])
        word = f"the least-time motion and a rest of {wait:.4g} s {'before' if first else 'after'} it"
        yield word, _rested(motion, wait, effort, first=first), longer, durations


def _rested(motion: Guess, wait: float, effort: np.ndarray, *, first: bool) -> Guess:
    """Return a motion with a rest before or after it, in which an effort (n_u,) holds it."""
    begin, duration = (wait if first else 0.0), motion.duration_s

    def moving(at: np.ndarray) -> np.ndarray:
        return ((at >= begin) & (at <= begin + duration))[:, None]

    def inside(at: np.ndarray) -> np.ndarray:
        return np.clip(np.asarray(at) - begin, 0.0, duration)

    planned = motion.effort
    assert planned is not None  # of a motion that was solved for
    return replace(
        motion,
        position=lambda t: motion.position(inside(t)),
        velocity=lambda t: np.where(moving(t), motion.velocity(inside(t)), 0.0),
        acceleration=lambda t: np.where(moving(t), motion.acceleration(inside(t)), 0.0),
        effort=lambda t: np.where(moving(t), planned(inside(t)), effort),
        duration_s=duration + wait,
    )


def _held(problem: PlanningProblem, end: str) -> np.ndarray | None:
    """Return the effort (n_u,) that holds start or goal, at rest there; None where none within the limits does."""
    motion, mechanism, limit = problem.motion, problem.mechanism, problem.limits.effort
    if end == "goal" and motion.goal_is_free:
        return None  # where it ends is not known
    speed = getattr(motion, f"{end}_speed")
    if speed is not None and np.any(speed != 0):
        return None
    still = np.zeros((1, mechanism.dof))
    effort, missed = needed_effort(mechanism, close_at(mechanism, getattr(motion, end))[None], still, still)
    slack = _HELD * np.where(np.isfinite(limit), np.abs(limit), 0.0).max(initial=1.0)
    if np.abs(missed).max() > slack or np.any(effort[0] < limit[:, 0] - slack) or np.any(effort[0] > limit[:, 1] + slack):
        return None
    return effort[0]
