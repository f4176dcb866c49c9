"""Motions without a solver: the smooth path itself, rests at start or goal, and the cheapest legs of the phase plane.

Large robots with a drive for each degree of freedom can move along almost any slow path. The solver may still run out of
time on their programs of ten thousand unknowns, or stall near an optimum without any visible change of the objective.
"""

import contextlib
import itertools
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from linkplan.models.actuation.distribution import HOLDING_TOLERANCE
from linkplan.models.deadline import Deadline, OutOfTimeError
from linkplan.models.errors import AssemblyError
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.certificate.further_checks import negligible_objective, objective_value
from linkplan.planner.closed_chain.case import finished
from linkplan.planner.closed_chain.guess import Guess, even_poses, first_guess, guess_from, stretched
from linkplan.planner.closed_chain.prescribed import SQUARES_AT_REST, Holding, holding_at, in_more_time, motion_along
from linkplan.planner.limits.kinds import effort_bounds, needed_efforts
from linkplan.planner.phase_plane.cheapest_legs import cheapest_legs, legs_apply
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.keys.kinds import MIN_INTERVAL_SHARE
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import progress
from linkplan.planner.search.attempts import without_solving
from linkplan.planner.search.methods import Budget, Search
from linkplan.planner.search.solving import first_mesh, longest
from linkplan.planner.solvers.solve import OUT_OF_TIME
from linkplan.planner.trajectory import Trajectory

# Factors on the least duration of the smooth path, tried if the duration is free; slow motions satisfy limits on speed,
# acceleration and power.
_LONGER_FACTORS = (1.0, 2.0, 4.0, 8.0)
# Factors on the duration with which a motion that does not pass is tried again.
_SLOWER_FACTORS = (1.0001, 1.001, 1.003, 1.01, 1.03)


def along_smooth_path(search: Search) -> Plan | None:
    """Return the smooth path of a reach or a periodic motion as a "feasible" plan; None if its certificate does not pass.

    With waypoints, the path that rests at each of them is the answer if it is better.
    """
    asked = search.problem
    if asked.motion.kind not in ("reach", "periodic") or search.verdicts:
        return None
    # The later deadline ensures that a search that ran out of time still has this motion.
    problem = asked.varied(solver=asked.solver.replace(deadline=Deadline().within(asked.solver.max_time_s)))
    found = []
    with contextlib.suppress(OutOfTimeError):
        for rests in (True, False) if asked.motion.waypoints else (False,):
            path = first_guess(problem, search.start_pose, rests=True) if rests else search.smooth
            found.append(_along(search, problem, path))
    return min((plan for plan in found if plan is not None), key=lambda plan: plan.objective, default=None)


def _along(search: Search, problem: Problem, path: Guess) -> Plan | None:
    """Return the first plan along a path that passes, with longer and longer durations if these are free; or None."""
    for factor in _LONGER_FACTORS if problem.motion.duration_s is None else (1.0,):
        guess = stretched(path, factor * path.duration_s)
        if factor > 1 and guess.duration_s > longest(problem):
            break
        with contextlib.suppress(AssemblyError):
            if not _is_carried(problem, guess):
                continue
            progress(f"the smooth path itself in {guess.duration_s:.4g} s")
            mesh, durations = first_mesh(problem, guess)
            periodic = problem.motion.kind == "periodic"
            motion = replace(motion_along(problem, guess, mesh.breaks(durations)), periodic=periodic)
            within = f" within {problem.solver.max_time_s:g} s" if search.stopped == OUT_OF_TIME else ""
            along = f"motion of {motion.duration_s:.6g} s along the smooth path, which satisfies every limit"
            tried = f"the solver found no better motion{within}"
            plan = without_solving(problem, motion, objective_value(problem, motion)[0], along, tried)
            if plan.passed:
                return plan
    return None


def at_rest(search: Search) -> Plan | None:
    """Return the plan that rests at the start, for a reach that ends there (`Motion.stays`); None if a rest is no answer.

    It is "optimal" if it costs nothing. Otherwise a motion may cost less, because a swing can save holding effort.
    """
    problem, motion = search.problem, search.problem.motion
    duration = motion.duration_s or motion.min_duration_s
    moves = motion.start_speed is not None and np.any(motion.start_speed)
    if motion.start is None or moves or duration is None or problem.mechanism.forces is not None:
        return None
    holding = holding_at(problem, motion.start)
    if not holding.holds:
        return None
    rest = holding.lasting(duration)
    objective, _ = objective_value(problem, rest)
    free = set(problem.objective.weights) <= SQUARES_AT_REST and objective <= negligible_objective(problem, rest)
    said = f"rest of {duration:.6g} s: constant efforts hold the start"
    further = () if free else ("a motion of lower cost may exist",)
    plan = finished(problem, rest, certify(problem, rest), objective, said, optimal=free, further=further)
    return plan if plan.passed else None


