"""Diagnoses: functions that return a plan with a reason why a problem has no motion, or None if their reason does not apply.

None of them returns a motion. They compute by how much limits would have to be relaxed, from motions planned without these
limits.
"""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.errors import AssemblyError
from linkplan.models.poses.along import demanded, distributed
from linkplan.planner.closed_chain.guess import Guess, even_poses
from linkplan.planner.limits.kinds import (
    are_efforts_bounded,
    beyond_bounds,
    effort_bounds,
    limits_of,
    needed_efforts,
    relaxed_kinds,
    violation,
    without,
)
from linkplan.planner.limits.limit import Limit
from linkplan.planner.phase_plane.bang_bang_motions import least_share
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import Overrun, Verdict, failed, infeasible
from linkplan.planner.problem.extra import extras_not_finite
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import progress, recorded
from linkplan.planner.search.least_limit import (
    LeastLimit,
    least_limit_of_starts,
    least_relaxation_of_legs,
    settled_relaxation,
)
from linkplan.planner.search.methods import SHORT_BUDGET, Search
from linkplan.planner.search.presolve import plain_contradiction
from linkplan.planner.search.solving import GRID_ERROR_FACTOR_AT_SPEED_LIMIT, first_mesh, longest, may_swing, solve_from
from linkplan.planner.search.starts import enough_time, least_time_plan, may_be_too_short, no_time, one_way, shortest_motion
from linkplan.planner.solvers.solve import INVALID, why_stopped

# A duration below this share of the shortest motion's is certainly infeasible, because local least times are within
# percents.
_INFEASIBLE_DURATION_SHARE = 0.1


def _must_give(actuator: Actuator, effort: float) -> str:
    return f"{actuator.name} on {actuator.target} would have to give {effort:.4g} {actuator.unit}"


def _times_limit(actuator: Actuator, factor: float, limit: float) -> str:
    return f"{factor:.4g} times its limit of {limit:.4g} {actuator.unit}"


def effort_sentence(problem: Problem, least: LeastLimit) -> tuple[str, Overrun]:
    """Return words on the efforts that a motion would need, and their largest overrun."""
    limit, trajectory = effort_bounds(problem), least.trajectory
    time = trajectory.dense_times(8)
    u = trajectory.effort_at(time)
    # The motion of least effort is bang-bang: name the actuator with the largest excess, at its first such time.
    over = beyond_bounds(problem, u)
    column = int(np.argmax(over.max(axis=0)))
    at = int(np.flatnonzero(over[:, column] > 0.999 * over[:, column].max())[0])
    actuator = problem.mechanism.actuators[column]
    needed, bound = float(u[at, column]), float(limit[column, 1] if u[at, column] > 0 else limit[column, 0])
    sentence = (
        f"{_must_give(actuator, abs(needed))} at t = {time[at]:.3g} s, {abs(needed - bound):.4g} {actuator.unit} beyond its"
        f" limit of {abs(bound):.4g} {actuator.unit}"
    )
    return sentence, Overrun(
        limit="effort", name=actuator.name, value=needed, bound=bound, unit=actuator.unit, time_s=float(time[at])
    )


def _of_efforts(search: Search, words: str, over: Overrun, factor: float) -> Plan:
    """Return the plan that says that a motion would need more effort."""
    return _infeasible(search, infeasible(words, overruns=(over,), needed_factor=factor))


def share_sentence(problem: Problem, factor: float, motion: Guess, *, at_all: bool) -> str:
    """Return a sentence on the factor by which effort limits are too small, for the phase plane's motion at that factor.

    Args:
        problem: with one degree of freedom.
        factor: on all effort limits.
        motion: the motion with that factor.
        at_all: no motion of any duration satisfies the limits; the sentence then names the pose that this one barely passes.
    """
    (joint,) = problem.mechanism.independent_joints
    time = np.linspace(0.0, motion.duration_s, 2001)[1:-1]
    # The motion rests at both ends, so 2 % of the duration at each end are excluded.
    velocity, ends = motion.velocity(time)[:, 0], 0.02 * motion.duration_s
    speed, inside = np.abs(velocity), (time > ends) & (time < motion.duration_s - ends)
    # At the critical pose, which the motion barely passes, its speed is least and does not change its sign.
    least = np.concatenate([[False], speed[1:-1] <= np.minimum(speed[:-2], speed[2:]), [False]])
    passing = inside & least & (np.gradient(np.sign(velocity)) == 0)
    at = int(np.argmin(np.where(passing if passing.any() else inside, speed, np.inf)))
    place = joint.shown(float(motion.position(time[at : at + 1])[0, 0]))
    if problem.mechanism.n_u == 1 and motion.effort is not None:
        actuator, needed = problem.mechanism.actuators[0], float(motion.effort(time[at : at + 1])[0, 0])
        need = f"{_must_give(actuator, needed)}, {_times_limit(actuator, factor, needed / factor)}"
    else:
        need = f"all efforts would have to be {factor:.4g} times their limits"
    if not at_all:
        return f"by the phase plane {need}, throughout"
    return (
        f"by the phase plane no motion reaches the goal in any time: {need}, to pass {joint.name} = {place:.4g} {joint.unit}"
        f" at t = {time[at]:.3g} s"
    )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PathEffort:
    """The smooth path's largest excess over an effort limit: the factor, the factor without gravity, and a sentence."""

    factor: float
    inertial_factor: float
    sentence: str


