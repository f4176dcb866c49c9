"""Settings of the mesh, the solver and the tracking of a plan, and values of joints under keys.

The sections of problem files are decoded and checked in `planner.problem.keys`; these settings hold what they decode to.

Values of joints are in a table of joint = value under a key with the unit. If a motion names other joints than the driven
ones, these become independent.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from msgspec.structs import force_setattr

from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.equilibrium import sprung_freedoms
from linkplan.models.tree.joints import Joint
from linkplan.planner.problem.keys.kinds import (
    BREAKS,
    LQR_ERRORS,
    MAX_DELAY,
    MIN_INTERVAL_SHARE,
    AtLeastZero,
    Number,
    Positive,
)
from linkplan.planner.problem.keys.reading import read
from linkplan.planner.problem.keys.section import Section
from linkplan.planner.problem.keys.sections import (
    DEFAULT_INTERVALS,
    DEFAULT_PERIOD_S,
    DEFAULT_SCHEME,
    LQR_DEFAULTS,
    LQR_RESPONSE_PERIODS,
    MeshSection,
    SolverSection,
    TrackingSection,
)

# The default of a field that __post_init__ sets; readers of the field never find it.
DERIVED: Any = None
# Keys with tables of joint = value in [motion], its waypoints and [reference].
_ENDS = tuple(f"{name}{what}" for what in ("", "_speed", "_acceleration") for name in ("start", "goal"))
_STATES = (*_ENDS, "at", "speed", "amplitude", "bias", "position")
# The share of a plan's time that is reserved for its certificate; solves end before it.
CERTIFICATE_TIME_SHARE = 0.1


def frozen(value: object) -> np.ndarray:
    """Return a read-only array of floats."""
    array = np.array(value, dtype=float)
    array.flags.writeable = False
    return array


def number(value: object, key: str, *, positive: bool = False, at_least_zero: bool = False) -> float:
    """Return a finite number.

    Raises:
        ProblemError: naming the key, when it is anything else.
    """
    kind: Any = Positive if positive else AtLeastZero if at_least_zero else Number
    return read(kind, to_toml_types(value), key)


def interval(value: list[float], key: str) -> tuple[float, float]:
    """Return [low, high] with low < high; ends may be infinite."""
    low, high = (end if np.isinf(end) else number(end, key) for end in value)
    if not low < high:
        raise ProblemError(f"{key} must be [low, high] with low < high, got [{low:g}, {high:g}]")
    return low, high


def whole(value: object, key: str, low: int, high: int) -> int:
    """Return a whole number from `low` to `high`.

    Raises:
        ProblemError: naming the key, when it is anything else.
    """
    kind: Any = Annotated[int, Meta(ge=low, le=high)]
    return read(kind, to_toml_types(value), key)


def to_toml_types(value: Any) -> Any:
    """Return a copy of a value in the types of a TOML file; values without such a type are returned unchanged."""
    if isinstance(value, np.generic | np.ndarray):
        return to_toml_types(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): to_toml_types(item) for name, item in value.items()}
    if isinstance(value, list | tuple | range):
        return [to_toml_types(item) for item in value]
    if isinstance(value, Section):
        return value.to_dict()
    return str(value) if isinstance(value, PurePath) else value


def joint_values(section: Section, key: str, table_name: str, mechanism: Mechanism) -> dict[int, Any]:
    """Return {joint index: value} of `key`_deg and `key`_m (before any _s, _s2 or _s3), units checked against the joints.

    Raises:
        ProblemError: for an unknown joint, or a joint of the other kind.
    """
    found = {}
    stem, rate = next(((key[: -len(end)], end) for end in ("_s", "_s2", "_s3") if key.endswith(end)), (key, ""))
    for unit, kind, other in (("deg", "hinge", "m"), ("m", "slide", "deg")):
        name = f"{stem}_{unit}{rate}"
        for joint, value in getattr(section, name).items():
            index = mechanism.joint_index(joint, ProblemError)
            if mechanism.joints[index].kind != kind:
                raise ProblemError(
                    f"joint '{joint}' is a {mechanism.joints[index].kind}; use {table_name}.{stem}_{other}{rate}, not {name}"
                )
            found[index] = value
    return found


def other_coordinates(tables: Mapping[str, dict], mechanism: Mechanism) -> list[str] | None:
    """Return the joints that a motion names and that should be independent; None to keep the mechanism's coordinates.

    The coordinates are kept if the motion names all independent joints, or if mechanism.independent is given. They are also
    kept if the motion names more joints than there are degrees of freedom, because the dependent ones are then unknown.

    Args:
        tables: tables of a problem file.
        mechanism: with its default coordinates.
    """
    if "independent" in mechanism.source:
        return None
    named = [joint.name for joint in mechanism.joints if joint.name in set(_named(tables))]
    others = set(named) - {joint.name for joint in mechanism.independent_joints}
    if not others:
        return None
    unnamed = [*sprung_freedoms(mechanism), *np.flatnonzero(~mechanism.actuated)]
    resting = set(mechanism.independent[unnamed].tolist())
    missing = [mechanism.joints[i].name for i in mechanism.independent.tolist() if i not in resting]
    missing = [name for name in missing if name not in named]
    return named if missing and len(named) <= mechanism.dof else None


def coordinates_note(mechanism: Mechanism, named: list[str]) -> str:
    """Return the note that the joints named by a motion are the coordinates of its plan."""
    unnamed = [joint.name for joint in mechanism.independent_joints if joint.name not in named]
    return (
        f"the motion names {', '.join(named)} and not {', '.join(unnamed)}: it is planned in these joints"
        f" (mechanism.independent = {json.dumps(named)})"
    )


def _named(tables: Mapping[str, dict]) -> Iterator[str]:
    """Yield the joints that a motion, its waypoints and its reference name."""
    motion = tables.get("motion", {})
    for table in (motion, tables.get("reference", {}), *motion.get("waypoints", [])):
        for state in _STATES:
            for unit in ("deg", "m", "deg_s", "m_s", "deg_s2", "m_s2"):
                yield from table.get(f"{state}_{unit}", ())


class MeshSettings(MeshSection, frozen=True, eq=False):
    """The [mesh] of a problem; `breaks` is an array, which says how many intervals there are."""

    scheme: str = DEFAULT_SCHEME
    intervals: int = DEFAULT_INTERVALS
    effort: str = "polynomial"
    refine: str = "both"
    breaks: Any = None

    def __post_init__(self) -> None:
        if self.breaks is not None:
            breaks = frozen(self.breaks)
            if breaks[0] != 0 or breaks[-1] != 1 or np.any(np.diff(breaks) < MIN_INTERVAL_SHARE):
                raise ProblemError(f"mesh.breaks must be {BREAKS}, got {breaks.tolist()!r}")
            force_setattr(self, "breaks", breaks)
            force_setattr(self, "intervals", len(breaks) - 1)


class SolverSettings(SolverSection, frozen=True, eq=False):
    """The [solver] of a problem, with what its search sets: the number of iterations and the time."""

    max_iterations: int | None = None  # None: enough for a hard problem
    deadline: Deadline = NO_DEADLINE  # the deadline of all solves; certificates have a later one

    @property
    def certificate_deadline(self) -> Deadline:
        """The deadline of the integrations of certificates."""
        return self.deadline.later_by(CERTIFICATE_TIME_SHARE * self.max_time_s)

    @property
    def judging_deadline(self) -> Deadline:
        """The deadline of poses and contacts along motions, which is later so that a found motion is not lost."""
        return self.deadline.later_by(self.max_time_s)

    def begun(self) -> "SolverSettings":
        """Return these settings with a deadline: `max_time_s` from now, less the certificate's share."""
        return self.replace(deadline=self.deadline.within((1 - CERTIFICATE_TIME_SHARE) * self.max_time_s))


