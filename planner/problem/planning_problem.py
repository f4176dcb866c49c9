"""The continuous planning problem: mechanism, motion, objective and limits."""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from linkplan.models.audit import audit
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.keys.kinds import MAX_INTERVALS
from linkplan.planner.keys.reading import checked
from linkplan.planner.problem.corner_efforts import corner_out_of_reach
from linkplan.planner.problem.extra import Extra, ExtraLimit, checked_extras, uses
from linkplan.planner.problem.limits import Limits, Motor
from linkplan.planner.problem.motion import Motion, Waypoint
from linkplan.planner.problem.objective import Objective, objective_from
from linkplan.planner.problem.reference import Sine
from linkplan.planner.problem.robust import Robust
from linkplan.planner.problem.settings import MeshSettings, SolverSettings, Tracking
from linkplan.planner.problem.values import frozen
from linkplan.planner.trajectory import Trajectory

__all__ = ["GuessedPath", "Limits", "Motion", "Motor", "PlanningProblem", "Waypoint"]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class GuessedPath:
    """A user's initial guess: independent positions (n, n_s) [rad or m] at equidistant times; duration [s] or None."""

    path: np.ndarray
    duration_s: float | None = None

    def __post_init__(self) -> None:
        path = frozen(self.path)
        if path.ndim != 2 or len(path) < 2 or not np.all(np.isfinite(path)):
            raise ProblemError(f"a guess's path is two or more finite positions, got shape {path.shape}")
        object.__setattr__(self, "path", path)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PlanningProblem:
    """A mechanism, a motion, an objective and limits, with settings of the planner and of tracking.

    `source` is the problem as a file's tables with every value that was set, as `plan.json` keeps it.
    """

    name: str
    mechanism: Mechanism
    motion: Motion
    objective: Objective  # or a term's name, or a mapping of weights
    limits: Limits
    extra_limits: Sequence[ExtraLimit] = ()
    robust: Robust = field(default_factory=Robust)
    motors: tuple[Motor | None, ...] = ()
    reference: Sine | None = None
    guess: GuessedPath | Trajectory | None = None
    unhonoured: str = "refuse"  # a model with forces that plans neglect, or "note" these forces
    contacts: str = "refuse"  # a plan along which geoms collide, or "note" the contacts and neglect their forces
    mesh: MeshSettings = field(default_factory=MeshSettings)
    solver: SolverSettings = field(default_factory=SolverSettings)
    tracking: Tracking = field(default_factory=Tracking)
    source: dict = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # sentences on choices that the problem leaves open

    @property
    def adrift(self) -> np.ndarray:
        """A mask (n_s,) of coordinates with a free final value: passive degrees of freedom that the goal does not name."""
        passive = np.isin(self.mechanism.independent, self.mechanism.passive_dofs)
        passive[list(self.motion.goal_named)] = False
        return passive

    @property
    def free_spins(self) -> np.ndarray:
        """A mask (n_s,) of free coordinates that need not return in a periodic motion: spins that affect nothing else."""
        return self.adrift & self.mechanism.cyclic

    def __post_init__(self) -> None:
        object.__setattr__(self, "objective", objective_from(self.objective))
        object.__setattr__(self, "motors", tuple(self.motors) or (None,) * self.mechanism.n_u)
        object.__setattr__(self, "tracking", self.tracking.tracked())
        checked("limits.contacts", self.contacts)
        checked("limits.unhonoured", self.unhonoured)
        falsifying = _falsifying(self.mechanism)
        if falsifying and self.unhonoured == "refuse":
            raise ProblemError(
                f"mechanism '{self.mechanism.name}' cannot be planned, its model has forces that the planner does not"
                " honour:"
                f' {"; ".join(falsifying)} (limits.unhonoured = "note" plans without them)'
            )
        if self.mechanism.n_u == 0:
            raise ProblemError(f"mechanism '{self.mechanism.name}' has no usable actuator; a plan needs one")
        self._check_extras()
        self._check_objective()
        self._check_motion()
        self._check_shapes()
        self._check_periods()
        self._check_robust()
        self._check_node_at_end()

    def _check_motion(self) -> None:
        """Refuse a motion whose kind does not fit its ends, its reference or its objective."""
        motion, objective = self.motion, self.objective
        if motion.kind == "periodic":
            self._check_periodic()
        if motion.kind == "reach" and (motion.start is None or motion.goal is None):
            raise ProblemError(
                "motion.kind 'reach' needs motion.start_deg and motion.goal_deg, or motion.start_at and motion.goal_at"
            )
        if motion.kind == "track" and self.reference is None:
            raise ProblemError("motion.kind 'track' needs a [reference]")
        if motion.kind == "track" and list(objective.weights) != ["tracking"]:
            raise ProblemError(f"motion.kind 'track' prescribes the motion: minimize is 'tracking', got '{objective.name}'")
        if motion.turns is not None and self.reference is not None:
            raise ProblemError(
                "motion.turns and [reference] exclude each other, because a reference returns to its start: keep one of them"
            )

    def _check_periodic(self) -> None:
        """Refuse a periodic motion without a cause to move, or with unsuitable ends."""
        motion, objective = self.motion, self.objective
        if motion.waypoints and motion.goal is not None:
            raise ProblemError(
                "motion.kind 'periodic' with motion.waypoints ends where it starts: it takes no motion.goal_deg"
            )
        turns = motion.turns is not None
        one_end = (motion.start is None) != (motion.goal is None) and not (turns and motion.goal is None)
        if not motion.waypoints and one_end:
            raise ProblemError("motion.kind 'periodic' takes motion.start_deg and motion.goal_deg together, or neither")
        moves = motion.goal is not None or bool(motion.waypoints) or turns
        if self.reference is None and not moves:
            raise ProblemError(
                "motion.kind 'periodic' needs a [reference], or motion.start_deg and motion.goal_deg, or motion.waypoints"
                " or motion.turns"
            )
        if not objective.has("tracking") and not moves:
            raise ProblemError(
                f"motion.kind 'periodic' with minimize '{objective.name}' needs motion.start_deg and motion.goal_deg to move"
                " between, or motion.waypoints: without them the optimum is to stand still"
            )

    def _check_node_at_end(self) -> None:
        """Refuse a scheme without a node at an interval's end if the pose there is free."""
        motion = self.motion
        needs_node = ["motion.goal_at that leaves a loop's pose open"]
        needs_node = needs_node if motion.goal_is_free and len(self.mechanism.dependent) else []
        opened = [f"motion.waypoints[{k}].at" for k, waypoint in enumerate(motion.waypoints) if waypoint.at_rows]
        needs_node += [f"{where} that leaves a pose open" for where in opened]
        if needs_node and self.mesh.scheme.startswith("gauss"):
            raise ProblemError(
                f"{needs_node[0]} needs a mesh.scheme with a node at the end (radau, trapezoid, hermite-simpson), got"
                f" {self.mesh.scheme}"
            )

    def _check_robust(self) -> None:
        """Refuse ranges that do not apply to this mechanism."""
        robust, mechanism = self.robust, self.mechanism
        driven = int(np.linalg.matrix_rank(np.array(mechanism.dynamics.effort_map(mechanism.home)))) if robust.corners else 0
        if robust.payload_factor != (1.0, 1.0) and mechanism.payload is None:
            raise ProblemError("robust.payload_factor needs a mechanism.payload; there is none")
        if robust.corners and driven < mechanism.dof:
            self._check_robust_of_driven(driven)

    def _check_robust_of_driven(self, driven: int) -> None:
        """Refuse ranges that actuators cannot compensate, for actuators that move only some degrees of freedom."""
        robust, mechanism = self.robust, self.mechanism
        moved = f"the actuators of '{mechanism.name}' move {driven} of {mechanism.dof} degrees of freedom"
        if driven < mechanism.n_u:
            raise ProblemError(f"[robust] takes actuators that move every degree of freedom, or each its own; {moved}")
        lost = corner_out_of_reach(mechanism, robust.corners)
        if lost is not None:
            corner = lost.description(tuple(joint.name for joint in mechanism.joints))
            raise ProblemError(
                f"[robust] keeps one motion for every machine in its ranges; {moved}, and the others move differently at the"
                f" corner: {corner}; legal are ranges that actuators"
                " compensate: the torque constant, friction at driven joints"
            )

    def _check_periods(self) -> None:
        """Refuse a motion over more periods of its reference than the finest mesh can resolve."""
        if self.reference is None or self.motion.duration_s is None:
            return
        periods = self.motion.duration_s * self.reference.frequency_hz
        if periods * self.mesh.intervals > MAX_INTERVALS:
            raise ProblemError(
                f"motion.duration_s = {self.motion.duration_s:g} s is {periods:.6g} periods of the reference; with"
                f" mesh.intervals = {self.mesh.intervals} each, at most {MAX_INTERVALS / self.mesh.intervals:.6g} are legal"
            )

    def _check_objective(self) -> None:
        """Refuse an objective that does not fit the motion or the actuators."""
        motion, objective = self.motion, self.objective
        if list(objective.weights) == ["time"] and not np.all(np.isfinite(self.limits.effort)):
            unlimited = [
                actuator.name
                for actuator, ends in zip(self.mechanism.actuators, self.limits.effort, strict=False)
                if not np.all(np.isfinite(ends))
            ]
            raise ProblemError(
                "objective.minimize 'time' needs finite limits.effort: without them there is no least time; they are missing"
                f" (a motor's ctrlrange, a servo's forcerange) for {', '.join(unlimited)}"
            )
        if list(objective.weights) == ["time"] and motion.stays:
            raise ProblemError("motion.start_deg is motion.goal_deg: a motion of least time between them takes no time")
        for name, term in objective.terms.items():
            for need in term.needs:
                lacking = NEEDS[need](self)
                if lacking is not None:
                    raise ProblemError(f"objective.minimize '{name}' needs {lacking}")
        if np.any(np.isfinite(self.limits.effort_rate)) and self.mesh.effort == "constant":
            raise ProblemError(f"limits.effort_rate needs {NEEDS['changing efforts'](self)}")

    def _check_extras(self) -> None:
        """Refuse extra limits and costs that do not fit this mechanism."""
        object.__setattr__(self, "extra_limits", checked_extras(self.extra_limits, ExtraLimit, "extra_limits"))
        for extra in self.extras:
            uses(extra, self.mechanism)

    @property
    def extras(self) -> tuple[Extra, ...]:
        """The users' own limits and costs."""
        return (*self.extra_limits, *self.objective.extra)

    def _check_shapes(self) -> None:
        motion, mechanism = self.motion, self.mechanism
        n_s = mechanism.dof
        for name in ("start", "goal", "start_speed", "goal_speed", "turns"):
            value = getattr(motion, name)
            if value is not None and (value.shape != (n_s,) or not np.all(np.isfinite(value))):
                raise ProblemError(f"motion.{name} has one finite value for each of {n_s} independent joints, got {value}")
        self._check_turns()
        for k, waypoint in enumerate(motion.waypoints):
            if waypoint.position.shape != (n_s,) or waypoint.speed.shape != (n_s,):
                raise ProblemError(f"motion.waypoints[{k}] has one value for each of {n_s} independent joints")
        if len(self.limits.closure_force) == 0:
            limits = replace(self.limits, closure_force=np.full(len(mechanism.closure_names), np.inf))
            object.__setattr__(self, "limits", limits)
        rows = {"effort": mechanism.n_u, "position": mechanism.n_q, "speed": mechanism.n_q}
        rows |= {"effort_rate": mechanism.n_u, "power": mechanism.n_u, "closure_force": len(mechanism.closure_names)}
        for name, n_rows in rows.items():
            if len(getattr(self.limits, name)) != n_rows:
                raise ProblemError(f"limits.{name} needs {n_rows} rows, got {len(getattr(self.limits, name))}")
        guessed = self.guess.path.shape[1] if isinstance(self.guess, GuessedPath) else getattr(self.guess, "n_s", n_s)
        if guessed != n_s:
            raise ProblemError(f"the guess moves {guessed} joints, '{mechanism.name}' has {n_s} independent ones")
        if len(self.motors) != mechanism.n_u:
            raise ProblemError(f"motors needs one entry for each of {mechanism.n_u} actuators, got {len(self.motors)}")

    def _check_turns(self) -> None:
        """Refuse turns of a joint whose range is limited."""
        motion, mechanism = self.motion, self.mechanism
        turns = np.zeros(mechanism.dof) if motion.turns is None else motion.turns
        for joint, index, n in zip(mechanism.independent_joints, mechanism.independent, turns, strict=True):
            if n and np.any(np.isfinite(self.limits.position[index])):
                low, high = (joint.said(x, 6) for x in self.limits.position[index])
                raise ProblemError(
                    f"motion.turns of joint {joint.name}: a joint that turns endlessly has no range; its range is {low} to"
                    f" {high} deg"
                )

    @property
    def sites(self) -> dict[str, int]:
        """The indices in the model of all sites that the problem names, by name: start, waypoints, goal, limits."""
        motion = self.motion
        points = [*motion.start_at, *(point for waypoint in motion.waypoints for point in waypoint.at), *motion.goal_at]
        return {one.site: one.index for one in (*points, *self.limits.site)}

    @property
    def not_honoured(self) -> tuple[str, ...]:
        """Phrases on what plans neglect of the model; they say so if it makes plans wrong."""
        found = audit(self.mechanism.model)
        return tuple(
            f"left out of the plan, which makes it false: {one.text}" if one.falsifies else one.text for one in found
        )


