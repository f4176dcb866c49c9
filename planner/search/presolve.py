"""Before any solving: is the problem within what the mechanism can do at all, and is there a plain contradiction in it?"""

import functools

import numpy as np

from linkplan.models.errors import AssemblyError, ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import Reach, close_at, follow, reach
from linkplan.models.poses.controls import needed_controls
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.certificate.margins import singularity_ratios
from linkplan.planner.certificate.site_margins import SITE_SLACK, title
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.problem.sites import SiteLimit, SitePoint
from linkplan.planner.search.turning import check_turns

# Poses looked at between start and goal of a single freedom.
_BETWEEN = 401


@functools.lru_cache(maxsize=16)
def _reach(mechanism: Mechanism) -> Reach:
    """Return what a mechanism reaches: walked once, as planning again and again asks for it each time."""
    return reach(mechanism)


def start_pose_of(problem: PlanningProblem) -> np.ndarray:
    """Return the closed pose at the start.

    Raises:
        ProblemError: when start, goal or reference lie outside what the mechanism reaches, with the interval; as of
            `check_turns`.
    """
    mechanism, motion = problem.mechanism, problem.motion
    can = _reach(mechanism) if mechanism.dof == 1 else None
    for name in ("start", "goal"):
        value = getattr(motion, name)
        if value is not None:
            _check_reach(problem, f"motion.{name}_deg", value, can)
    for k, waypoint in enumerate(motion.waypoints):
        if not np.all(np.isnan(waypoint.position)):
            _check_reach(problem, f"motion.waypoints[{k}].at_deg", waypoint.position, can)
    if motion.start is not None or problem.reference is None:
        pose = np.array(mechanism.home) if motion.start is None else close_at(mechanism, motion.start)
        if motion.turns is not None:
            check_turns(problem, pose, can)
        return pose
    first = problem.reference.derivative(np.zeros(1))[0]
    period = np.linspace(0.0, problem.reference.period_s, 181)
    values = problem.reference.derivative(period)
    for extreme in (np.argmin, np.argmax):
        for column in range(mechanism.dof):
            _check_reach(problem, "reference", values[int(extreme(values[:, column]))], can, ranges=False)
    return close_at(mechanism, first)


def _check_reach(problem: PlanningProblem, what: str, s: np.ndarray, can: Reach | None, ranges: bool = True) -> None:
    mechanism = problem.mechanism
    for column, joint in enumerate(mechanism.independent_joints):
        if np.isnan(s[column]):  # a waypoint leaves it free
            continue
        index = int(mechanism.independent[column])
        low, high = problem.limits.position[index]
        interval, reason = (low, high), f"range of {joint.name}"
        inside = low <= s[column] <= high
        if inside or not ranges:
            if can is None or can.turns_fully:
                continue
            interval = (can.lower.position, can.upper.position)
            inside = interval[0] <= s[column] <= interval[1]
            reason = can.lower.reason if s[column] < interval[0] else can.upper.reason
        if not inside:
            raise ProblemError(
                f"{what} {joint.name} = {joint.said(s[column], 6)} {joint.unit} is beyond reach:"
                f" {joint.name} reaches from {joint.said(interval[0], 6)} to {joint.said(interval[1], 6)} {joint.unit}"
                f" ({reason}"
                f"{_way_through(can, reason, s[column])})"
            )


def _way_through(can: Reach | None, reason: str, asked: float) -> str:
    """Return what leads past the end of a reach at a dead centre of its coordinate, nothing at one that branches."""
    if can is None or reason != "singular pose":
        return ""
    end = can.lower.position if asked < can.lower.position else can.upper.position
    if end in can.single:
        return "; the loops lose rank there, and no other coordinate passes it"
    if end in dict(can.branching):
        return "; the mechanism may branch there"
    return "; another joint as mechanism.independent may pass it"


