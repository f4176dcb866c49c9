"""Before any solving: is the problem within what the mechanism can do at all, and is there a plain contradiction in it?"""

import functools

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.poses.controls import needed_controls
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.reach import reach
from linkplan.models.poses.singular_poses import all_regular
from linkplan.planner.certificate.boundary import SITE_SLACK
from linkplan.planner.limits.extra import ExtraPathLimit
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.limits.site import site_title
from linkplan.planner.phase_plane.energy_bounds import no_way_to_stop
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import SiteLimit, SitePoint

# The words on poses between start and goal of one degree of freedom, and the tolerance of ranges [rad or m] and of the
# margin to singular poses [share] on the way: smaller overruns are left to the solver and the certificate.
_PASSES, _POSE_TOLERANCE = "between start and goal, where every motion of one degree of freedom passes", 1e-6


def plain_contradiction(problem: Problem) -> str | None:
    """Return the sentence on a limit that no motion can keep, found without solving, or None."""
    looks = (
        _speed_at_an_end,
        _range_at_an_end,
        _branches_on_the_way,
        _singular,
        _beyond_ctrl,
        _site_beyond,
        _range_on_the_only_way,
        no_way_to_stop,
        _mean_speed,
    )
    return next((sentence for look in looks if (sentence := look(problem)) is not None), None)


def _speed_at_an_end(problem: Problem) -> str | None:
    """Return the sentence on a speed at start or goal beyond its limit, or None."""
    mechanism, motion = problem.mechanism, problem.motion
    for name in ("start_speed", "goal_speed"):
        value = getattr(motion, name)
        for column, joint in enumerate(mechanism.independent_joints):
            low, high = problem.limits.speed[mechanism.independent[column]]
            if value is not None and not low <= value[column] <= high:
                return (
                    f"infeasible: motion.{name} of joint {joint.name} is {joint.said(value[column], 4)} {joint.unit}/s,"
                    f" beyond its speed limit of {joint.said(high if value[column] > 0 else low, 4)} {joint.unit}/s"
                )
    return None


def _range_at_an_end(problem: Problem) -> str | None:
    """Return the sentence on a joint that stands beyond its range at start or goal, or None."""
    mechanism, motion = problem.mechanism, problem.motion
    for name in ("start", "goal"):
        if getattr(motion, name) is None or (name == "goal" and motion.goal_is_free):
            continue
        pose = close_at(mechanism, getattr(motion, name))
        for joint, x, (low, high) in zip(mechanism.joints, pose, problem.limits.position, strict=True):
            if not low <= x <= high:
                return (
                    f"infeasible: joint {joint.name} stands at {joint.said(x, 4)} {joint.unit} at the {name},"
                    f" {abs(joint.shown(x - min(max(x, low), high))):.4g} {joint.unit} beyond its limit of"
                    f" {joint.said(min(max(x, low), high), 4)}"
                )
    return None


def _mean_speed(problem: Problem) -> str | None:
    """Return the sentence on a joint whose mean speed between start and goal is beyond its limit, or None."""
    mechanism, motion = problem.mechanism, problem.motion
    if motion.kind != "reach" or motion.duration_s is None or motion.goal_is_free:
        return None
    for column, joint in enumerate(mechanism.independent_joints):
        mean = (motion.goal[column] - motion.start[column]) / motion.duration_s
        low, high = problem.limits.speed[mechanism.independent[column]]
        if not low <= mean <= high:
            bound = high if mean > 0 else low
            shortest = (motion.goal[column] - motion.start[column]) / bound if bound else np.inf
            return (
                f"infeasible: joint {joint.name} would have to move at {joint.said(mean, 4)} {joint.unit}/s on average"
                f" over {motion.duration_s:.4g} s, beyond its speed limit of {joint.said(bound, 4)} {joint.unit}/s;"
                f" that limit alone asks for {shortest:.4g} s"
            )
    return None


def _branches_on_the_way(problem: Problem) -> str | None:
    """Return the sentence on a pose at which the loops lose rank between start and goal of a single freedom, or None."""
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
            return (
                f"infeasible: between start and goal, at {joint.name} = {joint.said(position, 5)} {joint.unit}, the"
                f" closure's rank falls from {len(mechanism.dependent)} to {rank}: the loops do not say how the mechanism"
                " goes on there, and no effort of its actuators does"
            )
    return None


