"""Motions: prescribed states at both ends and at waypoints, and bounds on the duration."""

import json
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import AssemblyError, ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.equilibrium import lock_words, rests_on_stops, spring_equilibrium, sprung_freedoms, stop_sentence
from linkplan.planner.problem.keys.motion_and_limits import MotionSection, WaypointSection
from linkplan.planner.problem.limits import Limits
from linkplan.planner.problem.path import SitePath
from linkplan.planner.problem.reference import Reference, is_whole
from linkplan.planner.problem.settings import DERIVED, frozen, joint_values
from linkplan.planner.problem.sites import Coordinate, Task, coordinates_of, key_of, pose_at, tasks_of


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Waypoint:
    """A state between start and goal: `position` and `speed` (n_s,) [rad or m, and per second], NaN where free.

    `time_s` is its time, None if that is free. `at` are prescribed places of sites and angles of bodies, and `position` is
    then a pose with the sites and bodies there. If they leave degrees of freedom open, `position` is free, `guess` (n_s,) is
    such a pose, and `at_rows` are independent rows among their coordinates (`coordinates_of`).
    """

    position: np.ndarray
    speed: np.ndarray = DERIVED
    time_s: float | None = None
    at: tuple[Task, ...] = ()
    at_rows: tuple[int, ...] = ()
    guess: np.ndarray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", frozen(self.position))
        object.__setattr__(self, "at", tuple(self.at))
        if self.guess is not None:
            object.__setattr__(self, "guess", frozen(self.guess))
        speed = np.full(self.position.shape, np.nan) if self.speed is None else self.speed
        object.__setattr__(self, "speed", frozen(speed))

    @property
    def guessed(self) -> np.ndarray:
        """The positions (n_s,) of the initial guess, NaN where unknown."""
        return self.position if self.guess is None else self.guess

    @property
    def open_coordinates(self) -> tuple[Coordinate, ...]:
        """The prescribed coordinates of an open pose."""
        every = coordinates_of(self.at)
        return tuple(every[row] for row in self.at_rows)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Motion:
    """Boundary conditions over the independent joints, (n_s,) each, [rad or m] and per second.

    Kind "reach" goes from start to goal, "hold" stays at its start, which is its goal, "periodic" returns to its first
    state, "track" is the reference itself, and "follow" takes a site along its path, from rest to rest.

    `turns` (n_s,) are whole turns of hinges over a period of a periodic motion, s(T) = s(0) + 2 pi turns; None without
    turns. `duration_s` None is a free duration between `min_duration_s` and `max_duration_s`. `waypoints` are passed in
    order.

    `start_at` and `goal_at` are prescribed places of sites and angles of bodies; `start` and `goal` are then such poses. If
    degrees of freedom stay open, any such pose ends the motion, `goal` is the initial guess, and `goal_rows` are independent
    rows among `coordinates_of(goal_at)`. `goal_named` are the columns of s that the goal names: a passive degree of freedom
    that is not named may end anywhere.
    """

    kind: str
    start: np.ndarray | None = None
    goal: np.ndarray | None = None
    start_speed: np.ndarray | None = None
    goal_speed: np.ndarray | None = None
    duration_s: float | None = None
    min_duration_s: float | None = None
    max_duration_s: float | None = None
    waypoints: tuple[Waypoint, ...] = ()
    start_at: tuple[Task, ...] = ()
    goal_at: tuple[Task, ...] = ()
    goal_rows: tuple[int, ...] = ()
    turns: np.ndarray | None = None
    goal_named: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.kind == "hold" and self.start is not None:
            object.__setattr__(self, "goal", self.start)
            object.__setattr__(self, "goal_named", tuple(range(len(self.start))))
        for name in ("start", "goal", "start_speed", "goal_speed", "turns"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen(value))
        for name in ("waypoints", "start_at", "goal_at"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        self._check_turns()
        low, high = self.min_duration_s, self.max_duration_s
        if low is not None and high is not None and not low < high:
            raise ProblemError(f"motion.min_duration_s is below motion.max_duration_s, got {low:g} and {high:g}")
        if self.duration_s is not None and (low is not None or high is not None):
            raise ProblemError(
                'motion.min_duration_s and motion.max_duration_s bound a free duration (motion.duration_s = "free"),'
                f" got motion.duration_s = {self.duration_s:g}"
            )
        self._check_waypoints()

    @property
    def ends_at_goal(self) -> bool:
        """Whether the motion ends at its goal and not, as a periodic one, at its start."""
        return self.kind in ("reach", "hold", "follow")

    @property
    def goal_is_free(self) -> bool:
        """Whether the final pose is free except for the sites' places and the bodies' angles."""
        return bool(self.goal_rows)

    @property
    def advance(self) -> np.ndarray | float:
        """The difference (n_s,) [rad or m] between the positions at the end and the start of a periodic motion."""
        return 0.0 if self.turns is None else 2 * np.pi * self.turns

    @property
    def stays(self) -> bool:
        """Whether a hold, or a reach without waypoints, ends in its initial state."""
        if not self.ends_at_goal or self.start is None or self.goal is None or self.waypoints:
            return False
        begin, end = (np.zeros_like(self.start) if v is None else v for v in (self.start_speed, self.goal_speed))
        return np.array_equal(self.start, self.goal) and np.array_equal(begin, end)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """The tasks of start, waypoints and goal."""
        return (*self.start_at, *(task for waypoint in self.waypoints for task in waypoint.at), *self.goal_at)

    def _check_turns(self) -> None:
        if self.turns is None:
            return
        if self.kind != "periodic":
            raise ProblemError(f"motion.turns belongs to motion.kind 'periodic', got '{self.kind}'")
        if not np.any(self.turns) or not np.all(self.turns == np.round(self.turns)):
            raise ProblemError(f"motion.turns are whole turns, at least one of them not 0, got {self.turns}")

    def _check_waypoints(self) -> None:
        if self.waypoints and self.kind == "track":
            raise ProblemError(
                "motion.waypoints belong to motion.kind 'reach' or 'periodic'; 'track' prescribes every instant"
            )
        last = 0.0
        for k, waypoint in enumerate(self.waypoints):
            time = waypoint.time_s
            if np.all(np.isnan(waypoint.guessed)) and np.all(np.isnan(waypoint.speed)):
                raise ProblemError(f"motion.waypoints[{k}] names no position and no speed; it needs one of them")
            if time is None:
                continue
            if not (np.isfinite(time) and time > last):
                raise ProblemError(f"motion.waypoints[{k}].time_s comes after {last:g} s, got {time!r}")
            last = time
        longest = self.duration_s or self.max_duration_s
        if longest is not None and last >= longest:
            raise ProblemError(f"motion.waypoints end at {last:g} s, beyond the motion's {longest:g} s")


def _along(section: MotionSection, mechanism: Mechanism, limits: Limits, path: SitePath | None) -> Motion:
    """Return the motion of a site along its path; the joints at the start choose the pose, the nearest to them."""
    if path is None:
        raise ProblemError("motion.kind 'follow' needs a [path]: the site, and points or a file")
    unused = [key for key in _NOT_ALONG_A_PATH if getattr(section, key)]
    if unused:
        raise ProblemError(
            f"motion.{unused[0]} does not belong to motion.kind 'follow', which goes from rest at the first point of its"
            " [path] to rest at the last"
        )
    near = _state(section, "start", mechanism, None)
    s = path.end_poses(
        mechanism, limits.position, limits.tasks, mechanism.home if near is None else _closed(mechanism, near)
    )
    return Motion(
        kind="follow",
        start=s[0],
        goal=s[1],
        duration_s=None if section.duration_s == "free" else section.duration_s,
        min_duration_s=section.min_duration_s,
        max_duration_s=section.max_duration_s,
        goal_named=tuple(range(mechanism.dof)),
    )


# Keys of [motion] that say what a path says.
_NOT_ALONG_A_PATH = (
    *("start_at", "start_body_deg", "goal_deg", "goal_m", "goal_at", "goal_body_deg"),
    *("start_speed_deg_s", "start_speed_m_s", "goal_speed_deg_s", "goal_speed_m_s", "waypoints", "turns"),
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
    """Return the motion of a [motion] table; poses found from sites and bodies keep the limits if possible."""
    kind, duration = section.kind, section.duration_s
    if duration is None and reference is not None:
        duration = reference.period_s
    duration = None if duration == "free" else duration
    repeats = kind == "periodic" and reference is not None and duration is not None
    if repeats and not is_whole(duration / reference.period_s):
        raise ProblemError(
            f"motion.duration_s of a periodic motion is a whole number of the reference's periods of"
            f" {reference.period_s:g} s, got {duration:g}"
        )
    if kind == "follow":
        return _along(section, mechanism, limits, path)
    start, start_at, _ = _end(section, "start", kind, mechanism, limits, mechanism.home)
    begin = mechanism.home if start is None else _closed(mechanism, start)
    _check_hold(section)
    goal, goal_at, goal_rows = _end(section, "goal", kind, mechanism, limits, begin)
    speeds = [_state(section, f"{name}_speed_s", mechanism, 0.0) for name in ("start", "goal")]
    goal_named = np.isin(mechanism.independent, list(_goal_joints(section, mechanism)))
    if kind == "reach" and reference is not None and duration is not None:  # ends that are not given are the reference's
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
        duration_s=duration,
        min_duration_s=section.min_duration_s,
        max_duration_s=section.max_duration_s,
        waypoints=_waypoints(section.waypoints, mechanism, limits, begin),
        turns=_turns(section.turns, mechanism),
        goal_named=tuple(np.flatnonzero(goal_named).tolist()),
    )
    _check_poses(section, mechanism, motion)
    return motion


def _check_hold(section: MotionSection) -> None:
    """Refuse keys of a hold that ask it to move, and one without a duration."""
    if section.kind != "hold":
        return
    ends = [f"goal_{key}" for key in ("deg", "m", "at", "body_deg")]
    speeds = [f"{name}_speed_{unit}_s" for name in ("goal", "start") for unit in ("deg", "m")]
    asked = next((key for key in (*ends, *speeds, "waypoints") if getattr(section, key)), None)
    if asked is not None:
        raise ProblemError(f"motion.{asked} asks for a motion; motion.kind 'hold' stays at its start")
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
    for index, steered in zip(mechanism.independent, mechanism.actuated, strict=True):
        joint = mechanism.joints[index]
        if index not in values and default is None and steered:
            named = sorted(mechanism.joints[i].name for i in values)
            as_many = len(values) == mechanism.dof
            hint = f"; mechanism.independent = {json.dumps(named)} plans in what is named" if as_many else ""
            raise ProblemError(
                f"{where}.{key}_{joint.unit} names no value for joint {joint.name}, which is independent{hint}"
            )
        value = values.get(int(index), default)  # NaN (free) in a waypoint
        # A coordinate that is not named, because nothing moves or holds it, starts at home.
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
) -> tuple[np.ndarray | None, tuple[Task, ...], tuple[int, ...]]:
    """Return a start or goal (n_s,) given by joints or by sites and bodies, their tasks, and `Motion.goal_rows`."""
    named = [key for key in (f"{name}_deg", f"{name}_m") if getattr(section, key)]
    where = f"motion.{name}_{{}}"
    tasks = tasks_of(getattr(section, f"{name}_at"), getattr(section, f"{name}_body_deg"), where, mechanism)
    if not tasks:
        return _state(section, name, mechanism, None), (), ()
    key = key_of(tasks, where)
    if named:
        raise ProblemError(f"{key} and motion.{named[0]} both say where the {name} is; keep one")
    if kind == "track":
        raise ProblemError(f"{key} belongs to motion.kind 'reach' or 'periodic'; 'track' prescribes every instant")
    s, rows = pose_at(tasks, where, mechanism, limits.position, limits.tasks, begin)
    if rows and (name == "start" or kind != "reach"):
        open_pose = f"{key} leaves freedoms of '{mechanism.name}' open, which has {mechanism.dof}; only the end of a 'reach'"
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
        free = [(joints[index], float(mechanism.home[index])) for index in mechanism.independent[list(unnamed)].tolist()]
        held = [(joint, x) for joint, x in free if joint.chart is None]
        remedy = f"; {lock_words(held)} holds them" if held else ""
        raise ProblemError(
            f"{where} names no value for {', '.join(joint.name for joint, _ in free)}, and no equilibrium of springs and"
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
                raise ProblemError(f"{key_of(tasks, key)} and {where}.{joints} both say where it is; keep one")
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
