"""The rung of waiting: the motion of least time with a rest before or after it.

If the given duration is longer and start or goal can be held at rest, the least-time motion and a rest are a feasible
motion, and the best start for the solver. The start uses the mesh of the least-time motion with one more segment for the
rest, and its transcription: a coarser one finds false motions between its nodes.
"""

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from linkplan.models.poses.along import HOLDING_TOLERANCE, needed_effort
from linkplan.models.poses.assembly import close_at
from linkplan.planner.certificate.saved import objective_value
from linkplan.planner.closed_chain.guess import Guess, motion_of
from linkplan.planner.keys.kinds import MIN_INTERVAL_SHARE
from linkplan.planner.phase_plane.bang_bang_motions import stretched
from linkplan.planner.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.attempts import certified, refined, without_solving
from linkplan.planner.search.continuations import DURATION_FACTOR
from linkplan.planner.search.ladder import Search
from linkplan.planner.search.rungs import Budget
from linkplan.planner.search.shortest import shortest_motion
from linkplan.planner.search.solving import solve_from
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.mesh import Mesh

# Terms of an objective that a rest adds to by its effort and its length alone.
_STILL_TERMS = {"time", "effort", "copper_loss"}


def may_wait(search: Search) -> bool:
    """True if a motion of fixed duration starts or ends at rest and efforts within their limits can hold that pose."""
    motion = search.problem.motion
    if motion.kind != "reach" or motion.duration_s is None or motion.stays or motion.waypoints:
        return False
    return any(_held(search.problem, end) is not None for end in ("start", "goal"))


def far_beyond(search: Search) -> bool:
    """True if a motion of several driven degrees of freedom is much longer than the least time and may wait.

    Continuation to such a duration takes minutes and loses the motion. A rest is a better start.
    """
    if search.problem.mechanism.dof == 1 or not may_wait(search):
        return False
    quick = shortest_motion(search)
    return quick is not None and search.problem.motion.duration_s > DURATION_FACTOR * quick.trajectory.duration_s


def from_waiting(search: Search, budget: Budget) -> Plan | None:
    """Return the plan that the least-time motion leads to with a rest before or after it; None where none passes.

    If the solver fails from this start, the rest and a certified motion are joined to a motion of the given duration.
    """
    quick = shortest_motion(search)
    if quick is None:
        return None
    if quick.solved is None:  # integrated along limits on power
        return _rest_and_motion(search, budget, quick)
    if quick.solved.program.mesh.n_phases > 1:
        return None
    # With several driven freedoms (a five-bar's swing-up) such a solve may be lost, and takes a tenth of the time left.
    share = 0.1 if search.problem.mechanism.dof > 1 else budget.share_of_time
    problem = _on_its_scheme(search.within(replace(budget, share_of_time=share)), quick)
    wait = problem.motion.duration_s - quick.trajectory.duration_s
    if wait <= MIN_INTERVAL_SHARE * problem.motion.duration_s:
        return None
    for what, guess, mesh, durations in _waits(problem, quick, wait):
        for warm in (True, False):
            found = solve_from(problem, guess, mesh, durations, what, warm=warm)
            plan = None if found is None else refined(search, problem, found)
            if plan is not None and plan.passed:
                return plan
    return _rest_and_motion(search, budget, quick)


def _on_its_scheme(problem: Problem, quick: Plan) -> Problem:
    """Return a problem in the transcription that the least-time motion's certificate passed with."""
    return replace(problem, guess=None, mesh=replace(problem.mesh, scheme=quick.solved.scheme.name))


