"""Methods with a new initial guess: the user's, the smooth path, the phase plane's motion, or a swing.

The motion of least time is searched once, and shared by methods and diagnoses.

One method keeps a distance from singular poses that the problem does not require. Near a dead centre the needed effort
vanishes, so there is no optimum: the cost falls as the margin shrinks, down to a motion that leaves the branch. A crank that
turns continuously may pass a nearly singular pose; a coarse mesh then steps over it onto the other branch. In both cases
solvers fail without a margin and find the best motion within it.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from linkplan.planner.closed_chain.guess import Guess, guess_from, stretched, swinging_guesses
from linkplan.planner.limits.kinds import are_efforts_bounded, effort_bounds, limits_of
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.phase_plane.bang_bang_motions import phase_plane_applies, phase_plane_guess
from linkplan.planner.phase_plane.cheapest_motion import cheapest_guess
from linkplan.planner.phase_plane.legs_motion import LEGS_SCHEME, legs_motion
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import progress, recording
from linkplan.planner.search.attempts import plan_from, without_solving
from linkplan.planner.search.every_motion import only_way
from linkplan.planner.search.methods import FULL_BUDGET, SHORT_BUDGET, Budget, Search, run_search
from linkplan.planner.search.solving import (
    GRID_ERROR_FACTOR,
    GRID_ERROR_FACTOR_AT_SPEED_LIMIT,
    longest,
)
from linkplan.planner.search.without_solver import legs_plan

# The name, among the known motions, of the least-time plan from the phase plane's motion.
PHASE_PLANE_LEAST_TIME = "least time from the phase plane"
# A least time above the given duration by more than this share is clearly longer, since least times are more exact.
_CLEARLY_LONGER = 1e-3
# A solution that costs less than the cheapest legs by more than this share violates the dynamics between its nodes.
_FALSE_SHARE = 0.1


def one_start_is_worth_it(search: Search) -> bool:
    """True if starts are tried one after another, and a further one may lead to a motion."""
    return search.problem.solver.starts == 1 and search.starts_are_worth_it


def other_limits(problem: Problem) -> bool:
    """True if a problem has limits that the phase plane ignores and that may slow down a motion."""
    return any(not limit.facts.in_phase_plane for limit in limits_of(problem))


def phase_plane_may_help(search: Search) -> bool:
    """True if the phase plane has a motion and no plan passes, or if a better one than the plan that passes may exist."""
    if search.solved:
        return search.only_time_counts or swings_may_be_better(search)
    return one_start_is_worth_it(search) and search.quickest is not None and not no_time(search)


def no_time(search: Search) -> bool:
    """True if the phase plane shows that the given time is too short for any motion.

    Its motion on a grid is too slow, especially with swings. So the certified least time decides; it is compared to the
    printed digits.
    """
    quickest, asked = search.quickest, longest(search.problem)
    if quickest is None or quickest.boundaries_s is not None or asked >= quickest.duration_s:
        return False
    surely = GRID_ERROR_FACTOR if quickest.switch_times_s is not None else GRID_ERROR_FACTOR_AT_SPEED_LIMIT
    if quickest.swings <= 1 and asked * surely < quickest.duration_s:
        return True
    known = least_time_plan(search, SHORT_BUDGET)
    if known is None or known.trajectory is None or not known.passed:
        return asked * surely < quickest.duration_s
    return asked < known.trajectory.duration_s * (1 - 5e-5)


def one_way(search: Search) -> bool:
    """True if the phase plane has a quickest motion, and it turns back only where it must."""
    return phase_plane_applies(search.problem) and search.quickest is not None and search.quickest.swings <= 1


def enough_time(search: Search) -> bool:
    """True if the phase plane has a motion within the given time."""
    return search.quickest is not None and longest(search.problem) >= GRID_ERROR_FACTOR * search.quickest.duration_s


def swings_may_be_better(search: Search) -> bool:
    """True if a plan between start and goal reaches its effort limits, and the motion of least time swings."""
    problem = search.problem
    # A limit is reached within a thousandth.
    weak = np.any(search.best.certificate.peak_effort > 0.999 * np.abs(effort_bounds(problem)).max(axis=1))
    if problem.solver.starts > 1 or problem.guess is not None or not weak or not phase_plane_applies(problem):
        return False
    return search.quickest is not None and search.quickest.swings > 1 and not no_time(search)


def from_first_starts(search: Search, budget: Budget) -> Plan | None:
    """Return the plan from the user's guess, or else from the smoothest path."""
    repaired = not search.only_time_counts and search.problem.motion.turns is None
    return _first_of(search, budget, search.first_starts(), repaired=repaired)


def from_the_phase_plane(search: Search, budget: Budget) -> Plan | None:
    """Return the plan from the phase plane's motion; if a plan already passes, only a better one.

    The first start is the motion of least time if it swings and the objective is not time.
    """
    if search.solved:
        return _better_plan(search, budget)
    assert search.quickest is not None  # where the phase plane applies
    legs = legs_plan(search) if search.plans and search.quickest.swings <= 1 else None
    least = -np.inf
    if legs is not None and legs.passed:
        assert legs.objective is not None
        least = legs.objective - _FALSE_SHARE * abs(legs.objective)
        along = guess_from(legs.require_motion("start from"))
        plan = plan_from(search, budget, "the cheapest legs", along, repaired=False, graded=True)
        if plan is not None and plan.passed:
            return plan
    return _first_of(search, budget, of_the_phase_plane(search, budget), least=least)