def plain_contradiction(problem: PlanningProblem) -> str | None:
    """Return the sentence on a limit that no motion can keep, found without solving, or None."""
    mechanism, motion, limits = problem.mechanism, problem.motion, problem.limits
    for name in ("start_speed", "goal_speed"):
        value = getattr(motion, name)
        for column, joint in enumerate(mechanism.independent_joints):
            low, high = limits.speed[mechanism.independent[column]]
            if value is not None and not low <= value[column] <= high:
                return (
                    f"infeasible: motion.{name} of joint {joint.name} is {joint.said(value[column], 4)} {joint.unit}/s,"
                    f" beyond its speed limit of {joint.said(high if value[column] > 0 else low, 4)} {joint.unit}/s"
                )
    for name in ("start", "goal"):
        if getattr(motion, name) is None or (name == "goal" and motion.goal_is_free):
            continue
        pose = close_at(mechanism, getattr(motion, name))
        for joint, x, (low, high) in zip(mechanism.joints, pose, limits.position, strict=True):
            if not low <= x <= high:
                return (
                    f"infeasible: joint {joint.name} stands at {joint.said(x, 4)} {joint.unit} at the {name},"
                    f" {abs(joint.shown(x - min(max(x, low), high))):.4g} {joint.unit} beyond its limit of"
                    f" {joint.said(min(max(x, low), high), 4)}"
                )
    contradiction = _branches_on_the_way(problem) or _singular(problem) or _beyond_ctrl(problem) or _site_beyond(problem)
    if contradiction is not None:
        return contradiction
    if motion.kind == "reach" and motion.duration_s is not None and not motion.goal_is_free:
        for column, joint in enumerate(mechanism.independent_joints):
            mean = (motion.goal[column] - motion.start[column]) / motion.duration_s
            low, high = limits.speed[mechanism.independent[column]]
            if not low <= mean <= high:
                bound = high if mean > 0 else low
                shortest = (motion.goal[column] - motion.start[column]) / bound if bound else np.inf
                return (
                    f"infeasible: joint {joint.name} would have to move at {joint.said(mean, 4)} {joint.unit}/s on average"
                    f" over {motion.duration_s:.4g} s, beyond its speed limit of {joint.said(bound, 4)} {joint.unit}/s;"
                    f" that limit alone asks for {shortest:.4g} s"
                )
    return None


def _branches_on_the_way(problem: PlanningProblem) -> str | None:
    """Return the sentence on a pose at which the loops lose rank between start and goal of a single freedom, or None."""
    mechanism, motion = problem.mechanism, problem.motion
    if mechanism.dof != 1 or motion.start is None or motion.goal is None:
        return None
    low, high = sorted((float(motion.start[0]), float(motion.goal[0])))
    (joint,) = mechanism.independent_joints
    can = _reach(mechanism)
    for position, rank in can.branching:
        if low < position < high and position not in can.single:
            return (
                f"infeasible: between start and goal, at {joint.name} = {joint.said(position, 5)} {joint.unit}, the"
                f" closure's rank falls from {len(mechanism.dependent)} to {rank}: the loops do not say how the mechanism"
                " goes on there, and no effort of its actuators does"
            )
    return None


def _site_beyond(problem: PlanningProblem) -> str | None:
    """Return the sentence on a site that start, goal or a waypoint puts where the limits do not want it, or None."""
    motion, limits = problem.motion, problem.limits
    places = [("the start", motion.start, None), ("the goal", motion.goal, motion.goal_at if motion.goal_is_free else None)]
    for k, waypoint in enumerate(motion.waypoints):
        places.append((f"motion.waypoints[{k}]", waypoint.guessed, waypoint.at if waypoint.at_rows else None))
    for name, s, open_at in places:
        if s is None or np.any(np.isnan(s)) or not limits.site:
            continue
        pose = close_at(problem.mechanism, s)[None]
        for limit in limits.site:
            known = open_at is None or _known(limit, open_at)
            sentence = _beyond(problem, limit, pose, f"at {name}") if known else None
            if sentence is not None:
                return sentence
    return _on_the_only_way(problem)


