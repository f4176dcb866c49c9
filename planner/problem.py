"""The continuous problem: which motion of which mechanism, best in which sense, within which limits."""

from dataclasses import dataclass, field

import numpy as np

from models.audit import audit
from models.errors import ProblemError
from models.mechanism import Mechanism
from planner.reference import Sine

KINDS = ("reach", "periodic", "track")
OBJECTIVES = ("effort", "time", "tracking")


def _frozen(value: object) -> np.ndarray:
    array = np.array(value, dtype=float)
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Motion:
    """Boundary conditions over the independent joints, (n_s,) each, [rad or m] and per second.

    kind "reach" goes from start to goal; "periodic" returns to its own first state; "track" is the reference itself.
    `duration_s` is None where it is free.
    """

    kind: str
    start: np.ndarray | None = None
    goal: np.ndarray | None = None
    start_speed: np.ndarray | None = None
    goal_speed: np.ndarray | None = None
    duration_s: float | None = None
    max_duration_s: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ProblemError(f"motion.kind is one of {', '.join(KINDS)}, got '{self.kind}'")
        for name in ("start", "goal", "start_speed", "goal_speed"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, _frozen(value))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Limits:
    """Limits on every instant: `effort` (n_u, 2) [N.m or N], `position` and `speed` (n_q, 2) [rad or m, and per second].

    Infinite where there is none. Dependent joints have their rows too.
    """

    effort: np.ndarray
    position: np.ndarray
    speed: np.ndarray

    def __post_init__(self) -> None:
        for name in ("effort", "position", "speed"):
            value = _frozen(getattr(self, name))
            if value.ndim != 2 or value.shape[1] != 2 or np.any(np.isnan(value)):
                raise ProblemError(f"limits.{name} has one [low, high] a row, got shape {value.shape}")
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MeshSettings:
    """The transcription's name, the number of intervals to begin with, and what efforts are over an interval."""

    scheme: str = "radau-3"
    intervals: int = 40
    effort: str = "polynomial"  # "constant", "linear" or "polynomial"
    tolerance_deg: float | None = None  # on the integrated state; None: refined towards 1e-6 while the mesh stays small


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SolverSettings:
    """How a program is solved: whether its functions are compiled, and how long the solver may take [s].

    `compile` is "auto" (compiled functions where the cache has them or the mesh is large), "always" or "never".
    """

    compile: str = "auto"
    max_time_s: float = 600.0


COMPILE = ("auto", "always", "never")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Tracking:
    """How a plan is tracked: PD gains per actuated joint, sampling, delay, and LQR weights.

    kp [N.m/rad or N/m] and kd [N.m.s/rad or N.s/m] act on the independent joints through their actuators. LQR weighs a
    position error of `lqr_position` [rad or m], a velocity error of `lqr_velocity` and an effort of the whole limit alike.
    """

    kp: float = 200.0
    kd: float = 1.0
    period_s: float = 1e-4
    delay_periods: int = 0
    duration_s: float | None = None  # of the tracking run; default: the plan and a rest after it, or eight periods
    lqr_position: float = np.radians(1.0)
    lqr_velocity: float = np.radians(100.0)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PlanningProblem:
    """A mechanism, a motion, an objective and limits: all that a planner needs, and how the plan will be tracked.

    `source` is the problem as a file's tables, with every value that was set: what `plan.json` keeps.
    """

    name: str
    mechanism: Mechanism
    motion: Motion
    objective: str
    limits: Limits
    reference: Sine | None = None
    mesh: MeshSettings = field(default_factory=MeshSettings)
    solver: SolverSettings = field(default_factory=SolverSettings)
    tracking: Tracking = field(default_factory=Tracking)
    source: dict = field(default_factory=dict)

    def __post_init__(self) -> None:
        motion, n_s = self.motion, self.mechanism.dof
        falsifying = [item.text for item in audit(self.mechanism.model) if item.falsifies]
        if falsifying:
            raise ProblemError(
                f"mechanism '{self.mechanism.name}' cannot be planned truly, its model has what the planner does not honour:"
                f" {'; '.join(falsifying)}"
            )
        if self.objective not in OBJECTIVES:
            raise ProblemError(f"objective.minimize is one of {', '.join(OBJECTIVES)}, got '{self.objective}'")
        if self.mechanism.n_u == 0:
            raise ProblemError(
                f"mechanism '{self.mechanism.name}' has no usable actuator (a motor on a hinge or slide); a plan needs one"
            )
        if motion.kind == "reach" and (motion.start is None or motion.goal is None):
            raise ProblemError("motion.kind 'reach' needs motion.start_deg and motion.goal_deg")
        if self.objective == "time" and not np.all(np.isfinite(self.limits.effort)):
            raise ProblemError("objective.minimize 'time' needs finite limits.effort: without them no time is the least")
        if self.objective == "tracking" and self.reference is None:
            raise ProblemError("objective.minimize 'tracking' needs a [reference]")
        if motion.kind == "track" and self.reference is None:
            raise ProblemError("motion.kind 'track' needs a [reference]")
        if motion.kind == "track" and self.objective != "tracking":
            raise ProblemError(f"motion.kind 'track' prescribes the motion: minimize is 'tracking', got '{self.objective}'")
        if motion.kind == "periodic" and self.reference is None and (motion.start is None or motion.goal is None):
            raise ProblemError("motion.kind 'periodic' needs a [reference], or motion.start_deg and motion.goal_deg")
        if motion.kind == "periodic" and self.objective != "tracking" and (motion.start is None or motion.goal is None):
            raise ProblemError(
                f"motion.kind 'periodic' with minimize '{self.objective}' needs motion.start_deg and motion.goal_deg to move"
                " between: without them, standing still is best"
            )
        same = motion.start is not None and motion.goal is not None and np.array_equal(motion.start, motion.goal)
        if self.objective == "time" and motion.kind == "reach" and same:
            raise ProblemError("motion.start_deg is motion.goal_deg: a motion of least time between them takes no time")
        if self.objective == "time" and motion.duration_s is not None:
            raise ProblemError(f"objective.minimize 'time' needs motion.duration_s = \"free\", got {motion.duration_s:g}")
        if self.objective == "tracking" and motion.duration_s is None:
            raise ProblemError("objective.minimize 'tracking' needs a fixed motion.duration_s, got 'free'")
        if motion.duration_s is not None and not (np.isfinite(motion.duration_s) and motion.duration_s > 0):
            raise ProblemError(f'motion.duration_s is a positive number or "free", got {motion.duration_s!r}')
        for name in ("start", "goal", "start_speed", "goal_speed"):
            value = getattr(motion, name)
            if value is not None and (value.shape != (n_s,) or not np.all(np.isfinite(value))):
                raise ProblemError(f"motion.{name} has one finite value for each of {n_s} independent joints, got {value}")
        rows = {"effort": self.mechanism.n_u, "position": self.mechanism.n_q, "speed": self.mechanism.n_q}
        for name, n_rows in rows.items():
            if len(getattr(self.limits, name)) != n_rows:
                raise ProblemError(f"limits.{name} needs {n_rows} rows, got {len(getattr(self.limits, name))}")

    @property
    def not_honoured(self) -> tuple[str, ...]:
        """What the model says that plans leave out without becoming false, each in a few words."""
        return tuple(item.text for item in audit(self.mechanism.model))