def of_the_phase_plane(search: Search, budget: Budget) -> Iterator[tuple[str, Guess]]:
    """Yield the starts from the phase plane's motion, each with its name."""
    problem, quickest = search.problem, search.quickest
    assert quickest is not None  # where the phase plane applies
    cheap = _cheapest(search)
    if cheap is not None:
        yield "dynamic programming", cheap
    if quickest.swings > 1 and quickest.boundaries_s is None and not search.only_time_counts:
        swung = least_time_motion(search, budget)
        if swung is not None:
            duration = problem.motion.duration_s or max(swung.duration_s, problem.motion.min_duration_s or 0.0)
            yield "the least-time motion", replace(stretched(swung, duration), swings=quickest.swings)
    yield "the phase plane", phase_plane_guess(problem, quickest)


def may_be_along_limits(search: Search) -> bool:
    """True if a least time of one degree of freedom may lie along limits that legs of the phase plane follow."""
    problem, motion = search.problem, search.problem.motion
    return (
        search.only_time_counts
        and motion.duration_s is None
        and problem.guess is None
        and problem.mesh.effort == "polynomial"
        and any(problem.mechanism.n_u <= limit.facts.followed_with for limit in limits_of(problem))
        and phase_plane_applies(problem)
    )


def along_limits(search: Search, _: Budget) -> Plan | None:
    """Return the plan of legs along the phase plane's limits, without a solver; None if its certificate does not pass."""
    progress("the phase plane along its limits, integrated")
    problem, motion = search.problem, legs_motion(search.problem, search.start_pose)
    if motion is None or not (problem.motion.min_duration_s or 0.0) <= motion.duration_s <= longest(problem):
        return None
    if not other_limits(problem) and search.quickest is not None and not _as_quick(search, motion.duration_s):
        return None  # a motion that reverses is quicker
    said = f"motion of {motion.duration_s:.6g} s, integrated along its limits"
    best = f"time-optimal {said}: the quickest motion with reversals only where necessary"
    objective = problem.objective.weight("time") * motion.duration_s
    plan = replace(without_solving(problem, motion, objective, said, best=best), read_scheme=LEGS_SCHEME)
    return plan.adding(known_by="phase plane") if plan.passed else None


def _cheapest(search: Search) -> Guess | None:
    """Return the motion by dynamic programming in more than the least time, for a single goal; None if there is none."""
    problem, motion = search.problem, search.problem.motion
    if motion.duration_s is None or motion.waypoints or not phase_plane_applies(problem) or not enough_time(search):
        return None
    assert search.quickest is not None  # there is enough time for it
    return cheapest_guess(problem, search.start_pose, search.quickest)


def from_swings(search: Search, budget: Budget) -> Plan | None:
    """Return the plan from a swing away from the goal, or beyond it."""
    swings = swinging_guesses(search.problem, search.start_pose)
    return _first_of(search, budget, (("a swing", swing) for swing in swings))


def _first_of(
    search: Search, budget: Budget, starts: Iterator[tuple[str, Guess]], *, repaired: bool = True, least: float = -np.inf
) -> Plan | None:
    """Return the first plan that passes, or the last one found; earlier plans are added to the search's plans."""
    missed = None
    for what, guess in search.deadline.take(starts):
        if missed is not None:
            search.plans.append(missed)
            if not search.starts_are_worth_it:
                return None
        missed = plan_from(search, budget, what, guess, repaired=repaired, least=least)
        if search.verdicts or search.stopped or (missed is not None and missed.passed):
            break
    return missed


def judged_by_the_phase_plane(search: Search) -> tuple[bool, Guess | None]:
    """Return True if the least-time plan is as quick as the phase plane's motion; and that motion if it is quicker."""
    problem = search.problem
    if not search.only_time_counts or problem.mechanism.dof > 1 or other_limits(problem):
        return False, None
    if search.quickest is None:
        return False, None
    as_quick = _as_quick(search, search.best.trajectory.duration_s)
    return as_quick, None if as_quick else search.quickest


def _as_quick(search: Search, duration_s: float) -> bool:
    """True if a duration is the phase plane's least time. The error of its grid is below a thousandth."""
    return duration_s <= 1.002 * search.quickest.duration_s


def _better_plan(search: Search, budget: Budget) -> Plan | None:
    """Return the plan from the phase plane's motion if it is better than the plan found, else None."""
    if search.only_time_counts:
        _, guess = judged_by_the_phase_plane(search)
    else:
        assert search.quickest is not None  # a swing may be better
        guess = _cheapest(search) or phase_plane_guess(search.problem, search.quickest)
    known = search.best.objective
    # A motion on the first mesh is refined only if it is better than this share of the best known objective.
    plan = (
        None if guess is None else plan_from(search, budget, "the phase plane", guess, worth=0.999 * known, repaired=False)
    )
    return plan if plan is not None and plan.passed and plan.objective < known else None


