"""From a [motion] table to its motion, with every value checked against the mechanism."""

import json

import numpy as np

from linkplan.models.errors import AssemblyError, ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.equilibrium import lock_words, rests_on_stops, spring_equilibrium, sprung_freedoms, stop_sentence
from linkplan.planner.problem.keys.motion import MotionSection, WaypointSection
from linkplan.planner.problem.limits import Limits
from linkplan.planner.problem.motion import Motion, Waypoint
from linkplan.planner.problem.path import SitePath, check_path
from linkplan.planner.problem.reference import Reference, is_whole
from linkplan.planner.problem.settings import DERIVED, joint_values
from linkplan.planner.problem.sites import Task, key_of, pose_at, tasks_of

# Keys of [motion] that a path replaces.
_NOT_ALONG_A_PATH = (
    *("start_at", "start_body_deg", "goal_deg", "goal_m", "goal_at", "goal_body_deg"),
    *("start_speed_deg_s", "start_speed_m_s", "goal_speed_deg_s", "goal_speed_m_s", "waypoints", "turns"),
    *(f"{name}_acceleration_{unit}_s2" for name in ("start", "goal") for unit in ("deg", "m")),
)
# Largest difference of a dependent joint named in start_deg or goal_deg from the closed loop's position.
_POSE_TOLERANCE = np.radians(0.05)


def motion_of(
    section: MotionSection,
    mechanism: Mechanism,
    reference: Reference | None,
    limits: Limits,
    path: SitePath | None = None,
) -> Motion:
    """Return the motion of a [motion] table; poses found from sites and bodies satisfy the limits if possible."""
    kind, duration = section.kind, section.duration_s
    if kind == "follow":
        return _along(section, mechanism, limits, path)
    if duration is None and reference is not None:
        duration = reference.period_s
    duration = None if duration == "free" else duration
    repeats = kind == "periodic" and reference is not None and duration is not None
    if repeats and not is_whole(duration / reference.period_s):
        raise ProblemError(
            f"motion.duration_s of a periodic motion must be a whole number of the reference's periods of"
            f" {reference.period_s:g} s, got {duration:g}"
        )
    start, start_at, _ = _end(section, "start", kind, mechanism, limits, mechanism.home)
    begin = mechanism.home if start is None else _closed(mechanism, start)
    _check_hold(section)
    goal, goal_at, goal_rows = _end(section, "goal", kind, mechanism, limits, begin)
    speeds = [_state(section, f"{name}_speed_s", mechanism, 0.0) for name in ("start", "goal")]
    accelerations = [_state(section, f"{name}_acceleration_s2", mechanism, np.nan) for name in ("start", "goal")]
    goal_named = np.isin(mechanism.independent, list(_goal_joints(section, mechanism)))
    if kind == "reach" and reference is not None and duration is not None:  # ends default to the reference's
        ends = [reference.derivative(np.array([0.0, duration]), order) for order in (0, 1)]
        given = zip((start, goal), speeds, ends[1], strict=True)
        speeds = [own if s is None and v is None else v for s, v, own in given]
        goal_named |= goal is None
        start, goal = (ends[0][k] if s is None else s for k, s in enumerate((start, goal)))
    motion = Motion(
        kind=kind,
        start=start,
        goal=goal,
        start_at=start_at,
        goal_at=goal_at,
        goal_rows=goal_rows,
        start_speed=speeds[0],
        goal_speed=speeds[1],
        start_acceleration=accelerations[0],
        goal_acceleration=accelerations[1],
        duration_s=duration,
        min_duration_s=section.min_duration_s,
        max_duration_s=section.max_duration_s,
        waypoints=_waypoints(section.waypoints, mechanism, limits, begin),
        turns=_turns(section.turns, mechanism),
        goal_named=tuple(np.flatnonzero(goal_named).tolist()),
    )
    _check_poses(section, mechanism, motion)
    return motion


def _along(section: MotionSection, mechanism: Mechanism, limits: Limits, path: SitePath | None) -> Motion:
    """Return the motion of a site along its path; it starts in the pose nearest to the joints of the start."""
    check_path(path, "follow", {})
    assert path is not None  # as checked
    unused = [key for key in _NOT_ALONG_A_PATH if getattr(section, key)]
    if unused:
        raise ProblemError(
            f"motion.{unused[0]} cannot be set for motion.kind 'follow', which goes from the first point of its [path] to"
            " the last; path.start_speed_m_s and path.goal_speed_m_s are speeds there"
        )
    duration = None if section.duration_s == "free" else section.duration_s
    if path.feed and np.isfinite(path.speeds[0]):
        if duration is not None:
            raise ProblemError(
                'path.feed_m_s gives the duration, and motion.duration_s another one; path.feed_m_s = "free" takes it'
            )
        duration = path.curve.ways[1][-1] / path.speeds[0]
    near = _state(section, "start", mechanism, None)
    s, v, a = path.end_poses(
        mechanism, limits.position, limits.tasks, mechanism.home if near is None else _closed(mechanism, near)
    )
    return Motion(
        kind="follow",
        start=s[0],
        goal=s[1],
        start_speed=v[0],
        goal_speed=v[1],
        start_acceleration=a[0],
        goal_acceleration=a[1],
        duration_s=duration,
        min_duration_s=section.min_duration_s,
        max_duration_s=section.max_duration_s,
        goal_named=tuple(range(mechanism.dof)),
    )