def _rest_and_motion(search: Search, budget: Budget, quick: Plan) -> Plan | None:
    """Return the cheapest plan of a rest and a known motion beside it; None where no certificate of one passes."""
    if not set(search.problem.objective.weights) <= _STILL_TERMS:
        return None
    problem = search.within(budget)
    asked = problem.motion.duration_s
    assert asked is not None  # a free duration needs no rest
    if len(search.known.motions) == 1 and quick.solved is not None:
        longer = _a_little_longer(search, budget, quick)
        if longer is not None:
            search.known.add(longer.require_motion("wait after"))
    wholes = []
    for end, motion in itertools.product(("start", "goal"), search.known.shorter_than(asked)):
        effort = _held(problem, end)
        if effort is not None:
            wait = asked - motion.duration_s
            whole = _joined(motion, wait, effort, first=end == "start")
            said = (
                f"motion of {asked:.6g} s: a motion of {motion.duration_s:.6g} s and a rest of {wait:.4g} s"
                f" {'before' if end == 'start' else 'after'} it; that longer motions are no better was not shown"
            )
            wholes.append((objective_value(problem, whole)[0], whole, said))
    for objective, whole, said in sorted(wholes, key=lambda one: one[0]):
        plan = without_solving(problem, whole, objective, said)
        if plan.passed:
            return plan
    return None


def _a_little_longer(search: Search, budget: Budget, quick: Plan) -> Plan | None:
    """Return the plan of the best motion in a twentieth more than the least time; None where it does not pass."""
    motion, asked = quick.require_motion("lengthen"), search.problem.motion.duration_s
    duration = min(1.05 * motion.duration_s, asked or np.inf)
    problem = _on_its_scheme(search.within(budget), quick)
    mesh = replace(problem.mesh, refine="intervals")
    problem = replace(problem, mesh=mesh, motion=replace(problem.motion, duration_s=duration))
    start, mesh = stretched(motion_of(motion), duration), quick.solved.program.mesh
    lengths = np.bincount(mesh.segment, weights=np.diff(motion.breaks_s))
    durations = lengths * duration / lengths.sum()
    what = "the least-time motion with a little more time"
    found = solve_from(problem, start, mesh, durations, what, warm=True)
    plan = None if found is None else certified(problem, found, warm=True, kinks=False)
    return plan if plan is not None and plan.passed else None


def _joined(motion: Trajectory, wait: float, effort: np.ndarray, *, first: bool) -> Trajectory:
    """Return a trajectory with a rest before or after it, in which an effort (n_u,) holds it: constants, exactly."""
    at = motion.position[0, 0] if first else motion.position[-1, -1]
    rests = (at, np.zeros(motion.n_s), effort)
    parts = {}
    for name, value in zip(("position", "velocity", "effort"), rests, strict=True):
        given = getattr(motion, name)
        rest = np.broadcast_to(value, (len(given), 1, given.shape[2]))
        parts[name] = np.concatenate([rest, given] if first else [given, rest], axis=1)
    breaks = [[0.0], wait + motion.breaks_s] if first else [motion.breaks_s, [motion.duration_s + wait]]
    return replace(motion, breaks_s=np.concatenate(breaks), **parts)


def _waits(problem: Problem, quick: Plan, wait: float) -> Iterator[tuple[str, Guess, Mesh, np.ndarray]]:
    trajectory, mesh = quick.require_motion("wait beside"), quick.solved.program.mesh
    motion, lengths = motion_of(trajectory), np.bincount(mesh.segment, weights=np.diff(trajectory.breaks_s))
    rest = np.full(10, 0.1)  # shares of its intervals
    for end in ("start", "goal"):
        effort = _held(problem, end)
        if effort is None:
            continue
        first = end == "start"
        segment = [np.zeros(len(rest), dtype=int), mesh.segment + 1]
        if not first:
            segment = [mesh.segment, np.full(len(rest), mesh.n_segments)]
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


def _held(problem: Problem, end: str) -> np.ndarray | None:
    """Return the effort (n_u,) that holds start or goal, at rest there; None where none within the limits does."""
    motion, mechanism, limit = problem.motion, problem.mechanism, problem.limits.effort
    if end == "goal" and motion.goal_is_free:
        return None  # where it ends is not known
    speed = getattr(motion, f"{end}_speed")
    if speed is not None and np.any(speed != 0):
        return None
    still = np.zeros((1, mechanism.dof))
    effort, missed = needed_effort(mechanism, close_at(mechanism, getattr(motion, end))[None], still, still)
    slack = HOLDING_TOLERANCE * np.where(np.isfinite(limit), np.abs(limit), 0.0).max(initial=1.0)
    if np.abs(missed).max() > slack or np.any(effort[0] < limit[:, 0] - slack) or np.any(effort[0] > limit[:, 1] + slack):
        return None
    return effort[0]
