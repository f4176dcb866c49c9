"""Motions: prescribed states at both ends and at waypoints, and bounds on the duration."""

from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import ProblemError
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
