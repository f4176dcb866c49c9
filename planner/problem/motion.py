"""Motions: prescribed states at both ends and at waypoints, and bounds on the duration; the pose at the start.

Ends beyond reach and impossible turns are refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.deadline import Deadline
from linkplan.models.errors import AssemblyError, ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import RANGE_ROUNDING, beyond_balls, needed_controls, whole_turns
from linkplan.models.poses.assembly import close_at, continue_to, follow, step_sizes
from linkplan.models.poses.reach import Reach, reach
from linkplan.planner.problem.limits import Limits
from linkplan.planner.problem.reference import Reference
from linkplan.planner.problem.settings import DERIVED, frozen
from linkplan.planner.problem.sites import Coordinate, Task, coordinates_of


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

    `start_acceleration` and `goal_acceleration` are NaN or None where free.

    `turns` (n_s,) are whole turns of hinges over a period of a periodic motion, s(T) = s(0) + 2 pi turns; None without
    turns. `duration_s` None is a free duration between `min_duration_s` and `max_duration_s`. `waypoints` are passed in
    order.

    `start_at` and `goal_at` are prescribed places of sites and angles of bodies; `start` and `goal` are then poses that
    satisfy these. If degrees of freedom stay open, any such pose ends the motion, `goal` is the initial guess, and
    `goal_rows` are independent rows among `coordinates_of(goal_at)`. `goal_named` are the columns of s that the goal names:
    a passive degree of freedom that is not named may end anywhere.
    """

    kind: str
    start: np.ndarray | None = None
    goal: np.ndarray | None = None
    start_speed: np.ndarray | None = None
    goal_speed: np.ndarray | None = None
    start_acceleration: np.ndarray | None = None
    goal_acceleration: np.ndarray | None = None
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
        ends = [f"{name}_{what}" for what in ("speed", "acceleration") for name in ("start", "goal")]
        for name in ("start", "goal", *ends, "turns"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen(value))
        for name in ("waypoints", "start_at", "goal_at"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        self._check_turns()
        low, high = self.min_duration_s, self.max_duration_s
        if low is not None and high is not None and not low < high:
            raise ProblemError(f"motion.min_duration_s must be below motion.max_duration_s, got {low:g} and {high:g}")
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

    def end_accelerations(self, n_s: int) -> np.ndarray:
        """Return the accelerations (2, n_s) asked for at start and goal, NaN where they are free."""
        return np.stack(
            [np.full(n_s, np.nan) if a is None else a for a in (self.start_acceleration, self.goal_acceleration)]
        )

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
            raise ProblemError(f"motion.turns must be whole turns, at least one of them not 0, got {self.turns}")

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
                raise ProblemError(f"motion.waypoints[{k}].time_s must be after {last:g} s, got {time!r}")
            last = time
        longest = self.duration_s or self.max_duration_s
        if longest is not None and last >= longest:
            raise ProblemError(f"motion.waypoints end at {last:g} s, beyond the motion's {longest:g} s")


def start_pose(
    mechanism: Mechanism, motion: Motion, limits: Limits, reference: Reference | None, deadline: Deadline
) -> np.ndarray:
    """Return the closed pose (n_q,) at the start of a motion.

    Raises:
        ProblemError: when start, goal, waypoints or reference lie outside what the mechanism reaches, with the interval; and
            for turns that a joint cannot make, after which a joint has not returned, or that a spring or servo prevents.
    """
    ranges = limits.position
    for name in ("start", "goal"):
        value = getattr(motion, name)
        if value is not None:
            _check_reach(mechanism, ranges, f"motion.{name}_deg", value)
    for k, waypoint in enumerate(motion.waypoints):
        if not np.all(np.isnan(waypoint.position)):
            _check_reach(mechanism, ranges, f"motion.waypoints[{k}].at_deg", waypoint.position)
    if motion.start is not None or reference is None:
        pose = np.array(mechanism.home) if motion.start is None else close_at(mechanism, motion.start)
        if motion.turns is not None:
            _check_turns(mechanism, motion, pose, deadline)
        return pose
    first = reference.derivative(np.zeros(1))[0]
    period = np.sort(np.append(np.linspace(0.0, reference.period_s, 181), reference.inner_times(reference.period_s)))
    values = reference.derivative(period)
    for extreme in (np.argmin, np.argmax):
        for column in range(mechanism.dof):
            _check_reach(mechanism, None, "reference", values[int(extreme(values[:, column]))])
    return close_at(mechanism, first)


def check_asked_pose(mechanism: Mechanism, asked: Mapping[str, float]) -> None:
    """Refuse a pose, positions [rad or m] of independent joints by name, beyond a joint's range or the mechanism's reach."""
    s = np.array([asked.get(joint.name, np.nan) for joint in mechanism.independent_joints])
    _check_reach(mechanism, np.array([(joint.lower, joint.upper) for joint in mechanism.joints]), "the pose", s)


def _check_reach(mechanism: Mechanism, ranges: np.ndarray | None, what: str, s: np.ndarray) -> None:
    """Refuse positions (n_s,) outside the ranges (n_q, 2) of joints or outside the reach of a single degree of freedom."""
    can = reach(mechanism) if mechanism.dof == 1 and not np.isnan(s[0]) and not is_open(mechanism, s) else None
    for column, joint in enumerate(mechanism.independent_joints):
        if np.isnan(s[column]):  # free in a waypoint
            continue
        index = int(mechanism.independent[column])
        interval, reason = (-np.inf, np.inf) if ranges is None else tuple(ranges[index]), f"range of {joint.name}"
        inside = interval[0] - RANGE_ROUNDING <= s[column] <= interval[1] + RANGE_ROUNDING
        if inside:
            if can is None or can.turns_fully:
                continue
            lower, upper = can.lower, can.upper  # an end without a stop is only the last position tried
            interval = (lower.position if lower.stops else -np.inf, upper.position if upper.stops else np.inf)
            inside = interval[0] - RANGE_ROUNDING <= s[column] <= interval[1] + RANGE_ROUNDING
            reason = can.lower.reason if s[column] < interval[0] else can.upper.reason
        if not inside:
            raise ProblemError(
                f"{what} {joint.name} = {joint.text(s[column], 6)} {joint.unit} is beyond reach:"
                f" {joint.name} reaches from {joint.text(interval[0], 6)} to {joint.text(interval[1], 6)} {joint.unit}"
                f" ({reason}"
                f"{_way_through(can, reason, s[column])})"
            )


def is_open(mechanism: Mechanism, s: np.ndarray) -> bool:
    """Return True if the straight path from home to s (n_s,) certainly has no singular pose and no end of a range.

    The steps are those of `reach`, but the check is much faster.
    """
    first = mechanism.home[mechanism.independent]
    n = int(np.ceil(2 * np.max(np.abs(s - first) / step_sizes(mechanism)[mechanism.independent], initial=0.0)))
    if not n < 361:  # about a full turn
        return False
    poses, arrived = continue_to(mechanism, mechanism.home, np.linspace(first, s, n + 1))
    ranges = np.array([(joint.lower, joint.upper) for joint in mechanism.joints])
    kept = (poses >= ranges[:, 0] - RANGE_ROUNDING) & (poses <= ranges[:, 1] + RANGE_ROUNDING)
    return bool(arrived == n + 1 and np.all(kept) and np.all(beyond_balls(mechanism, poses) <= RANGE_ROUNDING))


def _way_through(can: Reach | None, reason: str, asked: float) -> str:
    """Return the remedy at the end of a reach at a dead centre of its coordinate; an empty text at a branching pose."""
    if can is None or reason != "singular pose":
        return ""
    end = can.lower.position if asked < can.lower.position else can.upper.position
    if end in can.single:
        return "; the loops lose rank there, and no choice of coordinate passes it"
    if end in dict(can.branching):
        return "; the mechanism may change its branch there"
    return "; with another joint as mechanism.independent the motion may pass it"


def _check_turns(mechanism: Mechanism, motion: Motion, start_pose: np.ndarray, deadline: Deadline) -> None:
    """Refuse turns that a joint cannot make, after which a joint has not returned, or that a spring or servo prevents."""
    assert motion.turns is not None
    can = reach(mechanism) if mechanism.dof == 1 else None
    turning = [j for j, n in zip(mechanism.independent_joints, motion.turns, strict=True) if n]
    names = " and ".join(joint.name for joint in turning)
    if can is not None and not can.turns_fully:
        (joint,) = turning
        low, high = joint.text(can.lower.position, 6), joint.text(can.upper.position, 6)
        raise ProblemError(
            f"motion.turns of joint {names}: it cannot turn continuously; it reaches from {low} deg ({can.lower.reason}) to"
            f" {high} deg ({can.upper.reason})"
        )
    first = start_pose[mechanism.independent]
    # Number of poses checked in each turn.
    n = int(181 * np.abs(motion.turns).max())
    try:
        path = first + np.linspace(0.0, 1.0, n)[:, None] * motion.advance
        poses = follow(mechanism, path, start_pose, deadline)
    except AssemblyError as error:
        if mechanism.dof > 1:  # another path may be feasible
            return
        raise ProblemError(f"motion.turns of joint {names}: it cannot turn continuously: {error}") from error
    travelled = poses[-1] - poses[0]
    gone = whole_turns(mechanism, travelled)
    worst = int(np.argmax(np.abs(travelled - gone)))
    # A joint has returned after whole turns if its distance is at most this [rad or m], a multiple of the assembly
    # tolerance.
    if abs(travelled[worst] - gone[worst]) > 1e-5:
        joint = mechanism.joints[worst]
        raise ProblemError(
            f"motion.turns of joint {names}: joint {joint.name} does not return but moves by"
            f" {joint.text(travelled[worst], 6)} {joint.unit}; choose a number of turns after which all joints return"
        )
    _check_efforts(mechanism, names, poses[0], gone)


def _check_efforts(mechanism: Mechanism, names: str, pose: np.ndarray, gone: np.ndarray) -> None:
    """Refuse turns that wind up a spring, or for which a servo's ctrl would have to leave its range."""
    still = np.zeros(mechanism.n_q)
    before, after = (np.array(mechanism.dynamics.passive(q, still)).ravel() for q in (pose, pose + gone))
    if np.abs(after - before).max() > ROUNDING_SHARE * np.abs(before).max(initial=1.0):
        joint = mechanism.joints[int(np.argmax(np.abs(after - before)))]
        raise ProblemError(f"motion.turns of joint {names}: a spring on joint {joint.name} winds up with every turn")
    rest, nothing = np.zeros((1, mechanism.dof)), np.zeros((1, mechanism.n_u))
    ctrl, later = (needed_controls(mechanism, q[None], rest, nothing)[0] for q in (pose, pose + gone))
    for actuator, x, y in zip(mechanism.actuators, ctrl, later, strict=True):
        if actuator.limits_control and abs(y - x) > ROUNDING_SHARE * max(1.0, abs(x)):
            raise ProblemError(
                f"motion.turns of joint {names}: they change the ctrl of servo {actuator.name} by {y - x:.4g}, but its"
                f" ctrlrange is {actuator.control_lower:g} to {actuator.control_upper:g}"
            )