class Tracking(TrackingSection, frozen=True, eq=False):
    """The [tracking] of a problem; for None, `tracking_of` sets gains and `with_lqr_errors` errors."""

    period_s: float = DEFAULT_PERIOD_S

    def __post_init__(self) -> None:
        if self.delay_periods == int(self.delay_periods):
            force_setattr(self, "delay_periods", int(self.delay_periods))

    def tracked(self) -> "Tracking":
        """Return these settings if they can track a motion: the delay must be a whole number of control periods."""
        whole(self.delay_periods, "tracking.delay_periods", 0, MAX_DELAY)
        return self

    @property
    def acts(self) -> bool:
        """Whether any PD gain is above zero, or a default one."""
        gains = [[*one.values()] if isinstance(one, Mapping) else [one] for one in (self.kp, self.kd)]
        return any(gain is None or gain > 0 for of in gains for gain in of)

    def gains(self, joints: Sequence[Joint]) -> tuple[np.ndarray, np.ndarray]:
        """Return kp and kd (n,) of joints.

        Raises:
            ProblemError: for a joint without a gain, or a gain of an unknown joint.
        """
        return self._by_joint("kp", joints), self._by_joint("kd", joints)

    def _by_joint(self, key: str, joints: Sequence[Joint]) -> np.ndarray:
        """Return the values (n,) that a key gives to joints, one for all or one for each."""
        given, names = getattr(self, key), [joint.name for joint in joints]
        if given is None:
            raise ProblemError(f"tracking.{key} follows from a machine's inertia at a pose, which is not known here")
        if not isinstance(given, Mapping):
            return np.full(len(names), given, dtype=float)
        if set(given) != set(names):
            raise ProblemError(
                f"tracking.{key} must have a value for each independent joint ({', '.join(names) or 'none'}), got"
                f" {', '.join(given) or 'none'}"
            )
        return np.array([given[name] for name in names], dtype=float)

    def gains_text(self, joints: Sequence[Joint] = ()) -> str:
        """Return kp and kd as text: one number, or one for each joint by name; with units if all joints are of one kind."""
        units = {joint.gain_units for joint in joints}
        per = units.pop() if len(units) == 1 else ("", "")

        def gain_text(given: float | Mapping[str, float], unit: str) -> str:
            if not isinstance(given, Mapping):
                return f"{given:g} {unit}".rstrip()
            return "{ " + ", ".join(f"{name} = {value:g}" for name, value in given.items()) + f" }} {unit}".rstrip()

        return f"kp = {gain_text(self.kp, per[0])}, kd = {gain_text(self.kd, per[1])}"

    def with_lqr_errors(
        self, joints: Sequence[Joint], acceleration: Sequence[float] | np.ndarray, period_s: float
    ) -> "Tracking":
        """Return these settings with an LQR error for every joint.

        An error that is None becomes the default or, if that is larger, the error that full effort reaches from rest in
        `LQR_RESPONSE_PERIODS` control periods. Smaller errors would need a loop that is faster than the sampling, and a
        light machine would chatter.

        Args:
            joints: the independent joints (n,).
            acceleration: the largest one (n,) [rad/s^2 or m/s^2] of each under the whole effort limit.
            period_s: the control period [s], or the simulator's step if that is longer.
        """
        time, reached = LQR_RESPONSE_PERIODS * period_s, {}
        for unit, (position, velocity) in LQR_DEFAULTS.items():
            most = {joint.name: joint.shown(a) for joint, a in zip(joints, acceleration, strict=True) if joint.unit == unit}
            near = {name: min(max(position, 0.5 * a * time**2), LQR_ERRORS[1]) for name, a in most.items()}
            slow = {name: min(max(velocity, a * time), LQR_ERRORS[1]) for name, a in most.items()}
            reached |= {f"lqr_position_{unit}": near or position, f"lqr_velocity_{unit}_s": slow or velocity}
        return self.replace(**{key: _one_if_equal(value) for key, value in reached.items() if getattr(self, key) is None})

    def lqr_errors(self, joints: Sequence[Joint]) -> tuple[np.ndarray, np.ndarray]:
        """Return the position and velocity errors (n,) [rad or m, and per second] that have the weight 1.

        Raises:
            ProblemError: for a joint without an error, or an error of an unknown joint.
        """
        every, errors = self.with_lqr_errors(joints, np.zeros(len(joints)), 0.0), np.empty((2, len(joints)))
        for kind, unit, factor in (("hinge", "deg", np.radians(1.0)), ("slide", "m", 1.0)):
            at = [k for k, joint in enumerate(joints) if joint.kind == kind]
            for row, key in zip(errors, (f"lqr_position_{unit}", f"lqr_velocity_{unit}_s"), strict=True):
                row[at] = factor * every._by_joint(key, [joints[k] for k in at])
        return errors[0], errors[1]


def _one_if_equal(value: float | dict[str, float]) -> float | dict[str, float]:
    """Return the common value of a table if all its values are equal, else the table."""
    values = {*value.values()} if isinstance(value, dict) else {value}
    return values.pop() if len(values) == 1 else value
