"""Checks before any solve: contradictions in the problem, and demands that the mechanism cannot satisfy.

A motion of one degree of freedom that begins at speed loses the most energy under full effort against it (Bobrow, Dubowsky &
Gibson, Int. J. Robotics Research 4, 1985). If energy remains at the end of the range, no motion stays within the range. In
reversed time the same is true for a motion that ends at speed.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.poses.along import needed_controls
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.poses.reach import reach
from linkplan.models.poses.singular_poses import all_regular
from linkplan.models.tree.joints import POSITION_ROUNDING, Joint
from linkplan.planner.certificate.integration import POSE_SLACK
from linkplan.planner.limits.efforts import holds_at_rest
from linkplan.planner.limits.joints import bounds_of_state
from linkplan.planner.limits.kinds import are_efforts_bounded, effort_bounds, limits_of
from linkplan.planner.limits.limit import Limit
from linkplan.planner.limits.rates import smooth_columns
from linkplan.planner.limits.samples import Poses
from linkplan.planner.phase_plane.grid import plane_of
from linkplan.planner.plan.verdict import Overrun, Verdict, infeasible
from linkplan.planner.problem.consistency import lacking_at_rest
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import Task
from linkplan.planner.search.every_motion import force_beyond, only_way, too_weak_on_the_path, where_of


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _End:
    """An end of a reach: its name, position, speed, the direction of time from it (1 or -1), and the other end."""

    name: str
    position: float
    speed: float
    along: int
    other: float
    other_speed: float


def no_way_to_stop(problem: Problem) -> Verdict | None:
    """Return the verdict on a speed at start or goal that no effort can stop or reach within the joint's range, or None."""
    motion, mechanism = problem.motion, problem.mechanism
    if mechanism.dof != 1 or motion.kind != "reach" or motion.goal_is_free or not are_efforts_bounded(problem):
        return None
    if mechanism.forces is not None:
        return None
    first, last = (0.0 if v is None else float(v[0]) for v in (motion.start_speed, motion.goal_speed))
    start, goal = float(motion.start[0]), float(motion.goal[0])
    ends = (
        _End(name="start", position=start, speed=first, along=1, other=goal, other_speed=last),
        _End(name="goal", position=goal, speed=last, along=-1, other=start, other_speed=first),
    )
    return next((found for end in ends if end.speed and (found := _beyond_the_range(problem, end)) is not None), None)


def _beyond_the_range(problem: Problem, end: _End) -> Verdict | None:
    mechanism, (low, high) = problem.mechanism, bounds_of_state(problem)[0][0]
    way, (joint,) = int(np.sign(end.speed)), mechanism.independent_joints
    step = way * end.along
    bound = high if step > 0 else low
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
    plane = plane_of(problem, s, poses)
    w = plane.leg(at, 0.5 * end.speed**2, ahead, -ahead, backwards=end.along < 0)
    # The share of the squared speed that must remain there is a hundred times the error of the quadrature.
    if len(w) < len(s) or w[-1] < 1e-4 * w[0]:
        return None
    passed = int(np.argmin(np.abs(s - end.other)))
    on_the_way = step * (end.other - end.position) > 0 and step * (bound - end.other) > 0
    if on_the_way and way * end.other_speed > 0 and w[abs(passed - at)] <= 0.5 * end.other_speed**2:
        return None
    does = "stops" if end.along > 0 else "gathers"
    room = abs(joint.shown(bound - end.position))
    words = (
        f"no effort within its limits {does} the {abs(joint.shown(end.speed)):.4g} {joint.unit}/s of joint"
        f" {joint.name} at the {end.name} within the {room:.4g} {joint.unit} to the end of its range at"
        f" {joint.text(bound, 5)} {joint.unit}"
    )
    return infeasible(words, known_by="phase plane")


# Poses on the only path may exceed a limit by this share of the quantity's size; the solver and the certificate decide on
# smaller overruns.
ONLY_WAY_SLACK = 1e-6


def plain_contradiction(problem: Problem) -> Verdict | None:
    """Return the verdict on a limit that no motion can satisfy, found without solving, or None."""
    looks = (
        _speed_at_an_end,
        _branches_on_the_way,
        _beyond_ctrl,
        _pose_beyond,
        _not_held,
        no_way_to_stop,
        _mean_speed,
        too_weak_on_the_path,
        force_beyond,
    )
    return next((verdict for look in looks if (verdict := look(problem)) is not None), None)


