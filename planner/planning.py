"""From a planning problem to a certified plan: presolve, starts in turn, refinement, and the reason where there is none."""

import functools
import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from linkplan.planner.closed_chain.answer import finished
from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import (
    Guess,
    bent_guesses,
    closes,
    first_guess,
    guesses,
    motion_of,
    swinging_guesses,
)
from linkplan.planner.closed_chain.prescribed_plan import plan_prescribed
from linkplan.planner.diagnosis.infeasibility import LeastLimit, effort_sentence, least_limit
from linkplan.planner.diagnosis.relaxation import RELAXABLE, least_of, violated_sentence, without
from linkplan.planner.plan import Plan
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.history import Say, Step, silent
from linkplan.planner.search.attempts import best_of, certified, first_of, unsound
from linkplan.planner.search.clearance import kept_clear
from linkplan.planner.search.continuation import LENGTHENING, SAVED, lengthened
from linkplan.planner.search.durations import SURELY, SURELY_LIMITED, known_motion, longest, may_swing
from linkplan.planner.search.first_mesh import PER_LEG, first_mesh
from linkplan.planner.search.phase_plane import least_time_guess, phase_plane_guess, stretched
from linkplan.planner.search.presolve import plain_contradiction, start_pose_of
from linkplan.planner.solvers.solve import INVALID, OUT_OF_TIME

__all__ = ["Say", "finished", "plan_motion", "silent"]

# A mesh so many times coarser, and no coarser than that, is solved first where the fine one is not found from any start.
_COARSER = 4
_COARSEST = 6
# A least time beyond so many times that of the phase plane's motion is a local one.
_SLOW = 1.002
# A motion on the first mesh that is no quicker than this share of one that is known is the same, not worth refining.
_WORTH = 0.999
# Bends tried after the first failure, where the user asks for no further starts.
_BENDS = 3
# Bends looked at for one that closes the loops, per one that is wanted.
_LOOKED_AT = 20


def plan_motion(problem: PlanningProblem, say: Say = silent) -> Plan:
    """Return the plan of a problem; one without an answer says why in `message`.

    Args:
        problem: what to plan.
        say: called with a line of progress now and then.

    Raises:
        ProblemError: when start, goal or reference contradict the mechanism itself.
    """
    start_pose = start_pose_of(problem)
    if problem.motion.kind == "track":
        return plan_prescribed(problem, start_pose, say)
    contradiction = plain_contradiction(problem)
    if contradiction is not None:
        details: dict[str, float] = {}
        longer_would_do = plain_contradiction(replace(problem, motion=replace(problem.motion, duration_s=None))) is None
        message = contradiction + (_shortest(problem, details, say) if longer_would_do else "")
        return Plan(problem=problem, status="infeasible", message=message, details=details)
    history: list[Step] = []
    if problem.solver.starts > 1:
        bends = itertools.islice(bent_guesses(problem, start_pose), _BENDS, _LOOKED_AT * problem.solver.starts)
        planned = itertools.islice(_in_turn(problem, start_pose), problem.solver.starts)
        plan = best_of(problem, itertools.chain(planned, bends), history, say)
    else:
        plan = first_of(problem, _in_turn(problem, start_pose), history, say)
        plan = _quicker(problem, plan, start_pose, history, say) or plan
        if plan is None or unsound(plan):
            plan = _lengthened(problem, start_pose, history, say) or plan
    return plan or _explain(problem, first_guess(problem, start_pose), history, say)


def _in_turn(problem: PlanningProblem, start_pose: np.ndarray) -> Iterator[tuple[str, Guess]]:
    """Yield starts in the order in which they are worth trying, each made when it is asked for.

    The user's own, the smooth path, the phase plane's where there is one degree of freedom, swings, a few bends.
    """
    yield from guesses(problem, start_pose)
    quickest = least_time_guess(problem, start_pose)
    if quickest is not None:
        surely = SURELY if quickest.cuts_s is not None else SURELY_LIMITED
        if quickest.knots_s is None and longest(problem) * surely < quickest.duration_s:
            return  # no start leads to a motion that there is no time for: the reason is looked for
        if quickest.legs > 1 and quickest.knots_s is None and list(problem.objective.weights) != ["time"]:
            swung = _least_time_motion(problem, quickest)
            if swung is not None:
                duration = problem.motion.duration_s or max(swung.duration_s, problem.motion.min_duration_s or 0.0)
                yield "the least-time motion", replace(stretched(swung, duration), legs=quickest.legs)
        yield "the phase plane", phase_plane_guess(problem, start_pose, quickest)
    for swing in swinging_guesses(problem, start_pose):
        yield "a swing", swing
    for _, (what, guess) in zip(range(_BENDS), bent_guesses(problem, start_pose), strict=False):
        yield what, guess