def _check_hold(section: MotionSection) -> None:
    """Refuse a hold with keys of a motion, and one without a duration."""
    if section.kind != "hold":
        return
    ends = [f"goal_{key}" for key in ("deg", "m", "at", "body_deg")]
    speeds = [f"{name}_speed_{unit}_s" for name in ("goal", "start") for unit in ("deg", "m")]
    asked = next((key for key in (*ends, *speeds, "waypoints") if getattr(section, key)), None)
    if asked is not None:
        raise ProblemError(f"motion.{asked} belongs to a motion, but motion.kind 'hold' stays at its start")
    if not isinstance(section.duration_s, int | float):
        raise ProblemError(f"motion.kind 'hold' needs a motion.duration_s in seconds, got {section.duration_s or 'none'!r}")


def _goal_joints(section: MotionSection, mechanism: Mechanism) -> set[int]:
    """Return the joints with a position or speed in the goal."""
    return set().union(*(joint_values(section, key, "motion", mechanism) for key in ("goal", "goal_speed_s")))


def _state(
    section: MotionSection | WaypointSection, key: str, mechanism: Mechanism, default: float | None, where: str = "motion"
) -> np.ndarray | None:
    """Return the independent joints' values (n_s,) of a boundary condition, or None if none is given."""
    values = joint_values(section, key, where, mechanism)
    if not values:
        return None
    result = []
    if default is None:
        values = _with_rests(values, f"{where}.{key}", mechanism)
    for index, actuated in zip(mechanism.independent, mechanism.actuated, strict=True):
        joint = mechanism.joints[index]
        if index not in values and default is None and actuated:
            named = sorted(mechanism.joints[i].name for i in values)
            as_many = len(values) == mechanism.dof
            hint = f"; mechanism.independent = {json.dumps(named)} plans in the named joints" if as_many else ""
            raise ProblemError(f"{where}.{key}_{joint.unit} has no value for the independent joint {joint.name}{hint}")
        value = values.get(int(index), default)  # NaN (free) in a waypoint
        # A coordinate that is not named, because nothing moves or holds it, starts at home.
        result.append(mechanism.home[index] if value is None else joint.read(value))
    if key.endswith(("_s", "_s2")):
        _refuse_dependent(values, f"{where}.{key}", mechanism)
    return np.array(result)


def _refuse_dependent(values: dict[int, float], where: str, mechanism: Mechanism) -> None:
    """Refuse speeds of dependent joints."""
    for index in values:
        if index not in mechanism.independent:
            raise ProblemError(
                f"{where} of joint {mechanism.joints[index].name}: it follows from"
                f" {', '.join(j.name for j in mechanism.independent_joints)}; name those"
            )


def _end(
    section: MotionSection, name: str, kind: str, mechanism: Mechanism, limits: Limits, begin: np.ndarray
) -> tuple[np.ndarray | None, tuple[Task, ...], tuple[int, ...]]:
    """Return a start or goal (n_s,) given by joints or by sites and bodies, their tasks, and `Motion.goal_rows`."""
    named = [key for key in (f"{name}_deg", f"{name}_m") if getattr(section, key)]
    where = f"motion.{name}_{{}}"
    sites, bodies = getattr(section, f"{name}_at"), getattr(section, f"{name}_body_deg")
    if not sites and not bodies:
        return _state(section, name, mechanism, None), (), ()
    tasks = tasks_of(sites, bodies, where, mechanism)
    key = key_of(tasks, where)
    if named:
        raise ProblemError(f"{key} and motion.{named[0]} both give the {name}; keep one")
    if kind == "track":
        raise ProblemError(f"{key} belongs to motion.kind 'reach' or 'periodic'; 'track' prescribes every instant")
    s, rows = pose_at(tasks, where, mechanism, limits.position, limits.tasks, begin)
    if rows and (name == "start" or kind != "reach"):
        open_pose = (
            f"{key} leaves some of the {mechanism.dof} degrees of freedom of '{mechanism.name}' open; only the end of a"
            " 'reach'"
        )
        raise ProblemError(f"{open_pose} may: name more coordinates, or the joints in motion.{name}_deg")
    return s, tasks, rows


def _turns(asked: dict[str, int] | None, mechanism: Mechanism) -> np.ndarray | None:
    """Return the whole turns (n_s,) over a period of a periodic motion; None if it returns."""
    if asked is None:
        return None
    turns = np.zeros(mechanism.dof)
    places = {int(index): column for column, index in enumerate(mechanism.independent)}
    for name, n in asked.items():
        index = mechanism.joint_index(name, ProblemError)
        joint = mechanism.joints[index]
        if joint.kind != "hinge" or joint.chart is not None:
            what = "slide" if joint.kind == "slide" else "part of a ball joint"
            raise ProblemError(f"motion.turns of joint {name}: it is a {what}; only hinges turn continuously")
        if index not in places:
            names = ", ".join(j.name for j in mechanism.independent_joints)
            raise ProblemError(f"motion.turns of joint {name}: its turns follow from {names}; name those")
        turns[places[index]] = n
    return turns


