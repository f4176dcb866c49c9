"""Settings beside the problem proper: the mesh, the solver, and how the plan will be tracked.

Each is checked here when it is made, by the keys that problem files have: a file's values come as they are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.tree.joints import Joint
from linkplan.planner.problem.values import frozen, number, one_of, whole
from linkplan.planner.transcription.schemes import scheme

REFINE = ("both", "intervals", "degree")
SOLVERS = ("ipopt", "fatrop")
COMPILE = ("auto", "always", "never")
# Meshes beyond this take minutes; a typing slip of a zero should not.
MAX_INTERVALS = 20_000
# What a certificate allows the integrated state [deg]: a hundredth of a degree, a tenth of what a good encoder resolves.
INTEGRATION_DEG = 0.01
# The integration that judges is good to about a tenth of this.
_TIGHTEST_DEG = 1e-9
# Starts beyond this take minutes without finding more, and no solve takes so many iterations.
MAX_STARTS, _MAX_ITERATIONS = 1000, 1_000_000
# Delays beyond this are no delays.
_MAX_DELAY = 1000
# Errors that LQR weighs, in degrees or metres and per second: beyond these a Riccati equation has no numbers left.
LQR_ERRORS = (1e-9, 1e9)
# Degrees that were made radians and degrees again may be off by this, relative.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MeshSettings:
    """The transcription's name, the number of intervals to begin with, and what efforts are over an interval."""

    scheme: str = "radau-3"
    intervals: int = 40
    effort: str = "polynomial"  # "constant", "linear" or "polynomial"
    tolerance_deg: float | None = None  # on the integrated state; None: refined towards 1e-6 while the mesh stays small
    refine: str = "both"  # what is added where a mesh is too coarse: "intervals", "degree", or "both", each where it pays
    breaks: np.ndarray | None = None  # of the first mesh, from 0 to 1, in place of `intervals` equal ones

    def __post_init__(self) -> None:
        scheme(self.scheme, self.effort)  # refuses what it does not know
        _set(self, "intervals", whole(self.intervals, "mesh.intervals", 2, MAX_INTERVALS))
        if self.tolerance_deg is not None:
            tolerance = number(self.tolerance_deg, "mesh.tolerance_deg", positive=True)
            if not _TIGHTEST_DEG <= tolerance <= INTEGRATION_DEG:
                raise ProblemError(
                    f"mesh.tolerance_deg is from {_TIGHTEST_DEG:g} to the certificate's {INTEGRATION_DEG:g},"
                    f" got {tolerance:g}"
                )
            _set(self, "tolerance_deg", tolerance)
        one_of(self.refine, "mesh.refine", REFINE)
        if self.breaks is not None:
            _set(self, "breaks", _breaks(self.breaks))


def _breaks(value: object) -> np.ndarray:
    """Return a first mesh's breaks (n + 1,), read-only, refused where they are not from 0 to 1."""
    given = list(value) if isinstance(value, list | tuple | np.ndarray) else []
    breaks = frozen([number(at, "mesh.breaks") for at in given])
    if not 3 <= len(breaks) <= MAX_INTERVALS + 1 or breaks[0] != 0 or breaks[-1] != 1 or np.any(np.diff(breaks) <= 0):
        shown = value.tolist() if isinstance(value, np.ndarray) else value
        raise ProblemError(
            "mesh.breaks is three or more increasing numbers from 0 to 1, the ends of the intervals as shares of the"
            f" duration, got {shown!r}"
        )
    return breaks


