"""Rests at start or goal, and the cheapest legs of the phase plane with a rest beside them: motions without a solver."""

from dataclasses import replace

import numpy as np

from linkplan.planner.certificate.further_checks import objective_value
from linkplan.planner.closed_chain.guess import stretched
from linkplan.planner.closed_chain.prescribed import Holding, holding_at, motion_along
from linkplan.planner.phase_plane.cheapest_legs import cheapest_legs, legs_apply
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.keys.kinds import MIN_INTERVAL_SHARE
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import progress
from linkplan.planner.search.attempts import without_solving
from linkplan.planner.search.ladder import Budget, Search
from linkplan.planner.search.solving import longest
from linkplan.planner.trajectory import Trajectory


def legs_may_help(search: Search) -> bool:
    """True if no plan passes, and the phase plane knows a motion to the goal."""
    return not search.solved and search.quickest is not None and search.quickest.duration_s <= longest(search.problem)


def from_legs(search: Search, _: Budget) -> Plan | None:
    """Return the plan of the cheapest legs of the phase plane; None if its certificate does not pass."""
    plan = legs_plan(search)
    return plan if plan is not None and plan.passed else None


def legs_plan(search: Search) -> Plan | None:
    """Return the plan of the cheapest legs of the phase plane and of a rest, looked for once; None without one."""
    return search.known.once("the cheapest legs", lambda: _of_legs(search)) if legs_apply(search.problem) else None


def _of_legs(search: Search) -> Plan | None:
    problem, asked = search.problem, search.problem.motion.duration_s
    assert asked is not None, "legs of the phase plane answer a problem with a duration"
    progress("the cheapest legs of the phase plane")
    holdings = {end: found for end in ("start", "goal") if (found := held(problem, end)) is not None}
    costs = {end: float(np.sum(np.square(found.effort))) for end, found in holdings.items()}
    end = min(costs, key=lambda one: costs[one], default="start")
    assert asked is not None  # where legs apply
    plan = None
    for legs in cheapest_legs(problem, search.start_pose, costs.get(end)):
        guess, breaks = legs.guess(search.start_pose), legs.breaks()
        wait = asked - guess.duration_s
        if end not in holdings or wait <= MIN_INTERVAL_SHARE * asked:
            guess, breaks, wait = stretched(guess, asked), breaks * (asked / guess.duration_s), 0.0
        motion, rest = motion_along(problem, guess, breaks), ""
        if wait:
            motion = joined(motion, holdings[end].lasting(wait), first=end == "start")
            rest = f", {wait:.4g} s of it a rest at the {end}"
        along = f"motion of {asked:.6g} s along the cheapest legs of the phase plane{rest}"
        said = f"{along}; that others cost no less was not shown"
        plan = without_solving(problem, motion, objective_value(problem, motion)[0], said)
        if plan.passed:
            break
    return plan


def joined(motion: Trajectory, rest: Trajectory, *, first: bool) -> Trajectory:
    """Return a trajectory with a rest, of constants, before or after it, exactly where it begins or ends."""
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
    """Return what holds start or goal, at rest there; None where no efforts within their limits do."""
    motion = problem.motion
    if end == "goal" and motion.goal_is_free:
        return None  # where it ends is not known
    if problem.mechanism.forces is not None:
        return None  # no constant efforts hold it
    speed = getattr(motion, f"{end}_speed")
    if speed is not None and np.any(speed != 0):
        return None
    holding = holding_at(problem, getattr(motion, end))
    return holding if holding.holds else None