def far_too_short(search: Search) -> Verdict | None:
    """Return a verdict if a reach is given only a small share of its least duration; else None.

    With one degree of freedom the phase plane gives the shortest motion at once. With several
    degrees of freedom it is planned only if the smooth path needs far more effort than allowed.
    """
    problem, asked = search.problem, longest(search.problem)
    path = path_effort(problem, search.smooth) if may_be_too_short(problem) else None
    # Inertial efforts grow with the square of the speed.
    if path is None or path.inertial_factor < 1 / _INFEASIBLE_DURATION_SHARE**2:
        return None
    shortest, about = _shortest(search)
    if shortest is None or asked > _INFEASIBLE_DURATION_SHARE * shortest:
        return None
    words = (
        f"{asked:.4g} s is {shortest / asked:.3g} times too short: {path.sentence};"
        f" the shortest feasible duration is {about}{shortest:.4g} s"
    )
    return infeasible(words, "duration", remedy={"motion.duration_s": shortest})


def _shortest(search: Search) -> tuple[float | None, str]:
    """Return the least known duration [s], or None, and the word "about " if it is approximate."""
    if search.quickest is not None and search.quickest.boundaries_s is None:
        return search.quickest.duration_s, "about "
    found = shortest_motion(search)
    return (None, "") if found is None else (found.trajectory.duration_s, "")


def path_effort(problem: Problem, guess: Guess) -> PathEffort | None:
    """Return the largest effort of a path relative to its limit, and the undriven efforts; None if the loops open."""
    mechanism, limit = problem.mechanism, effort_bounds(problem)
    try:
        time, q = even_poses(problem, guess)
    except AssemblyError:
        return None
    v, a = guess.velocity(time), guess.acceleration(time)
    tau, maps = demanded(mechanism, q, v, a, time)
    effort = distributed(mechanism, tau, maps, limit)
    missed = tau - np.einsum("ksu,ku->ks", maps, effort)
    held = distributed(mechanism, demanded(mechanism, q, 0 * v, 0 * a, time)[0], maps, limit)
    bound = np.where(effort > 0, np.maximum(limit[:, 1], 0.0), np.minimum(limit[:, 0], 0.0))
    widest = np.abs(limit).max(axis=1)  # the scale if an actuator has no effort in the needed direction
    factors = np.abs(effort) / np.where(bound == 0, widest, np.abs(bound))
    inertial = np.abs(effort - held) / widest
    at, column = np.unravel_index(int(np.argmax(factors)), factors.shape)
    actuator = mechanism.actuators[column]
    sentence = (
        f"along the smooth path from start to goal {_must_give(actuator, effort[at, column])} at t = {time[at]:.3g} s, "
    )
    if bound[at, column] == 0:
        sentence += "a direction in which its limit is 0"
    else:
        sentence += _times_limit(actuator, factors[at, column], bound[at, column])
    k, row = np.unravel_index(int(np.argmax(np.abs(missed))), missed.shape)
    if abs(missed[k, row]) > 1e-6 * np.abs(effort).max():
        joint = mechanism.independent_joints[row]
        sentence += f", and no actuator can give the {missed[k, row]:.4g} {joint.si_units[1]} needed on {joint.name}"
    return PathEffort(factor=float(factors.max()), inertial_factor=float(inertial.max()), sentence=sentence)