def _free_duration(problem: PlanningProblem) -> str | None:
    given = problem.motion.duration_s
    return None if given is None else f'motion.duration_s = "free", got {given:g}'


def _motors(problem: PlanningProblem) -> str | None:
    lacking = [
        actuator.name
        for actuator, motor in zip(problem.mechanism.actuators, problem.motors, strict=False)
        if motor is None or motor.torque_constant is None
    ]
    if not lacking:
        return None
    return f"motors.NAME.torque_constant and resistance_ohm of every actuator; missing for {', '.join(lacking)}"


# Requirements of objective terms: functions that return a phrase on what a problem lacks, or None.
NEEDS: Mapping[str, Callable[[PlanningProblem], str | None]] = {
    "reference": lambda problem: "a [reference]" if problem.reference is None else None,
    "free duration": _free_duration,
    "fixed duration": lambda problem: "a fixed motion.duration_s, got 'free'" if problem.motion.duration_s is None else None,
    "motors": _motors,
    "closures": lambda problem: (
        None if problem.mechanism.closure_names else f"a closure; '{problem.mechanism.name}' has none"
    ),
    "changing efforts": lambda problem: (
        "mesh.effort linear or polynomial, got constant" if problem.mesh.effort == "constant" else None
    ),
}


@functools.lru_cache(maxsize=16)
def _falsifying(mechanism: Mechanism) -> tuple[str, ...]:
    """Return phrases on the model's forces that make plans wrong, memoised because a model is planned many times."""
    return tuple(item.text for item in audit(mechanism.model) if item.falsifies)