def _site_beyond(problem: Problem) -> str | None:
    """Return the sentence on a site, tendon or extra limit that start, goal or a waypoint overruns, or None."""
    motion, limits = problem.motion, problem.limits
    places = [("the start", motion.start, None), ("the goal", motion.goal, motion.goal_at if motion.goal_is_free else None)]
    for k, waypoint in enumerate(motion.waypoints):
        places.append((f"motion.waypoints[{k}]", waypoint.guessed, waypoint.at if waypoint.at_rows else None))
    for name, s, open_at in places:
        if s is None or np.any(np.isnan(s)) or not _limits_poses(problem):
            continue
        pose = close_at(problem.mechanism, s)[None]
        sentence = _pose_beyond(problem, pose, f"at {name}") if open_at is None else None
        if sentence is not None:
            return sentence
        for limit in limits.site:
            known = open_at is None or _known(limit, open_at)
            sentence = _beyond(problem, limit, pose, f"at {name}") if known else None
            if sentence is not None:
                return sentence
    return _on_the_only_way(problem)


def _known(limit: SiteLimit, points: tuple[SitePoint, ...]) -> bool:
    """True if the given places of sites of an open pose determine the quantity that a limit on a site bounds."""
    looked_at = np.ones(3, dtype=bool) if limit.normal is None else limit.normal != 0
    return any(p.index == limit.index and not np.any(np.isnan(p.point[looked_at])) for p in points)


def _on_the_only_way(problem: Problem) -> str | None:
    """Return the sentence on a limit on poses that is overrun between start and goal of a single freedom."""
    poses = only_way(problem) if _limits_poses(problem) else None
    if poses is None:
        return None
    beyond = (_beyond(problem, limit, poses, _PASSES) for limit in problem.limits.site)
    return _pose_beyond(problem, poses, _PASSES) or next((found for found in beyond if found), None)


def _limits_poses(problem: Problem) -> bool:
    return bool(problem.limits.site or problem.mechanism.tendons or problem.mechanism.balls or problem.extra_limits)


def _pose_beyond(problem: Problem, poses: np.ndarray, when: str) -> str | None:
    """Return the sentence on a tendon, ball joint or extra limit that the worst of poses (n, n_q) overruns, or None."""
    return _tendon_beyond(problem, poses, when) or _ball_beyond(problem, poses, when) or _extra_beyond(problem, poses, when)


def _extra_beyond(problem: Problem, poses: np.ndarray, when: str) -> str | None:
    """Return the sentence on an extra limit on the pose alone that the worst of poses (n, n_q) overruns, or None."""
    for limit in ExtraPathLimit.of(problem):
        if not limit.of_position:
            continue
        extra, values = limit.extra, limit.values(problem.mechanism, poses)
        nearest = np.clip(values, extra.lower, extra.upper)
        k = int(np.argmax(np.abs(values - nearest)))
        off = abs(values[k] - nearest[k])
        if off > SITE_SLACK * extra.size:
            unit = f" {extra.unit}".rstrip()
            value = f"{values[k]:.6g}{unit} {when}, {off:.4g}{unit} beyond its limit of {nearest[k]:.6g}"
            return f"infeasible: the extra limit '{extra.name}' is {value}"
    return None


@functools.lru_cache(maxsize=4)
def only_way(problem: Problem) -> np.ndarray | None:
    """Return poses (n, n_q) between start and goal of a single freedom, all of which every motion passes; None elsewhere."""
    mechanism, motion = problem.mechanism, problem.motion
    if mechanism.dof != 1 or motion.start is None or motion.goal is None or motion.goal_is_free:
        return None
    try:
        between = np.linspace(motion.start, motion.goal, 401)
        return follow(mechanism, between, close_at(mechanism, motion.start), problem.solver.deadline)
    except AssemblyError:  # the way is not open: said elsewhere
        return None


def _tendon_beyond(problem: Problem, poses: np.ndarray, when: str) -> str | None:
    """Return the sentence on a tendon whose range the worst of poses (n, n_q) leaves, or None."""
    mechanism = problem.mechanism
    if not mechanism.tendons:
        return None
    lengths = sampled(mechanism.dynamics.tendon_length, poses)[:, :, 0]
    for tendon, values in zip(mechanism.tendons, lengths.T, strict=True):
        off = np.maximum(tendon.low - values, values - tendon.high)
        k = int(np.argmax(off))
        if off[k] > SITE_SLACK * tendon.span:
            return (
                f"infeasible: the length of tendon {tendon.name} is {values[k]:.6g} {tendon.unit}".rstrip()
                + f" {when}, {off[k]:.4g} beyond its range of {tendon.low:g} to {tendon.high:g}"
            )
    return None