def least_time_motion(search: Search, budget: Budget) -> Guess | None:
    """Return the motion of least time, with its switch times, as a start for another objective; None without one."""
    plan = least_time_plan(search, budget)
    return None if plan is None or plan.trajectory is None else with_switch_times(plan)


def with_switch_times(plan: Plan) -> Guess:
    """Return a plan's motion as a guess with the switch times of its mesh."""
    trajectory = plan.require_motion("start from")
    guess = guess_from(trajectory)
    if plan.solved is None or plan.solved.program.mesh.n_phases > 1:
        return guess
    mesh, breaks = plan.solved.program.mesh, trajectory.breaks_s
    return replace(guess, switch_times_s=breaks[1:-1][np.diff(mesh.segment) > 0])


def least_time_plan(search: Search, budget: Budget) -> Plan | None:
    """Return the plan of least time from the phase plane's motion, solved only once; None without one."""

    def look() -> Plan | None:
        assert search.quickest is not None  # where the phase plane applies
        free = search.of_another(_in_least_time(search.within(budget)))
        with recording():
            along = along_limits(free, SHORT_BUDGET) if may_be_along_limits(free) else None
            return along or plan_from(free, SHORT_BUDGET, "the phase plane", search.quickest, repaired=False)

    return search.known.once(PHASE_PLANE_LEAST_TIME, look)


def may_near_singular(search: Search) -> bool:
    """True if no plan passes, though the phase plane knows a motion and loops may come near a singular pose."""
    problem = search.problem
    # Plans that failed do not exclude this method: they may have left the branch at a nearly singular pose.
    if search.solved or problem.solver.starts > 1 or problem.limits.singular_margin or problem.guess is not None:
        return False
    if search.quickest is None or other_limits(problem) or no_time(search):
        return False
    return len(problem.mechanism.dependent) > 0


def at_a_distance(search: Search, budget: Budget) -> Plan | None:
    """Return the best plan with a margin to singular poses; None if no method finds one.

    If the margin is active, its status is "feasible".
    """
    problem = search.within(budget)
    way = only_way(problem)
    if way is None:
        return None
    # The least |det J_z| relative to home. With a quarter of it solves may fail, a larger margin costs more. Start and goal
    # limit it: it is at most half of the least value on the path between them.
    margin = min(0.02, 0.5 * float(singularity_ratios(problem.mechanism, way).min()))
    limits = replace(problem.limits, singular_margin=margin)
    plan = run_search(search.of_another(problem.varied(limits=limits)))
    if plan is None or not plan.passed:
        return None
    found = replace(plan, problem=search.problem)
    # A margin is active within a hundredth of it.
    if plan.status == "feasible" or plan.certificate.singularity_ratio > 1.01 * margin:
        return found
    why = f"it keeps a distance from singular poses, {margin:.3g} of that at home; a motion nearer to them may cost less"
    return found.adding(why, kind="feasible")


def may_be_too_short(problem: Problem) -> bool:
    """True for a reach in a limited time, with limits on all efforts and no waypoint at a given instant."""
    motion = problem.motion
    timed = any(waypoint.time_s is not None for waypoint in motion.waypoints)
    limited = bool(np.isfinite(longest(problem))) and are_efforts_bounded(problem)
    return motion.kind == "reach" and not motion.stays and not timed and limited


def is_too_short(search: Search) -> bool:
    """True if the shortest motion found takes clearly longer than the given time."""
    quick = shortest_motion(search) if may_be_too_short(search.problem) else None
    return quick is not None and quick.trajectory.duration_s > (1.0 + _CLEARLY_LONGER) * longest(search.problem)


def shortest_motion(search: Search) -> Plan | None:
    """Return the certified plan of least time within a reach's limits; None if it was not found."""
    if not are_efforts_bounded(search.problem):  # then there is no least time
        return None
    if search.problem.mechanism.forces is not None:  # forces over time have fixed instants
        return None
    plan = search.known.sought.get(PHASE_PLANE_LEAST_TIME)
    if plan is None or not plan.passed:
        plan = search.known.once("least time by every method", lambda: _by_every_method(search))
    return plan if plan is not None and plan.passed else None


def _in_least_time(problem: Problem) -> Problem:
    """Return the problem of least time. Efforts that are constant over intervals, as for least work, would be slower."""
    motion = replace(problem.motion, duration_s=None, min_duration_s=None, max_duration_s=None)
    mesh = problem.mesh.replace(effort="polynomial")
    return problem.varied(objective="time", motion=motion, mesh=mesh, guess=None)


def _by_every_method(search: Search) -> Plan | None:
    # The share of the remaining time for the motion of least time; the rest is for the search that uses it.
    free = _in_least_time(search.within(replace(FULL_BUDGET, share_of_time=0.5)))
    progress("searching for the shortest feasible duration")
    with recording():
        return run_search(search.of_another(free))