def _speed_at_an_end(problem: Problem) -> Verdict | None:
    """Return the verdict on a speed at start or goal beyond its limit, or None."""
    mechanism, motion = problem.mechanism, problem.motion
    for name in ("start_speed", "goal_speed"):
        value = getattr(motion, name)
        for column, joint in enumerate(mechanism.independent_joints):
            low, high = bounds_of_state(problem)[1][column]
            if value is not None and not low <= value[column] <= high:
                bound = high if value[column] > 0 else low
                words = (
                    f"motion.{name} of joint {joint.name} is {joint.text(value[column], 4)} {joint.unit}/s,"
                    f" beyond its speed limit of {joint.text(bound, 4)} {joint.unit}/s"
                )
                return infeasible(words, known_by="every motion", overruns=(_speed(joint, value[column], bound),))
    return None


def _not_held(problem: Problem) -> Verdict | None:
    """Return the verdict on a start or goal at rest that limits forbid to leave with an acceleration, and no motor holds."""
    if problem.mechanism.n_equations != problem.mechanism.dof:  # along a path, whose poses another check looks at
        return None
    import scipy

    smooth = np.eye(problem.mechanism.dof)[list(smooth_columns(problem))]
    for name, held in zip(("start", "goal"), holds_at_rest(problem), strict=True):
        still = np.vstack([held, smooth])
        free = scipy.linalg.null_space(still) if len(still) else None
        words = None if free is None else lacking_at_rest(problem.motion, problem.mechanism, problem.limits, name, free)
        if words is not None:
            why = "limits on effort rates ask for" if len(held) else "the limit or cost on jerk asks for"
            return infeasible(f"{words}, and {why} no acceleration there", known_by="every motion")
    return None


def _mean_speed(problem: Problem) -> Verdict | None:
    """Return the verdict on a joint whose mean speed between start and goal is beyond its limit, or None."""
    mechanism, motion = problem.mechanism, problem.motion
    if motion.kind != "reach" or motion.duration_s is None or motion.goal_is_free:
        return None
    for column, joint in enumerate(mechanism.independent_joints):
        mean = (motion.goal[column] - motion.start[column]) / motion.duration_s
        low, high = bounds_of_state(problem)[1][column]
        if not low <= mean <= high:
            bound = high if mean > 0 else low
            shortest = (motion.goal[column] - motion.start[column]) / bound if bound else np.inf
            words = (
                f"joint {joint.name} would have to move at {joint.text(mean, 4)} {joint.unit}/s on average"
                f" over {motion.duration_s:.4g} s, beyond its speed limit of {joint.text(bound, 4)} {joint.unit}/s; this"
                f" limit alone requires {shortest:.4g} s"
            )
            return infeasible(words, known_by="every motion", overruns=(_speed(joint, mean, bound),))
    return None


def _speed(joint: Joint, speed: float, bound: float) -> Overrun:
    """Return the overrun of a joint's speed limit, both in SI units."""
    value, limit = float(joint.shown(speed)), float(joint.shown(bound))
    return Overrun(limit="speed", name=joint.name, value=value, bound=limit, unit=f"{joint.unit}/s")


def _branches_on_the_way(problem: Problem) -> Verdict | None:
    """Return the verdict on a pose from start to goal at which the loops of one degree of freedom lose rank, or None."""
    mechanism, motion = problem.mechanism, problem.motion
    if mechanism.dof != 1 or motion.start is None or motion.goal is None:
        return None
    way = only_way(problem)
    if way is not None and all_regular(mechanism, way[::4]):
        return None
    low, high = sorted((float(motion.start[0]), float(motion.goal[0])))
    (joint,) = mechanism.independent_joints
    can = reach(mechanism)
    for position, rank in can.branching:
        if low < position < high and position not in can.single:
            words = (
                f"between start and goal, at {joint.name} = {joint.text(position, 5)} {joint.unit}, the"
                f" closure's rank falls from {len(mechanism.dependent)} to {rank}: the loops do not determine the motion"
                " beyond it, and no effort of the actuators does"
            )
            return infeasible(words, "motion", known_by="every motion")
    return None


def _pose_beyond(problem: Problem) -> Verdict | None:
    """Return the verdict on a limit that start, goal, a waypoint or a pose on the only path overruns, or None."""
    limits = [limit for limit in limits_of(problem) if limit.facts.of_position]
    for when, pose, open_at in _known_poses(problem) if limits else ():
        verdict = pose_beyond(problem, limits, pose[None], when, POSE_SLACK, open_at)
        if verdict is not None:
            return verdict
    poses = only_way(problem) if limits else None
    return None if poses is None else pose_beyond(problem, limits, poses, None, ONLY_WAY_SLACK)


