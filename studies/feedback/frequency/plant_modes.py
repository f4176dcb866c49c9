"""Resonances and anti-resonances of a plant: from the effort of a feedback loop to the positions of joints.

Resonances are the poles of the plant with its open loops, x' = A x + B u. Anti-resonances are the transmission zeros of one
output, the finite eigenvalues of the pencil [[A, B], [C, 0]] - lambda [[1, 0], [0, 0]] (Emami-Naeini & Van Dooren,
Automatica 18, 1982): at such a frequency the effort moves the other coordinates, and the output stands still.
"""

import numpy as np
import scipy.linalg
from msgspec import Struct

from linkplan.controllers.linearisation import linearise
from linkplan.studies.feedback.frequency.feedback_loops import OperatingPoint, channel_effort, outputs_of

# Poles and zeros that are this near, as a share of their size, cancel: the effort does not excite the mode.
_CANCELLING_SHARE = 1e-6
# Zeros beyond this many times the fastest pole are infinite but for rounding.
_INFINITE_SHARE = 1e4
# A damping ratio below this is zero but for rounding.
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
    mechanism = point.mechanism
    kept = np.flatnonzero(np.tile(mechanism.actuated, 2))
    A, B = (found[0] for found in linearise(mechanism, point.pose[None], point.velocity[None], point.hold[None]))
    _, push = channel_effort(point, channel)
    A, b = A[kept][:, kept], (B[kept] @ push)[:, None]
    poles, found = np.linalg.eigvals(A), {}
    for output in outputs_of(mechanism, channel):
        c = (kept == output).astype(float)[None]
        zeros = _zeros(A, b, c, _INFINITE_SHARE * np.abs(poles).max(initial=1.0))
        own, seen = _without(poles, zeros), _without(zeros, poles)
        found[mechanism.independent_joints[output].name] = PlantModes(resonances=_modes(own), anti_resonances=_modes(seen))
    return found


def _zeros(A: np.ndarray, b: np.ndarray, c: np.ndarray, largest: float) -> np.ndarray:
    """Return the finite transmission zeros of x' = A x + b u, y = c x."""
    n = len(A)
    pencil, mass = np.block([[A, b], [c, np.zeros((1, 1))]]), np.zeros((n + 1, n + 1))
    mass[:n, :n] = np.eye(n)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.asarray(scipy.linalg.eigvals(pencil, mass))
    return found[np.isfinite(found) & (np.abs(found) < largest)]


def _without(some: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return values that have no equal among others."""
    left, kept = list(others), []
    for value in some:
        near = [k for k, other in enumerate(left) if abs(other - value) <= _CANCELLING_SHARE * max(1.0, abs(value))]
        if near:
            left.pop(near[0])
        else:
            kept.append(value)
    return np.array(kept, dtype=complex)


def _modes(values: np.ndarray) -> tuple[Mode, ...]:
    upper = sorted((value for value in values if value.imag > 0), key=abs)
    damping = [0.0 if abs(value.real) <= _NO_DAMPING * abs(value) else -value.real / abs(value) for value in upper]
    return tuple(
        Mode(frequency_hz=float(abs(value) / (2 * np.pi)), damping_ratio=float(ratio))
        for value, ratio in zip(upper, damping, strict=True)
    )
