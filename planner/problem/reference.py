"""Given motions: references that a plan follows, and a user's initial guess.

A guess is a table of positions at equidistant times, or a saved plan's motion.
"""

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.columns import read_trajectory
from linkplan.planner.files.tables import resolve_path
from linkplan.planner.problem.keys.motion import ReferenceSection
from linkplan.planner.problem.keys.sections import GuessSection
from linkplan.planner.problem.path import Feed
from linkplan.planner.problem.settings import frozen, joint_values
from linkplan.planner.problem.table_reference import Spline, spline_of
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Sine:
    """s_ref(t) = bias + amplitude sin(2 pi f t + phase), per independent joint.

    `amplitude` and `bias` (n_s,) [rad or m], `phase` (n_s,) [rad]. All joints share `frequency_hz`, so the motion has one
    period.
    """

    amplitude: np.ndarray
    bias: np.ndarray
    phase: np.ndarray
    frequency_hz: float

    def __post_init__(self) -> None:
        for name in ("amplitude", "bias", "phase"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def period_s(self) -> float:
        """The period [s]."""
        return 1.0 / self.frequency_hz

    @property
    def periodic(self) -> bool:
        """Whether it repeats."""
        return True

    def derivative(self, time_s: np.ndarray, order: int = 0) -> np.ndarray:
        """Return the reference's derivative of an order at times (n,), as (n, n_s) [rad/s^order or m/s^order]."""
        omega = 2 * np.pi * self.frequency_hz
        angle = omega * np.asarray(time_s, dtype=float)[:, None] + self.phase + order * np.pi / 2
        return (self.bias if order == 0 else 0.0) + self.amplitude * omega**order * np.sin(angle)

    def inner_times(self, _: float) -> np.ndarray:
        """Return the times at which a derivative jumps: none."""
        return np.empty(0)

    def stretched(self, factor: float) -> "Sine":
        """Return the reference that takes `factor` times as long."""
        return replace(self, frequency_hz=self.frequency_hz / factor)


Reference = Sine | Spline | Feed


def is_whole(number: float) -> bool:
    """Check if a ratio is a whole number, except for the rounding of decimal input."""
    return round(number) >= 1 and abs(number - round(number)) < 1e-9 * max(1.0, number)


def repeats_in(reference: Reference, duration_s: float) -> bool:
    """Return True if a duration is a whole number of periods of a reference that repeats."""
    return reference.periodic and is_whole(duration_s / reference.period_s)


def reference_of(section: ReferenceSection, mechanism: Mechanism, ranges: np.ndarray) -> tuple[Reference, list[str]]:
    """Return the reference of a [reference] table, and a note if the table does not name its spline.

    Raises:
        ProblemError: for a table that is neither a sinusoid nor rows, or both.
    """
    wave_keys = ("frequency_hz", "amplitude_deg", "amplitude_m", "bias_deg", "bias_m", "phase_deg")
    waves = [key for key in wave_keys if getattr(section, key)]
    if section.time_s is None:
        rows = [
            key for key in ("position_deg", "position_m", "at", "body_deg", "period_s", "spline") if getattr(section, key)
        ]
        if rows:
            raise ProblemError(f"reference.{rows[0]} belongs to a table of rows: add reference.file or reference.time_s")
        if section.frequency_hz is None:
            raise ProblemError(
                "[reference] needs reference.frequency_hz, a positive number, for a sinusoid, or rows: reference.file or"
                " reference.time_s; got none of them"
            )
        return sine_of(section, mechanism), []
    if waves:
        raise ProblemError(f"reference.time_s and reference.{waves[0]} are two references; keep one")
    spline, kind = spline_of(section, mechanism, ranges)
    words = f"reference: a {kind} cubic spline through {len(section.time_s)} rows (reference.spline)"
    return spline, [] if section.spline else [words]


def sine_of(section: ReferenceSection, mechanism: Mechanism) -> Sine:
    """Return the reference of a [reference] table."""

    def values(key: str, default: float | None) -> np.ndarray:
        found = joint_values(section, key, "reference", mechanism)
        for index in found:
            if index not in mechanism.independent:
                names = ", ".join(j.name for j in mechanism.independent_joints)
                raise ProblemError(
                    f"reference.{key} is for independent joints ({names}), got {mechanism.joints[index].name}"
                )
        result = []
        for index, joint in zip(mechanism.independent.tolist(), mechanism.independent_joints, strict=True):
            value = found.get(index, default)
            if value is None:
                raise ProblemError(f"reference.{key}_{joint.unit} has no value for joint {joint.name}")
            result.append(joint.read(value))
        return np.array(result)

    for joint in section.phase_deg:
        mechanism.joint_index(joint, ProblemError)
    return Sine(
        amplitude=values("amplitude", None),
        bias=values("bias", 0.0),
        phase=np.radians([section.phase_deg.get(joint.name, 0.0) for joint in mechanism.independent_joints]),
        frequency_hz=section.frequency_hz,
    )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class GuessedPath:
    """A user's initial guess: independent positions (n, n_s) [rad or m] at equidistant times; duration [s] or None."""

    path: np.ndarray
    duration_s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", frozen(self.path))


def guess_of(
    section: GuessSection, mechanism: Mechanism, folder: Path | None
) -> tuple[GuessedPath | Trajectory | None, Path | None]:
    """Return the guess of a [guess] table, and the folder of the saved plan whose motion it is, if the table names one."""
    if section.plan is None:
        return _guessed_path(section, mechanism), None
    if section.path_deg or section.path_m:
        raise ProblemError("guess.plan and guess.path_deg are two guesses; keep one")
    place = resolve_path(section.plan, folder)
    if not os.path.isdir(place):
        where = "the working folder" if folder is None else f"'{folder}', the problem file's, or the working folder"
        raise ProblemError(f"guess.plan '{section.plan}' is not a folder in {where}; it must be the folder of a saved plan")
    return read_trajectory(place / "trajectory.npz"), place.resolve()


def _guessed_path(section: GuessSection, mechanism: Mechanism) -> GuessedPath | None:
    """Return the positions in a [guess] table; None without any."""
    paths = joint_values(section, "path", "guess", mechanism)
    if not paths:
        return None
    columns = []
    for index, joint in zip(mechanism.independent.tolist(), mechanism.independent_joints, strict=True):
        if index not in paths:
            raise ProblemError(f"guess.path_{joint.unit} has no list of positions for joint {joint.name}")
        columns.append([joint.read(value) for value in paths[index]])
    if len({len(column) for column in columns}) > 1:
        raise ProblemError("guess.path_deg must have the same number of positions for every independent joint")
    return GuessedPath(path=np.array(columns).T, duration_s=section.duration_s)