def contradicted(search: Search) -> Plan | None:
    """Return the plan that names a limit that no motion can satisfy, if this is clear without solving."""
    problem = search.problem
    verdict = plain_contradiction(problem)
    if verdict is None:
        return None
    longer_would_do = plain_contradiction(problem.varied(motion=replace(problem.motion, duration_s=None))) is None
    return _infeasible(search, verdict, shortest=longer_would_do)


def too_short(search: Search) -> Plan | None:
    """Return the plan that says that a duration is far below the shortest, if this is clear without a search."""
    verdict = far_too_short(search)
    return None if verdict is None else _infeasible(search, verdict, shortest=False)


def less_than_least_time(search: Search) -> Plan | None:
    """Return the plan that says that a duration is below the least time, which the phase plane's motion gives."""
    if not no_time(search):
        return None
    known = least_time_plan(search, SHORT_BUDGET)
    if known is None or known.trajectory is None or not known.passed:
        return None
    asked, shortest = longest(search.problem), known.trajectory.duration_s
    words = f"{asked:.7g} s is too short; the shortest feasible duration is {shortest:.7g} s"
    verdict = infeasible(words, "duration", known_by="phase plane", remedy={"motion.duration_s": shortest})
    return _infeasible(search, verdict, shortest=False)


def solver_stopped(search: Search) -> Plan | None:
    """Return the plan with the reason why the solver stopped before a result."""
    reason = why_stopped(search.stopped or "", search.problem.solver.max_time_s)
    if search.stopped == INVALID:
        reason = "; ".join(_extras_not_finite(search)) or reason
    if reason is None:
        return None
    about = "numbers" if search.stopped == INVALID else "time"
    verdict = failed(reason, about, out_of_time=about == "time")
    return _failed(search, verdict.adding(_needs_of_smooth_path(search)))


def _extras_not_finite(search: Search) -> list[str]:
    """Return the sentences on extra limits and costs that are not finite along the smooth path."""
    problem, path = search.problem, search.smooth
    if not problem.extras:
        return []
    times, poses = even_poses(problem, path)
    v, a = path.velocity(times), path.acceleration(times)
    effort, _ = needed_efforts(problem, poses, v, a, times)
    motion = (poses, v, a, effort, np.gradient(a, times, axis=0), *problem.mechanism.forces_at(times))
    found = extras_not_finite(problem.extras, problem.mechanism, times, *motion)
    return [f"{sentence} along the smooth path" for sentence in found]


def one_limit(search: Search) -> Plan | None:
    """Return the plan that names a limit whose removal makes a motion possible, and the limit's least feasible value."""
    return _first_without(search, relaxed_kinds(search.problem))


def efforts_contradicted(search: Search) -> Plan | None:
    """Return the plan that says that the solver missed a motion of the phase plane."""
    if any(limit.facts.narrows_efforts for limit in limits_of(search.problem)):
        return None
    if _over(search) is None or not enough_time(search) or search.quickest is None:
        return None
    known = search.quickest.duration_s
    words = f"the phase plane has a motion of {known:.5g} s within the effort limits, but the search missed it"
    return _failed(search, failed(words, known_by="phase plane"))


def efforts_without_proof(search: Search) -> Plan | None:
    """Return the plan that names the least efforts found, for problems with untried swings."""
    over = _over(search)
    if over is None or not may_swing(search.problem):
        return None
    sentence, excess = effort_sentence(search.problem, over)
    words = f"no motion was found; on the found motion of least effort, {sentence}; this is no proof"
    return _failed(search, failed(words, overruns=(excess,), needed_factor=over.factor))


def efforts(search: Search) -> Plan | None:
    """Return the plan that names the efforts that a motion would need."""
    over = _over(search)
    if over is None:
        return None
    return _of_efforts(search, *effort_sentence(search.problem, over), over.factor)


def efforts_without_other_limits(search: Search) -> Plan | None:
    """Return the plan that names the efforts that are insufficient even without the other limits."""
    problem = search.within(SHORT_BUDGET)
    kinds, bare = relaxed_kinds(problem), problem
    if not kinds:
        return None
    for kind in kinds:
        bare = without(kind, bare)
    least = least_limit_of_starts(bare, search.smooth)
    if least is None or least.factor <= 1.0:
        return None
    sentence, over = effort_sentence(bare, least)
    return _of_efforts(search, f"even without its other limits, {sentence}", over, least.factor)


def one_last_limit(search: Search) -> Plan | None:
    """Return the plan that names the joint whose range forbids the motion."""
    return _first_without(search, relaxed_kinds(search.problem, at_last=True))