def slower(problem: Problem, motions: Iterable[Trajectory]) -> Plan | None:
    """Return the plan of the first slightly slower motion that passes; None without one.

    A motion that overruns its limits by the mesh error needs less effort and speed if it takes longer.
    """
    problem = problem.varied(solver=problem.solver.replace(deadline=problem.solver.judging_deadline))
    for motion, factor in itertools.product(motions, _SLOWER_FACTORS):
        guess = stretched(guess_from(motion), factor * motion.duration_s)
        if guess.duration_s > longest(problem):
            continue
        with contextlib.suppress(AssemblyError):
            if _is_carried(problem, guess):
                found = in_more_time(problem, motion, factor)
                said = f"motion of {found.duration_s:.6g} s"
                why = f"in {motion.duration_s:.6g} s it does not pass its certificate"
                plan = without_solving(problem, found, objective_value(problem, found)[0], said, why)
                if plan.passed:
                    return plan
    return None


def _is_carried(problem: Problem, guess: Guess) -> bool:
    """True if the actuators can produce a guess within their limits, at its samples."""
    times, poses = even_poses(problem, guess)
    v, a = guess.velocity(times), guess.acceleration(times)
    effort, missing = needed_efforts(problem, poses, v, a, times)
    low, high = effort_bounds(problem).T
    largest = np.abs(effort).max(initial=0.0)
    return bool(
        np.all((effort >= low) & (effort <= high)) and np.abs(missing).max(initial=0.0) <= HOLDING_TOLERANCE * largest
    )


def from_legs(search: Search, _: Budget) -> Plan | None:
    """Return the plan of the cheapest legs of the phase plane; None if its certificate does not pass."""
    plan = legs_plan(search)
    return plan if plan is not None and plan.passed else None


def legs_plan(search: Search) -> Plan | None:
    """Return the plan of the cheapest legs of the phase plane and of a rest, searched only once; None without one."""
    return search.known.once("the cheapest legs", lambda: _of_legs(search)) if legs_apply(search.problem) else None


def _of_legs(search: Search) -> Plan | None:
    problem, asked = search.problem, search.problem.motion.duration_s
    assert asked is not None, "legs of the phase plane need a given duration"
    progress("the cheapest legs of the phase plane")
    repeats = problem.motion.kind == "periodic"
    ends = () if repeats else ("start", "goal")
    holdings = {end: found for end in ends if (found := held(problem, end)) is not None}
    costs = {end: float(np.sum(np.square(found.effort))) for end, found in holdings.items()}
    end = min(costs, key=lambda one: costs[one], default="start")
    plan = None
    for legs in cheapest_legs(problem, search.start_pose, costs.get(end)):
        guess, breaks = legs.guess(search.start_pose), legs.breaks()
        wait = asked - guess.duration_s
        if end not in holdings or wait <= MIN_INTERVAL_SHARE * asked:
            guess, breaks, wait = stretched(guess, asked), breaks * (asked / guess.duration_s), 0.0
        motion, rest = replace(motion_along(problem, guess, breaks), periodic=repeats), ""
        if wait:
            motion = joined(motion, holdings[end].lasting(wait), first=end == "start")
            rest = f", {wait:.4g} s of it a rest at the {end}"
        along = f"motion of {asked:.6g} s along the cheapest legs of the phase plane{rest}"
        why = "a motion of lower cost may exist"
        plan = without_solving(problem, motion, objective_value(problem, motion)[0], along, why)
        if plan.passed:
            break
    return plan


def joined(motion: Trajectory, rest: Trajectory, *, first: bool) -> Trajectory:
    """Return a trajectory with a rest (constants) before or after it, exactly at its beginning or end."""
    at = {"position": motion.position[0, 0] if first else motion.position[-1, -1]}
    parts = {}
    for name in ("position", "velocity", "effort"):
        given, resting = getattr(motion, name), getattr(rest, name)
        constant = np.broadcast_to(at.get(name, resting[0, 0]), (len(given), *resting.shape[1:]))
        parts[name] = np.concatenate([constant, given] if first else [given, constant], axis=1)
    before, after, joint = (rest, motion, rest.duration_s) if first else (motion, rest, motion.duration_s)
    breaks = [before.breaks_s[:-1], joint + after.breaks_s]
    return replace(motion, breaks_s=np.concatenate(breaks), **parts)


def held(problem: Problem, end: str) -> Holding | None:
    """Return the efforts that hold start or goal at rest; None if no efforts within their limits do."""
    motion = problem.motion
    if end == "goal" and motion.goal_is_free:
        return None  # the final pose is unknown
    if problem.mechanism.forces is not None:
        return None  # no constant efforts hold it
    speed = getattr(motion, f"{end}_speed")
    if speed is not None and np.any(speed != 0):
        return None
    holding = holding_at(problem, getattr(motion, end))
    return holding if holding.holds else None
