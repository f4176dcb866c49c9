"""Servos' ctrl ranges, as limits on the ctrl of a planned effort, except where the servo's force is clamped."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.actuation.actuators import Actuator, ranged_control
from linkplan.planner.limits.path_limit import (
    RELAXED_FACTOR,
    Bounds,
    Instant,
    Margin,
    PathLimit,
    Problem,
    Samples,
    Scales,
    Trajectory,
    margin_of,
)
from linkplan.planner.limits.samples import samples_of

# An effort within this share of the clamp of a servo's force counts as clamped, so ctrl has no effect: a motion may enter
# the clamp between two nodes. Efforts between nodes may be wrong by 200 times as much (DYNAMICS_SHARE). Measured: 4e-5.
_CLAMPED_SHARE = 1e-4


@dataclass(frozen=True, slots=True)
class ControlLimit(PathLimit):
    """The ctrl of one servo."""

    key: ClassVar[str] = "control"
    words: ClassVar[str] = "the ctrl of {}"
    jumps_with_effort: ClassVar[bool] = True
    item: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(j) for j, actuator in enumerate(problem.mechanism.actuators) if actuator.limits_control]

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        actuator, u = at.mechanism.actuators[self.item], at.u[self.item]
        ctrl = _ctrl(actuator, u, at.of_pose("actuator_length")[self.item], at.actuator_speeds[self.item])
        return ranged_control(actuator, ctrl, u, actuator.gain, ca.fmax) / _unit(actuator)

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        actuator = problem.mechanism.actuators[self.item]
        return actuator.control_lower / _unit(actuator), actuator.control_upper / _unit(actuator)

    def margin(self, samples: Samples) -> Margin:
        j, actuator = self.item, samples.problem.mechanism.actuators[self.item]
        u, bounds = samples.u[:, j], (actuator.control_lower, actuator.control_upper)
        ctrl = _ctrl(actuator, u, samples.of_pose("actuator_length")[:, j], samples.actuator_speeds[:, j])
        ranged, bent = _ranged(actuator, ctrl, u, len(samples.points))
        return margin_of(self, actuator.name, ranged, bounds, "", samples, bent=bent)

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        wider = tuple(
            replace(a, control_lower=a.control_lower * factor, control_upper=a.control_upper * factor)
            if a.limits_control
            else a
            for a in problem.mechanism.actuators
        )
        return replace(problem, mechanism=replace(problem.mechanism, actuators=wider))

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return cls.scaled(problem, RELAXED_FACTOR)


def _ctrl(actuator: Actuator, u: Any, length: Any, speed: Any) -> Any:
    """Return the ctrl with which a servo gives the effort u."""
    b = actuator.biases
    return (u - b[0] - b[1] * length - b[2] * speed) / actuator.gain


def clamped_allowance(problem: Problem, motion: Trajectory, j: int) -> float:
    """Return the overrun of ctrl that counts as clamped along a motion; 0 if actuator j's force is nowhere clamped."""
    actuator = problem.mechanism.actuators[j]
    clamp = np.abs([end for end in (actuator.lower, actuator.upper) if np.isfinite(end)]).max(initial=0.0)
    if not (clamp and actuator.limits_control):
        return 0.0
    samples = samples_of(problem, motion)
    ctrl = _ctrl(actuator, samples.u[:, j], samples.of_pose("actuator_length")[:, j], samples.actuator_speeds[:, j])
    _, bent = _ranged(actuator, ctrl, samples.u[:, j], len(samples.points))
    return float(_CLAMPED_SHARE * clamp / abs(actuator.gain)) if bent.any() else 0.0


def _unit(actuator: Actuator) -> float:
    """Return the unit of a servo's ctrl in the program: the larger end of its range."""
    ends = np.abs([actuator.control_lower, actuator.control_upper])
    return float(ends[np.isfinite(ends)].max(initial=0.0)) or 1.0


def _ranged(actuator: Actuator, ctrl: np.ndarray, u: np.ndarray, n_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the quantity limited by a servo's ctrlrange (n,), and a mask (n,) of samples with a clamped force."""
    ranged = ranged_control(actuator, ctrl, u, actuator.gain, np.maximum)
    bent = ranged != ctrl
    beside = np.repeat(bent.reshape(-1, n_points).any(axis=1), n_points)
    within = np.clip(ranged, actuator.control_lower, actuator.control_upper)
    clamp = np.abs([end for end in (actuator.lower, actuator.upper) if np.isfinite(end)]).max(initial=0.0)
    near = np.abs(ranged - within) * abs(actuator.gain) <= _CLAMPED_SHARE * clamp
    return np.where(beside & near, within, ranged), bent
