"""Energy balances of one degree of freedom: motions that cannot stop, known before anything is searched.

A motion that begins at speed loses the most energy under full effort against it (Bobrow, Dubowsky & Gibson, Int. J. Robotics
Research 4, 1985). Where energy is left at the end of the range, no motion stays within it. Run backwards, the same holds for
a motion that ends at speed.
"""

from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.poses.assembly import close_at, follow
from linkplan.planner.phase_plane.grid import plane_of
from linkplan.planner.problem.problem import Problem


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _End:
    """An end of a reach: its words, position, speed, whether time runs on from it (1) or back (-1), and the other end."""

    name: str
    position: float
    speed: float
    along: int
    other: float
    other_speed: float


def no_way_to_stop(problem: Problem) -> str | None:
    """Return the sentence on a speed at start or goal that no effort stops or gives within the joint's range, or None."""
    motion, mechanism = problem.motion, problem.mechanism
    if mechanism.dof != 1 or motion.kind != "reach" or motion.goal_is_free or not np.all(np.isfinite(problem.limits.effort)):
        return None
    first, last = (0.0 if v is None else float(v[0]) for v in (motion.start_speed, motion.goal_speed))
    start, goal = float(motion.start[0]), float(motion.goal[0])
    ends = (
        _End(name="start", position=start, speed=first, along=1, other=goal, other_speed=last),
        _End(name="goal", position=goal, speed=last, along=-1, other=start, other_speed=first),
    )
    return next((found for end in ends if end.speed and (found := _beyond_the_range(problem, end)) is not None), None)


def _beyond_the_range(problem: Problem, end: _End) -> str | None:
    mechanism, limit = problem.mechanism, problem.limits.position
    way, (joint,) = int(np.sign(end.speed)), mechanism.independent_joints
    step = way * end.along
    bound = limit[mechanism.independent[0], 1 if step > 0 else 0]
    if not np.isfinite(bound) or step * (bound - end.position) <= 0:
        return None
    s = np.linspace(end.position, bound, 801)
    fine = np.interp(np.arange(2 * len(s) - 1) / 2, np.arange(len(s)), s)
    try:
        poses = follow(mechanism, fine[:, None], close_at(mechanism, np.array([end.position])), problem.solver.deadline)
    except AssemblyError:  # the reach ends before the range
        return None
    at, ahead = 0, 1
    if step < 0:
        s, poses, at, ahead = s[::-1], poses[::-1], len(s) - 1, -1
    plane = plane_of(problem, s, poses, problem.limits.effort)
    w = plane.leg(at, 0.5 * end.speed**2, ahead, -ahead, backwards=end.along < 0)
    # The share of the squared speed that must be left there is a hundred times the error of the quadrature.
    if len(w) < len(s) or w[-1] < 1e-4 * w[0]:
        return None
    passed = int(np.argmin(np.abs(s - end.other)))
    on_the_way = step * (end.other - end.position) > 0 and step * (bound - end.other) > 0
    if on_the_way and way * end.other_speed > 0 and w[abs(passed - at)] <= 0.5 * end.other_speed**2:
        return None
    does = "stops" if end.along > 0 else "gathers"
    room = abs(joint.shown(bound - end.position))
    return (
        f"infeasible: no effort within its limits {does} the {abs(joint.shown(end.speed)):.4g} {joint.unit}/s of joint"
        f" {joint.name} at the {end.name} within the {room:.4g} {joint.unit} to the end of its range at"
        f" {joint.said(bound, 5)} {joint.unit}"
    )