def _closed(mechanism: Mechanism, s: np.ndarray) -> np.ndarray:
    """Return the closed pose (n_q,) at a start; home if it does not close, because the start is checked elsewhere."""
    try:
        return close_at(mechanism, s)
    except AssemblyError:
        return mechanism.home


def _with_rests(values: dict[int, float], where: str, mechanism: Mechanism) -> dict[int, float]:
    """Return a state's values; undriven coordinates on springs that it does not name are at equilibrium."""
    if all(index in values for index in mechanism.independent.tolist()):
        return values
    unnamed = tuple(c for c in sprung_freedoms(mechanism) if int(mechanism.independent[c]) not in values)
    if not unnamed:
        return values
    joints = mechanism.joints
    named = {
        column: joints[index].read(values[index])
        for column, index in enumerate(mechanism.independent.tolist())
        if index in values
    }
    s = spring_equilibrium(mechanism, named, unnamed)
    if s is None:
        free = [(joints[index], float(mechanism.home[index])) for index in mechanism.independent[list(unnamed)].tolist()]
        held = [(joint, x) for joint, x in free if joint.chart is None]
        remedy = f"; {lock_words(held)} holds them" if held else ""
        raise ProblemError(
            f"{where} has no value for {', '.join(joint.name for joint, _ in free)}, and no equilibrium of springs and"
            f" weight was found near home{remedy}"
        )
    if stops := rests_on_stops(mechanism, named, unnamed):
        resting = [(mechanism.independent_joints[column], x) for column, x in stops.items()]
        raise ProblemError(
            stop_sentence(resting, f"{where} names no value for {', '.join(joint.name for joint, _ in resting)}:")
        )
    return values | {int(mechanism.independent[c]): joints[int(mechanism.independent[c])].shown(s[c]) for c in unnamed}


def _waypoints(
    given: list[WaypointSection], mechanism: Mechanism, limits: Limits, begin: np.ndarray
) -> tuple[Waypoint, ...]:
    """Return the waypoints; sites and bodies are converted to the nearest poses, the first to the pose `begin` (n_q,)."""
    waypoints = []
    for k, item in enumerate(given):
        where, key = f"motion.waypoints[{k}]", f"motion.waypoints[{k}].{{}}"
        position, speed = (_state(item, name, mechanism, np.nan, where) for name in ("at", "speed_s"))
        tasks, rows, guess = tasks_of(item.at, item.body_deg, key, mechanism), (), None
        if tasks:
            if position is not None:
                joints = "at_deg" if item.at_deg else "at_m"
                raise ProblemError(f"{key_of(tasks, key)} and {where}.{joints} both give the pose; keep one")
            guess, rows = pose_at(tasks, key, mechanism, limits.position, limits.tasks, begin)
            begin, position = _closed(mechanism, guess), None if rows else guess
        waypoints.append(
            Waypoint(
                position=np.full(mechanism.dof, np.nan) if position is None else position,
                speed=DERIVED if speed is None else speed,
                time_s=None if item.time_s == "free" else item.time_s,
                at=tasks,
                at_rows=rows,
                guess=guess if rows else None,
            )
        )
    return tuple(waypoints)


def _check_poses(section: MotionSection, mechanism: Mechanism, motion: Motion) -> None:
    """Refuse a start, goal or waypoint with dependent joints that are not where the closed loop has them."""
    states: list[tuple] = [(section, "motion", "start", motion.start), (section, "motion", "goal", motion.goal)]
    for k, (item, waypoint) in enumerate(zip(section.waypoints, motion.waypoints, strict=True)):
        states.append((item, f"motion.waypoints[{k}]", "at", waypoint.position))
    for table, where, key, s in states:
        named = joint_values(table, key, where, mechanism)
        extra = [index for index in named if index not in mechanism.independent]
        if s is None or not extra:
            continue
        if np.any(np.isnan(s)):
            names = ", ".join(joint.name for joint in mechanism.independent_joints)
            raise ProblemError(
                f"{where}.{key} of joint {mechanism.joints[extra[0]].name}: it follows from {names}; a waypoint that leaves"
                " one of them free must not name dependent joints"
            )
        try:
            pose = close_at(mechanism, s)
        except AssemblyError as error:
            raise ProblemError(f"{where}.{key}_deg does not close: {error}") from error
        for index in extra:
            joint = mechanism.joints[index]
            asked = joint.read(named[index])
            if abs(asked - pose[index]) > _POSE_TOLERANCE:
                pairs = zip(mechanism.independent_joints, s, strict=True)
                raise ProblemError(
                    f"{where}.{key}_{joint.unit} does not close: with"
                    f" {', '.join(f'{j.name} = {j.text(x, 6)}' for j, x in pairs)} the loop has {joint.name} at"
                    f" {joint.text(pose[index], 6)} {joint.unit}, asked {joint.text(asked, 6)}"
                )