def efforts_by_the_phase_plane(search: Search) -> Plan | None:
    """Return the plan that names the factor by which efforts are too small, for one degree of freedom.

    The phase plane ignores all limits except effort, speed and range, so whatever it excludes is infeasible.
    """
    least = least_share(search.problem, search.start_pose, longest(search.problem))
    if least is None or least[0] <= GRID_ERROR_FACTOR_AT_SPEED_LIMIT:
        return None
    sentence = share_sentence(search.problem, *least, at_all=search.quickest is None)
    verdict = infeasible(sentence, known_by="phase plane", needed_factor=least[0])
    return _infeasible(search, verdict, shortest=search.quickest is not None)


def nothing_found(search: Search) -> Plan:
    """Return the plan that says that neither a motion nor a reason was found."""
    stopped = solver_stopped(search)  # during the search for a reason
    if stopped is not None:
        return stopped
    if unknown := _extras_not_finite(search):
        return _failed(search, failed("; ".join(unknown), "numbers"))
    status = recorded()[-1].solver_status if recorded() else "no initial guess closes the kinematic loops"
    known, remedy, longer = search.known.least_duration_s, {}, ""
    if known is not None and known > longest(search.problem):
        remedy, longer = {"motion.duration_s": known}, f"the shortest motion found takes {known:.5g} s"
    verdict = failed(f"the solver found neither a motion nor a limit that forbids one ({status})", remedy=remedy)
    return _failed(search, verdict.adding(_needs_of_smooth_path(search), longer))


def _needs_of_smooth_path(search: Search) -> str:
    """Return the phrase on the effort limit that the smooth path exceeds most; empty if it exceeds none."""
    if not are_efforts_bounded(search.problem):
        return ""
    path = path_effort(search.problem, search.smooth)
    return "" if path is None or path.factor <= 1 else path.sentence


def _over(search: Search) -> LeastLimit | None:
    """Return the least limit if it is larger than the problem's."""
    least = search.named_limit
    return least if least is not None and least.factor > 1.0 else None


def _first_without(search: Search, kinds: list[type[Limit]]) -> Plan | None:
    """Return the plan of the first kind of limits without which there is a motion."""
    return next((plan for kind in kinds if (plan := _without(search, kind)) is not None), None)


def _without(search: Search, kind: type[Limit]) -> Plan | None:
    """Return the plan that says by how much a motion planned without a limit violates it; None if it satisfies the limit."""
    problem, guess = search.within(SHORT_BUDGET), search.smooth
    mesh, durations = first_mesh(problem, guess)
    word = f"without limits on {kind.key}"
    found = solve_from(without(kind, problem), guess, mesh, durations, word)
    if found is None:
        return None
    motion, known_by, factor = found.motion, "search", np.inf
    if kind in relaxed_kinds(problem) and violation(kind, problem, motion) is not None:
        progress(f"searching for the least limit on {kind.key} with which there is a motion")
        motion, factor = settled_relaxation(problem, kind, motion, mesh, found.durations)
        legs = least_relaxation_of_legs(problem, kind, search.start_pose, motion) if one_way(search) else None
        motion, known_by, factor = (motion, "search", factor) if legs is None else (legs, "phase plane", np.inf)
    over = violation(kind, problem, motion, factor)
    if over is None:
        return None
    words = over.sentence("would have to be")
    return _infeasible(search, infeasible(words, overruns=(Overrun.of(over),), known_by=known_by))


def _infeasible(search: Search, verdict: Verdict, *, shortest: bool = True) -> Plan:
    """Return the plan that says that no motion satisfies the limits.

    If a motion of at most the given duration is known, the problem is not proved infeasible and the status is "failed".
    """
    problem: Problem = search.problem
    quickest = shortest_motion(search) if shortest and may_be_too_short(problem) else None
    if quickest is not None:
        least = quickest.trajectory.duration_s
        verdict = verdict.adding(f"the shortest feasible duration is {least:.5g} s", remedy={"motion.duration_s": least})
    known, asked = search.known.least_duration_s, longest(problem)
    if known is not None and known <= asked * (1 + 1e-9):
        words = f"a motion of {known:.7g} s satisfies every limit, one of {asked:.7g} s was not found"
        return _failed(search, failed(words, "duration", remedy={"motion.duration_s": known}))
    return Plan(problem=problem, verdict=verdict, history=recorded())


def _failed(search: Search, verdict: Verdict) -> Plan:
    return Plan(problem=search.problem, verdict=verdict, history=recorded())