def _quicker(
    problem: PlanningProblem, plan: Plan | None, start_pose: np.ndarray, history: list[Step], say: Say
) -> Plan | None:
    """Return a least-time plan that is quicker than a local optimum, where the phase plane knows of one; else None."""
    if plan is None or plan.status != "optimal" or list(problem.objective.weights) != ["time"]:
        return None
    if any(without(problem, what) is not None for what in RELAXABLE if what != "speed"):
        return None  # what the phase plane does not know of is what makes the motion slow
    quickest = least_time_guess(problem, start_pose)
    if quickest is None or plan.trajectory.duration_s <= _SLOW * quickest.duration_s:
        return None
    worth = _WORTH * plan.trajectory.duration_s
    better = first_of(problem, iter([("the phase plane", quickest)]), history, say, below=worth)
    passes = better is not None and better.status == "optimal"
    return better if passes and better.trajectory.duration_s < plan.trajectory.duration_s else None


def _least_time_motion(problem: PlanningProblem, quickest: Guess) -> Guess | None:
    """Return the motion of least time as a start for another objective; None without one."""
    motion = replace(problem.motion, duration_s=None, min_duration_s=None, max_duration_s=None)
    free = replace(problem, objective="time", motion=motion, guess=None, solver=problem.solver.hurried())
    plan = first_of(free, iter([("the phase plane", quickest)]), [], silent)
    if plan is None or plan.trajectory is None:
        return None
    return motion_of(plan.trajectory)


def _lengthened(problem: PlanningProblem, start_pose: np.ndarray, history: list[Step], say: Say) -> Plan | None:
    """Return a plan reached from the motion of least time step by step; None where the phase plane knows of none."""
    quickest = least_time_guess(problem, start_pose)
    ended = list(problem.objective.weights) == ["time"] or (history and history[-1].solver_status in (OUT_OF_TIME, INVALID))
    if quickest is None or quickest.knots_s is not None or ended or longest(problem) < SURELY * quickest.duration_s:
        return None
    swung = _least_time_motion(problem, quickest)
    n_intervals = max(2 * problem.mesh.intervals, PER_LEG * quickest.legs)
    at = None if swung is None else lengthened(problem, swung, n_intervals, history, say)
    if at is None:
        return None
    final = replace(problem, mesh=replace(problem.mesh, scheme=at.scheme), guess=None)
    if problem.motion.duration_s is None:  # where the motion ends before that, it is as good as without
        final = replace(final, motion=replace(problem.motion, max_duration_s=at.longest_s))
    durations = np.array([at.start.duration_s])
    found = attempt(case_of(final), at.start, at.mesh, durations, "at its full length", history, say, warm=True)
    plan = None if found is None else certified(final, found, history, say, warm=True)
    if plan is None or plan.status != "optimal":
        return None
    said = f"; its last {LENGTHENING - 1:.0%} of time saved less than {SAVED:.1%}, more was not tried" if at.enough else ""
    return replace(plan, problem=problem, message=plan.message + said)