def _known_poses(problem: Problem) -> Iterator[tuple[str, np.ndarray, tuple[Task, ...] | None]]:
    """Yield the names of start, goal and waypoints, their closed poses, and the tasks that an open pose satisfies."""
    mechanism, motion = problem.mechanism, problem.motion
    if motion.start is not None:
        yield "at the start", close_at(mechanism, motion.start), None
    if motion.goal is not None and not motion.goal_is_free:
        yield "at the goal", close_at(mechanism, motion.goal), None
    if motion.goal is not None and motion.goal_is_free:
        with contextlib.suppress(AssemblyError):  # the search finds that the loops do not close there
            yield "at the goal", close_at(mechanism, motion.goal), motion.goal_at
    for k, waypoint in enumerate(motion.waypoints):
        if not np.any(np.isnan(waypoint.guessed)):
            with contextlib.suppress(AssemblyError):  # the search finds that the loops do not close there
                pose = close_at(mechanism, waypoint.guessed)
                yield f"at motion.waypoints[{k}]", pose, waypoint.at if waypoint.at_rows else None


def pose_beyond(
    problem: Problem,
    limits: list[Limit],
    poses: np.ndarray,
    when: str | None,
    slack: float,
    tasks: tuple[Task, ...] | None = None,
) -> Verdict | None:
    """Return the verdict on the first limit that the worst of poses (n, n_q) overruns, or None.

    Args:
        problem: the problem.
        limits: on poses.
        poses: closed.
        when: the phrase on a single pose; None for poses on the only path.
        slack: the allowed overrun as a share of the limited quantity's size.
        tasks: of an open pose, whose other coordinates are guessed; None if the poses are known.
    """
    at = Poses(problem=problem, q=poses)
    for limit in limits:
        measured = limit.measured(at)
        if tasks is not None and not measured.known_from(tasks):
            continue
        low, high = measured.bounds
        nearest = np.clip(measured.values, low, high)
        finite = np.isfinite(measured.values)  # NaN is no proof; the motion's certificate names it
        off = np.abs(np.where(finite, measured.values, 0.0) - np.where(finite, nearest, 0.0))
        k = int(np.argmax(off))
        size = measured.pose_size or measured.size or abs(nearest[k]) or 1.0
        if off[k] > slack * size:
            unit, title = f" {measured.unit}".rstrip(), limit.facts.words.format(measured.name)
            value = measured.values[k] if abs(measured.values[k]) > POSITION_ROUNDING * size else 0.0
            words = (
                f"{title} {limit.facts.verb} {value:.6g}{unit} {when or where_of(problem, poses[k])},"
                f" {off[k]:.4g}{unit} {limit.facts.beyond} its limit of {nearest[k]:.6g}{unit}"
            )
            over = Overrun(
                limit=limit.key, name=measured.name, value=float(value), bound=float(nearest[k]), unit=measured.unit
            )
            return infeasible(words, known_by="every motion", overruns=(over,))
    return None


def _beyond_ctrl(problem: Problem) -> Verdict | None:
    """Return the verdict on a start or goal where no ctrl of a servo gives an effort within its limits, or None."""
    mechanism, motion = problem.mechanism, problem.motion
    if not any(actuator.limits_control for actuator in mechanism.actuators):
        return None
    for name in ("start", "goal"):
        s, speed = getattr(motion, name), getattr(motion, f"{name}_speed")
        if s is None or (name == "goal" and motion.goal_is_free):
            continue
        q, v = close_at(mechanism, s)[None], np.zeros((1, mechanism.dof)) if speed is None else speed[None]
        allowed = effort_bounds(problem)
        ends = [needed_controls(mechanism, q, v, end[None])[0] for end in allowed.T]
        for j, (least, most) in enumerate(zip(np.min(ends, axis=0), np.max(ends, axis=0), strict=True)):
            actuator = mechanism.actuators[j]
            low, high = actuator.control_lower, actuator.control_upper
            nearest_ctrl = least if least > high else most
            # If its whole range is beyond a clamp of its force, a servo gives the clamped force, which may be within the
            # limits.
            clamp = actuator.upper if (most < low) == (actuator.gain > 0) else actuator.lower
            given = allowed[j, 0] <= clamp <= allowed[j, 1]
            if actuator.limits_control and (least > high or most < low) and not given:
                words = (
                    f"{actuator.name} on {actuator.target} would need a ctrl of {nearest_ctrl:.4g} at the {name}"
                    f" to give an effort within its limits; its ctrlrange is {low:g} to {high:g}"
                )
                return infeasible(words, known_by="every motion")
    return None
