"""Motions: prescribed states at both ends and at waypoints, and bounds on the duration."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.keys.reading import checked
from linkplan.planner.problem.sites import SitePoint
from linkplan.planner.problem.values import frozen


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Waypoint:
    """A state between start and goal: `position` and `speed` (n_s,) [rad or m, and per second], NaN where free.

    `time_s` is its time, None if that is free. `at` are prescribed places of sites, and `position` is then a pose with the
    sites at these places. If the places leave degrees of freedom open, `position` is free, `guess` (n_s,) is such a pose,
    and `at_rows` are independent rows among the sites' coordinates (3 n_sites).
    """

    position: np.ndarray
    speed: np.ndarray | None = None
    time_s: float | None = None
    at: tuple[SitePoint, ...] = ()
    at_rows: tuple[int, ...] = ()
    guess: np.ndarray | None = None

    def __post_init__(self) -> None:
        if bool(self.at_rows) != (self.guess is not None) or (self.at_rows and not self.at):
            raise ProblemError("a waypoint whose pose is open has places of sites, at_rows of them and a pose to guess")
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
    def open_coordinates(self) -> tuple[tuple[int, int, float], ...]:
        """The prescribed coordinates of an open pose: site index, axis and coordinate [m]."""
        return tuple((self.at[row // 3].index, row % 3, float(self.at[row // 3].point[row % 3])) for row in self.at_rows)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Motion:
    """Boundary conditions over the independent joints, (n_s,) each, [rad or m] and per second.

    Kind "reach" goes from start to goal, "periodic" returns to its first state, and "track" is the reference itself.
    `turns` (n_s,) are whole turns of hinges over a period of a periodic motion, s(T) = s(0) + 2 pi turns; None without
    turns. `duration_s` None is a free duration between `min_duration_s` and `max_duration_s`. `waypoints` are passed in
    order.

    `start_at` and `goal_at` are prescribed places of sites; `start` and `goal` are then poses with the sites at these
    places. If the places leave degrees of freedom open, any pose with the sites at their places ends the motion, `goal` is
    the initial guess, and `goal_rows` are independent rows among the sites' coordinates (3 n_sites). `goal_named` are the
    columns of s that the goal names: a passive degree of freedom that is not named may end anywhere.
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
    start_at: tuple[SitePoint, ...] = ()
    goal_at: tuple[SitePoint, ...] = ()
    goal_rows: tuple[int, ...] = ()
    turns: np.ndarray | None = None
    goal_named: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        checked("motion.kind", self.kind)
        for name in ("start", "goal", "start_speed", "goal_speed", "turns"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen(value))
        for name in ("waypoints", "start_at", "goal_at"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        self._check_sites()
        self._check_turns()
        if self.duration_s is not None and not (np.isfinite(self.duration_s) and self.duration_s > 0):
            raise ProblemError(f'motion.duration_s is a positive number or "free", got {self.duration_s!r}')
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
    def goal_is_free(self) -> bool:
        """Whether the final pose is free except for the sites' places."""
        return bool(self.goal_rows)

    @property
    def advance(self) -> np.ndarray | float:
        """The difference (n_s,) [rad or m] between the positions at the end and the start of a periodic motion."""
        return 0.0 if self.turns is None else 2 * np.pi * self.turns

    @property
    def stays(self) -> bool:
        """Whether a reach without waypoints ends in its initial state."""
        if self.kind != "reach" or self.start is None or self.goal is None or self.waypoints:
            return False
        speeds = [np.zeros_like(self.start) if v is None else v for v in (self.start_speed, self.goal_speed)]
        return np.array_equal(self.start, self.goal) and np.array_equal(*speeds)

    def resting_at(self, places: Iterable[np.ndarray]) -> "Motion":
        """Return the motion whose waypoints are the given places (n_s,) [rad or m], each passed at rest."""
        return replace(self, waypoints=tuple(Waypoint(position=place, speed=np.zeros(np.shape(place))) for place in places))

    def _check_turns(self) -> None:
        if self.turns is None:
            return
        if self.kind != "periodic":
            raise ProblemError(f"motion.turns belongs to motion.kind 'periodic', got '{self.kind}'")
        if not np.any(self.turns) or not np.all(self.turns == np.round(self.turns)):
            raise ProblemError(f"motion.turns are whole turns, at least one of them not 0, got {self.turns}")

    def _check_sites(self) -> None:
        for name in ("start", "goal"):
            if getattr(self, f"{name}_at") and getattr(self, name) is None:
                raise ProblemError(f"motion.{name}_at needs motion.{name}, a pose in which the sites are there")
            if getattr(self, f"{name}_at") and self.kind == "track":
                raise ProblemError(f"motion.{name}_at belongs to motion.kind 'reach' or 'periodic', got 'track'")
        if self.goal_is_free and (self.kind != "reach" or not self.goal_at):
            raise ProblemError(
                f"motion.goal_at of a {self.kind} motion names as many coordinates as the mechanism has freedoms; only the"
                " end of a 'reach' may be left open"
            )

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