def _ball_beyond(problem: Problem, poses: np.ndarray, when: str) -> str | None:
    """Return the sentence on a ball joint beyond the largest angle at the worst of poses (n, n_q), or None."""
    mechanism = problem.mechanism
    for item, ball in enumerate(mechanism.balls):
        turns = sampled(mechanism.dynamics.ball_turns, poses)[:, item, 0]
        angle = float(np.degrees(2 * np.arcsin(np.sqrt(np.clip(turns.max(), 0.0, 1.0)))))
        if turns.max() > np.sin(ball.largest / 2) ** 2 * (1 + SITE_SLACK):
            most = np.degrees(ball.largest)
            return (
                f"infeasible: ball joint {ball.name} is turned by {angle:.6g} deg {when}, beyond its range of {most:.6g} deg"
            )
    return None


def _range_on_the_only_way(problem: Problem) -> str | None:
    """Return the sentence on a joint beyond its range, or a pose too near to a singular one, on the only way; or None."""
    mechanism, limit, margin = problem.mechanism, problem.limits.position, problem.limits.singular_margin
    dependent = mechanism.dependent
    poses = only_way(problem) if margin or np.any(np.isfinite(limit[dependent])) else None
    if poses is None:
        return None
    (driven,) = mechanism.independent
    (crank,), joints = mechanism.independent_joints, mechanism.joints
    nearest = np.clip(poses, limit[:, 0], limit[:, 1])
    off = np.abs(poses - nearest)
    k, i = (int(x) for x in np.unravel_index(int(np.argmax(off)), off.shape))
    if off[k, i] > _POSE_TOLERANCE:
        at = f"{crank.name} = {crank.said(poses[k, driven], 4)} {crank.unit}"
        return (
            f"infeasible: joint {joints[i].name} stands at {joints[i].said(poses[k, i], 5)} {joints[i].unit} where {at},"
            f" {_PASSES}, {abs(joints[i].shown(off[k, i])):.4g} {joints[i].unit} beyond its limit of"
            f" {joints[i].said(nearest[k, i], 5)}"
        )
    ratios = singularity_ratios(problem, poses) if margin else np.ones(1)
    k = int(np.argmin(ratios))
    if ratios[k] >= margin * (1 - _POSE_TOLERANCE):
        return None
    at = f"{crank.name} = {crank.said(poses[k, driven], 4)} {crank.unit}"
    return (
        f"infeasible: where {at}, {_PASSES}, the mechanism is at {ratios[k]:.4g} of the distance from a singular pose that"
        f" the home pose has, {margin - ratios[k]:.3g} short of limits.singular_margin = {margin:g}"
    )


def _beyond(problem: Problem, limit: SiteLimit, poses: np.ndarray, when: str) -> str | None:
    """Return the sentence on a site's limit that the worst of poses (n, n_q) leaves, or None."""
    values = limit.value(places_of(problem.mechanism, limit.index, poses))
    nearest = np.clip(values, limit.low, limit.high)
    k = int(np.argmax(np.abs(values - nearest)))
    off = abs(float(values[k] - nearest[k]))
    if off <= SITE_SLACK * problem.mechanism.extent_m:
        return None
    value = f"{float(values[k]):.6g} m {when}"
    return f"infeasible: {site_title(limit)} is {value}, {off:.4g} m beyond its limit of {float(nearest[k]):.6g}"


def _beyond_ctrl(problem: Problem) -> str | None:
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
        for j, (least, most) in enumerate(zip(np.min(ends, axis=0), np.max(ends, axis=0), strict=True)):
            actuator = mechanism.actuators[j]
            low, high = actuator.control_lower, actuator.control_upper
            nearest_ctrl = least if least > high else most
            # Where all of its range is beyond a clamp of its force, a servo gives the clamp: is that within the limits?
            clamp = actuator.upper if (most < low) == (actuator.gain > 0) else actuator.lower
            given = problem.limits.effort[j, 0] <= clamp <= problem.limits.effort[j, 1]
            if actuator.limits_control and (least > high or most < low) and not given:
                return (
                    f"infeasible: {actuator.name} on {actuator.target} would need a ctrl of {nearest_ctrl:.4g} at the {name}"
                    f" for any effort within its limits, beyond its ctrlrange of {low:g} to {high:g}"
                )
    return None


def _singular(problem: Problem) -> str | None:
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
