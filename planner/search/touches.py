"""The rung of touches: a limit on the pose that one degree of freedom comes to in an instant is a phase boundary there.

Where it turns round at a limit, at a joint's range or at the least distance from a singular pose, no node of a mesh stands
at that instant: between nodes the limit is kept by room that the objective pays for, a thousandth of it on a coarse mesh.
The limit on the pose is one on the coordinate; the motion passes that at rest, as it does a waypoint whose instant is free.
"""

from dataclasses import replace

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.samples import block_ratios
from linkplan.planner.plan import Plan
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.search.attempts import plan_from
from linkplan.planner.search.ladder import Budget, Search
from linkplan.planner.search.starts import with_switch_times
from linkplan.planner.trajectory import Trajectory

# A motion that turns so near to a limit, a share of its span, touches it; so many touches are looked at, at the most.
_NEAR, _MOST = 2e-3, 4
# Next to start and goal, this share of the duration, it does not turn. Samples of an interval; halvings that find a limit.
_BESIDE, _SAMPLES, _HALVINGS = 1e-3, 10, 50
# What a motion gains with its touches is worth another plan from this share of its objective on; a first solution that is
# worse than the motion by more than the other is not refined.
_GAINS, _WORSE = 1e-8, 1e-3


def may_touch(search: Search) -> bool:
    """Return whether the best motion is a reach of one degree of freedom that has no waypoints, and passes."""
    motion = search.problem.motion
    if search.problem.mechanism.dof != 1 or motion.kind != "reach" or motion.waypoints or motion.stays:
        return False
    return search.solved and bool(touches(search.problem, search.best.trajectory))


def through_touches(search: Search, budget: Budget) -> Plan | None:
    """Return the plan that passes the limits that the best motion touches as waypoints; None where it is no better."""
    best, problem = search.best, search.problem
    found = touches(problem, best.trajectory)
    passing = problem.motion.resting_at(np.array([place]) for _, place in found)
    other = search.of_another(replace(problem, guess=None, motion=passing))
    boundaries = np.array([0.0, *(time for time, _ in found), best.trajectory.duration_s])
    guess = replace(with_switch_times(best), boundaries_s=boundaries, switch_times_s=None)
    search.say("limits touched in an instant, passed there as waypoints")
    plan = plan_from(other, budget, "limits touched in an instant", guess, worth=best.objective * (1 + _WORSE), mended=False)
    search.history.extend(other.history)
    if plan is None or not plan.passed or not plan.objective < best.objective * (1 - _GAINS):
        return None
    return replace(plan, problem=problem, solved=None)


def touches(problem: PlanningProblem, motion: Trajectory) -> list[tuple[float, float]]:
    """Return when a motion of one degree of freedom turns round at a limit on the pose [s], and the place of that limit.

    None of them where there are more than a few: it rests along the limit.
    """
    time = motion.dense_times(_SAMPLES)
    v = motion.velocity_at(time)[:, 0]
    turns = np.flatnonzero((v[1:] * v[:-1] < 0) & (np.diff(time) > 0))
    at = time[turns] + np.diff(time)[turns] * v[turns] / (v[turns] - v[turns + 1])
    lasts = motion.duration_s
    inner = (at > _BESIDE * lasts) & (at < (1 - _BESIDE) * lasts)
    span = float(np.ptp(motion.position))
    found = []
    for instant, before in zip(at[inner], v[turns[inner]], strict=True):
        place = _limit_beyond(problem, motion, float(instant), np.sign(before) * _NEAR * span)
        if place is not None:
            found.append((float(instant), place))
    return found if len(found) <= _MOST else []


def _limit_beyond(problem: PlanningProblem, motion: Trajectory, instant: float, way: float) -> float | None:
    """Return the place of the limit on the pose within `way` of where a motion is at an instant [s]; None without one."""
    mechanism = problem.mechanism
    s = motion.position_at(np.linspace(0.0, instant, 2 + int(_SAMPLES * len(motion.breaks_s))))
    deadline = problem.solver.deadline
    here = follow(mechanism, s, motion.start_pose, deadline)[-1]
    turn = float(s[-1, 0])

    def kept(share: float) -> bool:
        try:
            q = follow(mechanism, np.array([[turn], [turn + share * way]]), here, deadline)[-1:]
        except AssemblyError:
            return False
        return _room(problem, q) >= 0

    inside, outside = -1.0, 1.0  # what is overrun by rounding is a little behind
    if kept(outside) or not kept(inside):
        return None
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if kept(middle) else (inside, middle)
    return turn + inside * way


def _room(problem: PlanningProblem, q: np.ndarray) -> float:
    """Return what poses (n, n_q) leave of the joints' ranges and of the margin to singular poses, negative beyond."""
    limits = problem.limits
    room = float(np.minimum(q - limits.position[:, 0], limits.position[:, 1] - q).min())
    if limits.singular_margin > 0:
        room = min(room, float(block_ratios(problem, q).min()) - limits.singular_margin)
    return room