def _explain(problem: PlanningProblem, guess: Guess, history: list[Step], say: Say) -> Plan:
    """Return the plan of a problem that no start solved: by way of a coarse mesh or relaxed limits, else the reason."""
    stopped = {
        OUT_OF_TIME: f"the solver ran out of its {problem.solver.max_time_s:g} s (solver.max_time_s)",
        INVALID: "the dynamics gave a number that is not finite (NaN) along the motion, or the solver could not begin",
    }
    if history and history[-1].solver_status in stopped:
        reason = f"failed: {stopped[history[-1].solver_status]}"
        return Plan(problem=problem, status="failed", message=reason, history=tuple(history))
    # A motion that exists is found in tens of iterations; what forbids one is not worth a thousand.
    asked, problem = problem, replace(problem, solver=problem.solver.hurried())
    case, mesh = case_of(problem), first_mesh(problem, guess)[0]
    if mesh.n_intervals > _COARSER * _COARSEST:
        coarse, lengths = first_mesh(problem, guess, mesh.n_intervals // _COARSER)
        found = attempt(case, guess, coarse, lengths, "a coarser mesh", history, say)
        plan = None if found is None else certified(problem, found, history, say)
        if plan is not None and plan.status == "optimal":
            return replace(plan, problem=asked)
    say("no motion found; looking for the limit that forbids one")
    for what in RELAXABLE:
        plan = _without(problem, what, guess, history, say)
        if plan is not None:
            return replace(plan, problem=asked)
    least = _least_limit(problem, guess, history)
    over = least is not None and least.factor > 1.0
    if least is not None and not over:
        start, what = motion_of(least.trajectory), "start from the motion of least peak effort"
        found = attempt(case, start, least.mesh, least.durations, what, history, say)
        if found is not None:
            return replace(certified(problem, found, history, say), problem=asked)
    clear = kept_clear(problem, guesses(problem, guess.start_pose), history, say) if not over else None
    if clear is not None:
        return replace(clear, problem=asked)
    known = None if not over else known_motion(problem, guess)
    if known is not None:
        reason = f"failed: a motion of {known:.5g} s keeps the effort limits by the phase plane, the solver did not find it"
        return Plan(problem=asked, status="failed", message=reason, history=tuple(history))
    if over and may_swing(problem):
        sentence, _ = effort_sentence(problem, least)
        reason = f"failed: no motion was found; on the one of least effort that was, {sentence}, which is no proof"
        return Plan(problem=asked, status="failed", message=reason, history=tuple(history))
    if over:
        sentence, details = effort_sentence(problem, least)
        return Plan(
            problem=asked,
            status="infeasible",
            message=f"infeasible: {sentence}{_shortest(problem, details, say)}",
            history=tuple(history),
            details=details,
        )
    bare = functools.reduce(lambda kept, what: without(kept, what) or kept, RELAXABLE, problem)
    if bare is not problem:
        plan = _explain_together(problem, bare, guess, history, say)
        if plan is not None:
            return replace(plan, problem=asked)
    plan = _without(problem, "position", guess, history, say)
    if plan is not None:
        return replace(plan, problem=asked)
    status = history[-1].solver_status if history else "no start closes the loop"
    return Plan(
        problem=asked,
        status="failed",
        message=f"failed: the solver found neither a motion nor a limit that forbids one ({status})",
        history=tuple(history),
    )


def _explain_together(
    problem: PlanningProblem, bare: PlanningProblem, guess: Guess, history: list[Step], say: Say
) -> Plan | None:
    """Return the plan that says what efforts are missing even without the other limits; None where efforts suffice."""
    least = _least_limit(bare, guess, history)
    if least is None or least.factor <= 1.0:
        return None
    sentence, details = effort_sentence(bare, least)
    message = f"infeasible: even without its other limits, {sentence}{_shortest(problem, details, say)}"
    return Plan(problem=problem, status="infeasible", message=message, history=tuple(history), details=details)


def _without(problem: PlanningProblem, what: str, guess: Guess, history: list[Step], say: Say) -> Plan | None:
    """Return the plan that says by how much a motion made without a limit overruns it; None where it is not to blame."""
    relaxed = without(problem, what)
    if relaxed is None:
        return None
    mesh, durations = first_mesh(problem, guess)
    found = attempt(case_of(relaxed), guess, mesh, durations, f"without limits on {what}", history, say)
    if found is None:
        return None
    motion = found.motion
    if what in RELAXABLE and violated_sentence(problem, motion, what) is not None:
        say(f"looking for the least that {what} has to be")
        motion = least_of(problem, what, motion, mesh, np.bincount(mesh.segment, np.diff(motion.breaks_s)), history)
    sentence = violated_sentence(problem, motion, what)
    if sentence is None:
        return None
    details: dict[str, float] = {}
    message = f"infeasible: {sentence}{_shortest(problem, details, say)}"
    return Plan(problem=problem, status="infeasible", message=message, history=tuple(history), details=details)


def _least_limit(problem: PlanningProblem, guess: Guess, history: list[Step]) -> LeastLimit | None:
    """Return the least factor on the effort limits from several starts: what one start finds may be a local answer."""
    bends = itertools.islice(bent_guesses(problem, guess.start_pose), _LOOKED_AT)
    others = (start for _, start in bends if closes(problem.mechanism, start))
    best = None
    for start in (guess, *itertools.islice(others, _BENDS - 1)):
        found = least_limit(problem, start, *first_mesh(problem, start), history)
        if found is not None and (best is None or found.factor < best.factor):
            best = found
        if best is None or best.factor <= 1.0:
            break
    return best


def _shortest(problem: PlanningProblem, details: dict[str, float], say: Say) -> str:
    """Return the words on the shortest feasible duration of a motion between two states, where it can be found."""
    motion = problem.motion
    if motion.kind != "reach" or motion.duration_s is None or any(w.time_s is not None for w in motion.waypoints):
        return ""
    if motion.stays:
        return ""
    if not np.all(np.isfinite(problem.limits.effort)):
        return ""
    say("looking for the shortest feasible duration")
    free = replace(problem, objective="time", motion=replace(motion, duration_s=None))
    start_pose = start_pose_of(free)
    starts = [("a smooth path", first_guess(free, start_pose))]
    planar = least_time_guess(free, start_pose)
    starts += [("the phase plane", planar)] if planar is not None else []
    quickest = first_of(free, iter(starts), [], say)
    if quickest is None or quickest.status != "optimal":
        return ""
    details["shortest_duration_s"] = quickest.trajectory.duration_s
    return f"; the shortest feasible duration is {quickest.trajectory.duration_s:.5g} s"