# The share of a plan's time that is kept for its certificate: solves end before that.
CERTIFYING = 0.1


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SolverSettings:
    """How a program is solved: by which solver, compiled or not, in how many starts, and how long it may take [s].

    `compile` is "auto" (compiled functions where the cache has them or the mesh is large), "always" or "never". Of
    `starts` motions to start from, the best answer is kept.
    """

    name: str = "ipopt"
    compile: str = "auto"
    max_time_s: float = 600.0
    starts: int = 1
    max_iterations: int | None = None  # None: as many as a hard problem takes
    deadline: float | None = None  # on the monotonic clock [s]: when whoever plans wants to be done; None: no such instant

    def __post_init__(self) -> None:
        one_of(self.name, "solver.name", SOLVERS)
        one_of(self.compile, "solver.compile", COMPILE)
        _set(self, "max_time_s", number(self.max_time_s, "solver.max_time_s", positive=True))
        _set(self, "starts", whole(self.starts, "solver.starts", 1, MAX_STARTS))
        if self.max_iterations is not None:
            _set(self, "max_iterations", whole(self.max_iterations, "solver.max_iterations", 1, _MAX_ITERATIONS))

    @property
    def judged_until(self) -> float:
        """When certificates are to be done, on the monotonic clock [s]; infinite where there is no such instant."""
        return np.inf if self.deadline is None else self.deadline + CERTIFYING * self.max_time_s


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Tracking:
    """How a plan is tracked: PD gains per actuated joint, sampling, delay, and LQR weights.

    kp [N.m/rad or N/m] and kd [N.m.s/rad or N.s/m] act on the independent joints through their actuators: one number for
    all, or one for each joint by name. LQR weighs a position error of `lqr_position` [rad], a velocity error of
    `lqr_velocity` and an effort of the whole limit alike; on a slide of `lqr_position_m` [m] and `lqr_velocity_m_s`. The
    delay is a whole number of control periods where a motion is tracked; a loop's frequency response may have any.
    """

    kp: float | Mapping[str, float] = 200.0
    kd: float | Mapping[str, float] = 1.0
    period_s: float = 1e-4
    delay_periods: float = 0
    duration_s: float | None = None  # of the tracking run; default: the plan and a rest after it, or eight periods
    lqr_position: float = np.radians(1.0)
    lqr_velocity: float = np.radians(100.0)
    lqr_position_m: float = 0.01
    lqr_velocity_m_s: float = 1.0

    def __post_init__(self) -> None:
        for key in ("kp", "kd"):
            given = getattr(self, key)
            if isinstance(given, Mapping):
                each = {str(name): number(value, f"tracking.{key}.{name}", least=0.0) for name, value in given.items()}
                _set(self, key, each)
            else:
                _set(self, key, number(given, f"tracking.{key}", least=0.0))
        _set(self, "period_s", number(self.period_s, "tracking.period_s", positive=True))
        if number(self.delay_periods, "tracking.delay_periods", least=0.0) > _MAX_DELAY:
            raise ProblemError(f"tracking.delay_periods is from 0 to {_MAX_DELAY}, got {self.delay_periods!r}")
        if self.duration_s is not None:
            _set(self, "duration_s", number(self.duration_s, "tracking.duration_s", positive=True))
        for key, in_file in (("lqr_position", "lqr_position_deg"), ("lqr_velocity", "lqr_velocity_deg_s")):
            value = getattr(self, key)
            _lqr_error(np.degrees(value) if _is_number(value) else value, in_file)
            _set(self, key, float(value))
        for key in ("lqr_position_m", "lqr_velocity_m_s"):
            _set(self, key, _lqr_error(getattr(self, key), key))

    def tracked(self) -> "Tracking":
        """Return these settings if a motion can be tracked with them: its delay is a whole number of control periods."""
        return replace(self, delay_periods=whole(self.delay_periods, "tracking.delay_periods", 0, _MAX_DELAY))

    @property
    def acts(self) -> bool:
        """Whether any gain of PD is above zero."""
        return any(np.any(np.array([*one.values()] if isinstance(one, Mapping) else [one])) for one in (self.kp, self.kd))

    def gains(self, joints: Sequence[Joint]) -> tuple[np.ndarray, np.ndarray]:
        """Return kp and kd (n,) of joints.

        Raises:
            ProblemError: for a joint without a gain, or a gain of a joint that is none of these.
        """
        names, found = [joint.name for joint in joints], []
        for key in ("kp", "kd"):
            given = getattr(self, key)
            if not isinstance(given, Mapping):
                found.append(np.full(len(names), given))
                continue
            if set(given) != set(names):
                raise ProblemError(
                    f"tracking.{key} has a gain for each independent joint ({', '.join(names)}), got"
                    f" {', '.join(given) or 'none'}"
                )
            found.append(np.array([given[name] for name in names]))
        return found[0], found[1]

    def gains_said(self, joints: Sequence[Joint] = ()) -> str:
        """Return kp and kd in words: one number, or one for each joint by name; with their units on joints of one kind."""
        kinds = {joint.kind for joint in joints}
        per = {"hinge": ("N.m/rad", "N.m.s/rad"), "slide": ("N/m", "N.s/m")}[kinds.pop()] if len(kinds) == 1 else ("", "")

        def said(given: float | Mapping[str, float], unit: str) -> str:
            if not isinstance(given, Mapping):
                return f"{given:g} {unit}".rstrip()
            return "{ " + ", ".join(f"{name} = {value:g}" for name, value in given.items()) + f" }} {unit}".rstrip()

        return f"kp = {said(self.kp, per[0])}, kd = {said(self.kd, per[1])}"

    def lqr_errors(self, joints: Sequence[Joint]) -> tuple[np.ndarray, np.ndarray]:
        """Return the position and velocity errors (n,) [rad or m, and per second] that weigh 1 on joints."""
        hinge = np.array([joint.kind == "hinge" for joint in joints], dtype=bool)
        position = np.where(hinge, self.lqr_position, self.lqr_position_m)
        return position, np.where(hinge, self.lqr_velocity, self.lqr_velocity_m_s)


def _lqr_error(value: object, key: str) -> float:
    """Return an error that LQR weighs [deg or m, and per second]."""
    found, (low, high) = number(value, f"tracking.{key}", positive=True), LQR_ERRORS
    if not low * (1 - _ROUNDING) <= found <= high * (1 + _ROUNDING):
        raise ProblemError(
            f"tracking.{key}, the error that weighs as much as the whole effort limit, is from {low:g} to {high:g},"
            f" got {found:g}"
        )
    return found


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _set(settings: object, field: str, value: object) -> None:
    """Put a checked value in its place."""
    object.__setattr__(settings, field, value)
