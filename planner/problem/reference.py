"""Reference motions that a plan follows exactly or approximately."""

from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.keys.motion_section import ReferenceSection
from linkplan.planner.problem.joint_values import joint_values
from linkplan.planner.problem.values import frozen


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

    def derivative(self, time_s: np.ndarray, order: int = 0) -> np.ndarray:
        """Return the reference's derivative of an order at times (n,), as (n, n_s) [rad/s^order or m/s^order]."""
        omega = 2 * np.pi * self.frequency_hz
        angle = omega * np.asarray(time_s, dtype=float)[:, None] + self.phase + order * np.pi / 2
        return (self.bias if order == 0 else 0.0) + self.amplitude * omega**order * np.sin(angle)


def is_whole(number: float) -> bool:
    """Check if a ratio is a whole number, except for the rounding of decimal input."""
    return round(number) >= 1 and abs(number - round(number)) < 1e-9 * max(1.0, number)


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
                raise ProblemError(f"reference.{key}_{joint.unit} names no value for joint {joint.name}")
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