def _known(limit: SiteLimit, points: tuple[SitePoint, ...]) -> bool:
    """Return whether the places of sites, of a pose that is open, say all that a limit on a site looks at."""
    looked_at = np.ones(3, dtype=bool) if limit.normal is None else limit.normal != 0
    return any(p.index == limit.index and not np.any(np.isnan(p.point[looked_at])) for p in points)


def _on_the_only_way(problem: PlanningProblem) -> str | None:
    """Return the sentence on a site that leaves its limits between start and goal of a single freedom, or None."""
    mechanism, motion = problem.mechanism, problem.motion
    if mechanism.dof != 1 or motion.start is None or motion.goal is None or not problem.limits.site:
        return None
    try:
        poses = follow(mechanism, np.linspace(motion.start, motion.goal, _BETWEEN), close_at(mechanism, motion.start))
    except AssemblyError:  # the way is not open: said elsewhere
        return None
    said = "between start and goal, where every motion of one degree of freedom passes"
    return next((found for limit in problem.limits.site if (found := _beyond(problem, limit, poses, said))), None)


def _beyond(problem: PlanningProblem, limit: SiteLimit, poses: np.ndarray, when: str) -> str | None:
    """Return the sentence on a site's limit that the worst of poses (n, n_q) leaves, or None."""
    values = limit.value(places_of(problem.mechanism, limit.index, poses))
    nearest = np.clip(values, limit.low, limit.high)
    k = int(np.argmax(np.abs(values - nearest)))
    off = abs(float(values[k] - nearest[k]))
    if off <= SITE_SLACK * problem.mechanism.extent_m:
        return None
    value = f"{float(values[k]):.6g} m {when}"
    return f"infeasible: {title(limit)} is {value}, {off:.4g} m beyond its limit of {float(nearest[k]):.6g}"


def _beyond_ctrl(problem: PlanningProblem) -> str | None:
    """Return the sentence on a start or goal where no ctrl of a servo gives an effort within its limits, or None."""
    mechanism, motion = problem.mechanism, problem.motion
    if not any(actuator.limits_control for actuator in mechanism.actuators):
        return None
    for name in ("start", "goal"):
        s, speed = getattr(motion, name), getattr(motion, f"{name}_speed")
        if s is None or (name == "goal" and motion.goal_is_free):
            continue
        q, v = close_at(mechanism, s)[None], np.zeros((1, mechanism.dof)) if speed is None else speed[None]
        ends = [needed_controls(mechanism, q, v, end[None])[0] for end in problem.limits.effort.T]
        for actuator, least, most in zip(mechanism.actuators, np.min(ends, axis=0), np.max(ends, axis=0), strict=True):
            low, high = actuator.control_lower, actuator.control_upper
            nearest_ctrl = least if least > high else most
            if actuator.limits_control and (least > high or most < low):
                return (
                    f"infeasible: {actuator.name} on {actuator.target} would need a ctrl of {nearest_ctrl:.4g} at the {name}"
                    f" for any effort within its limits, beyond its ctrlrange of {low:g} to {high:g}"
                )
    return None


def _singular(problem: PlanningProblem) -> str | None:
    """Return the sentence on a start or goal that is nearer to a singular pose than the problem admits, or None."""
    margin, motion = problem.limits.singular_margin, problem.motion
    for name in ("start", "goal"):
        s = getattr(motion, name)
        if s is None or not margin or (name == "goal" and motion.goal_is_free):
            continue
        ratio = float(singularity_ratios(problem, close_at(problem.mechanism, s)[None])[0])
        if ratio < margin:
            return (
                f"infeasible: the {name} is at {ratio:.4g} of the distance from a singular pose that the home pose has,"
                f" {margin - ratio:.3g} short of limits.singular_margin = {margin:g}"
            )
    return None
