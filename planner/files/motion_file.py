"""The [motion] table of a problem file."""

import json

import numpy as np

from linkplan.models.errors import AssemblyError, ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.equilibrium import spring_equilibrium, sprung_freedoms
from linkplan.planner.closed_chain.prescribed import is_whole
from linkplan.planner.files.joint_values import joint_values
from linkplan.planner.files.sites_file import points_of, pose_at
from linkplan.planner.keys.motion_section import MotionSection, WaypointSection
from linkplan.planner.problem.limits import Limits
from linkplan.planner.problem.motion import Motion, Waypoint
from linkplan.planner.problem.reference import Sine
from linkplan.planner.problem.sites import SitePoint


def motion_of(section: MotionSection, mechanism: Mechanism, reference: Sine | None, limits: Limits) -> Motion:
    """Return the motion of a [motion] table; poses found from sites' places keep the limits if possible."""
    kind, duration = section.kind, section.duration_s
    if duration is None and reference is not None:
        duration = reference.period_s
    duration = None if duration == "free" else duration
    repeats = kind == "periodic" and reference is not None and duration is not None
    if repeats and not is_whole(duration * reference.frequency_hz):
        raise ProblemError(
            f"motion.duration_s of a periodic motion is a whole number of the reference's periods of"
            f" {reference.period_s:g} s, got {duration:g}"
        )
    start, start_at, _ = _end(section, "start", kind, mechanism, limits, mechanism.home)
    begin = mechanism.home if start is None else _closed(mechanism, start)
    goal, goal_at, goal_rows = _end(section, "goal", kind, mechanism, limits, begin)
    return Motion(
        kind=kind,
        start=start,
        goal=goal,
        start_at=start_at,
        goal_at=goal_at,
        goal_rows=goal_rows,
        start_speed=_state(section, "start_speed_s", mechanism, 0.0),
        goal_speed=_state(section, "goal_speed_s", mechanism, 0.0),
        duration_s=duration,
        min_duration_s=section.min_duration_s,
        max_duration_s=section.max_duration_s,
        waypoints=_waypoints(section.waypoints, mechanism, limits, begin),
        turns=_turns(section.turns, mechanism),
        goal_named=tuple(np.flatnonzero(np.isin(mechanism.independent, list(_goal_joints(section, mechanism)))).tolist()),
    )


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
    for index in mechanism.independent:
        joint = mechanism.joints[index]
        if index not in values and default is None and int(index) not in mechanism.passive_dofs:
            named = sorted(mechanism.joints[i].name for i in values)
            others = len(values) == mechanism.dof and not {int(i) for i in values} <= {int(i) for i in mechanism.independent}
            hint = f"; mechanism.independent = {json.dumps(named)} plans in what is named" if others else ""
            raise ProblemError(
                f"{where}.{key}_{joint.unit} names no value for joint {joint.name}, which is independent{hint}"
            )
        value = values.get(int(index), default)  # NaN (free) in a waypoint
        # A passive degree of freedom that is not named stays at home.
        result.append(mechanism.home[index] if value is None else joint.read(value))
    if key.endswith("_s"):
        _refuse_dependent(values, f"{where}.{key}", mechanism)
    return np.array(result)


def _refuse_dependent(values: dict[int, float], where: str, mechanism: Mechanism) -> None:
    """Refuse speeds of dependent joints."""
    for index in values:
        if index not in mechanism.independent:
            raise ProblemError(
                f"{where} of joint {mechanism.joints[index].name}: its speed follows from"
                f" {', '.join(j.name for j in mechanism.independent_joints)}; name those"
            )


def _end(
    section: MotionSection, name: str, kind: str, mechanism: Mechanism, limits: Limits, begin: np.ndarray
) -> tuple[np.ndarray | None, tuple[SitePoint, ...], tuple[int, ...]]:
    """Return a start or goal (n_s,) given by joints or by sites' places, these places, and `Motion.goal_rows`."""
    named = [key for key in (f"{name}_deg", f"{name}_m") if getattr(section, key)]
    points = points_of(getattr(section, f"{name}_at"), f"motion.{name}_at", mechanism)
    if not points:
        return _state(section, name, mechanism, None), (), ()
    if named:
        raise ProblemError(f"motion.{name}_at and motion.{named[0]} both say where the {name} is; keep one")
    if kind == "track":
        raise ProblemError(
            f"motion.{name}_at belongs to motion.kind 'reach' or 'periodic'; 'track' prescribes every instant"
        )
    s, rows = pose_at(points, f"motion.{name}_at", mechanism, limits, begin)
    if rows and (name == "start" or kind != "reach"):
        raise ProblemError(
            f"motion.{name}_at leaves freedoms of '{mechanism.name}' open, which has {mechanism.dof}; only the end of a"
            f" 'reach' may: name more coordinates, or the joints in motion.{name}_deg"
        )
    return s, points, rows


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
            raise ProblemError(f"motion.turns of joint {name}: it is a {what}; only hinges turn endlessly")
        if index not in places:
            names = ", ".join(j.name for j in mechanism.independent_joints)
            raise ProblemError(f"motion.turns of joint {name}: its turns follow from {names}; name those")
        turns[places[index]] = n
    return turns


def _closed(mechanism: Mechanism, s: np.ndarray) -> np.ndarray:
    """Return the closed pose (n_q,) at a start; home if there is none, because the start is checked elsewhere."""
    try:
        return close_at(mechanism, s)
    except AssemblyError:
        return mechanism.home


def _with_rests(values: dict[int, float], where: str, mechanism: Mechanism) -> dict[int, float]:
    """Return a state's values, with undriven freedoms that it does not name at their equilibrium on springs."""
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
        names = ", ".join(joints[int(mechanism.independent[c])].name for c in unnamed)
        raise ProblemError(
            f"{where} names no value for {names}, and no equilibrium of springs and weight was found near home"
        )
    return values | {int(mechanism.independent[c]): joints[int(mechanism.independent[c])].shown(s[c]) for c in unnamed}


def _waypoints(
    given: list[WaypointSection], mechanism: Mechanism, limits: Limits, begin: np.ndarray
) -> tuple[Waypoint, ...]:
    """Return the waypoints; sites' places are converted to the nearest poses, the first to the pose `begin` (n_q,)."""
    waypoints = []
    for k, item in enumerate(given):
        where = f"motion.waypoints[{k}]"
        nothing = np.full(mechanism.dof, np.nan)
        position, speed = (_state(item, key, mechanism, np.nan, where) for key in ("at", "speed_s"))
        points, rows, guess = points_of(item.at, f"{where}.at", mechanism), (), None
        if points:
            if position is not None:
                both = "at_deg" if item.at_deg else "at_m"
                raise ProblemError(f"{where}.at and {where}.{both} both say where it is; keep one")
            guess, rows = pose_at(points, f"{where}.at", mechanism, limits, begin)
            begin, position = _closed(mechanism, guess), None if rows else guess
        waypoints.append(
            Waypoint(
                position=nothing if position is None else position,
                speed=speed,
                time_s=None if item.time_s == "free" else item.time_s,
                at=points,
                at_rows=rows,
                guess=guess if rows else None,
            )
        )
    return tuple(waypoints)
