"""Resonances and anti-resonances of a plant: from an effort to positions, about an operating point.

Resonances are the poles of the plant with its open loops, x' = A x + B u. Anti-resonances are the zeros of one output
(`transfer_function`): at such a frequency the effort moves the other coordinates, and the output does not move.
"""

import numpy as np
from msgspec import Struct

from linkplan.studies.feedback.frequency.feedback_loops import OperatingPoint, channel_effort, outputs_of
from linkplan.studies.feedback.frequency.transfer_function import TransferFunction, transfer_function

# A damping ratio below this is zero except for rounding.
_NO_DAMPING = 1e-9


class Mode(Struct, frozen=True, kw_only=True):
    """A pair of conjugate poles or zeros: the natural frequency, and the damping ratio, below zero if it grows."""

    frequency_hz: float
    damping_ratio: float


class PlantModes(Struct, frozen=True, kw_only=True):
    """The oscillating poles and zeros of the plant to one output, by frequency."""

    resonances: tuple[Mode, ...]
    anti_resonances: tuple[Mode, ...]


def plant_modes(point: OperatingPoint, channel: int) -> dict[str, PlantModes]:
    """Return the modes of the plant from a loop's effort to each of its outputs, by the joint's name."""
    joints, (_, push), found = point.mechanism.independent_joints, channel_effort(point, channel), {}
    for output in outputs_of(point.mechanism, channel):
        plant = plant_transfer(point, push, np.eye(len(joints))[output])
        found[joints[output].name] = PlantModes(resonances=modes_of(plant.poles), anti_resonances=modes_of(plant.zeros))
    return found


def plant_transfer(point: OperatingPoint, push: np.ndarray, row: np.ndarray) -> TransferFunction:
    """Return the transfer function from a scalar input, which gives efforts `push` (n_u,) per unit, to the output `row` @ s.

    Passive and coasting coordinates are included only if the output depends on them.
    """
    A, B, C = plant_matrices(point, push[:, None], row[None])
    return transfer_function(A, B[:, 0], C[0])


def plant_matrices(point: OperatingPoint, pushes: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B and C of x' = A x + B u, y = C x for inputs `pushes` (n_u, n) and outputs `rows` (m, n_s)."""
    mechanism = point.mechanism
    actuated = mechanism.actuated | bool(np.any(rows[:, ~mechanism.actuated]))
    kept = np.flatnonzero(np.tile(actuated, 2))
    A, B = point.linearised()
    return A[kept][:, kept], B[kept] @ pushes, np.hstack([rows, np.zeros_like(rows)])[:, kept]


def modes_of(values: np.ndarray) -> tuple[Mode, ...]:
    """Return the pairs of conjugate poles or zeros among values [rad/s], by frequency."""
    upper = sorted((value for value in values if value.imag > 0), key=abs)
    damping = [0.0 if abs(value.real) <= _NO_DAMPING * abs(value) else -value.real / abs(value) for value in upper]
    return tuple(
        Mode(frequency_hz=float(abs(value) / (2 * np.pi)), damping_ratio=float(ratio))
        for value, ratio in zip(upper, damping, strict=True)
    )
