"""Transfer functions from one input to one output: poles, zeros and gain of a linear model x' = A x + b u, y = c x.

    G(s) = c (s 1 - A)^-1 b = k (s - z_1) ... (s - z_m) / ((s - p_1) ... (s - p_n))

The relative degree r is that of the first Markov parameter c A^(r - 1) b that is not zero. The n - r zeros are the
eigenvalues of the zero dynamics, the motion under the input that keeps the output at rest:

    x' = (A - b c A^r / (c A^(r - 1) b)) x   in the space where c x = c A x = ... = c A^(r - 1) x = 0

(Isidori, Nonlinear Control Systems, 1995, 4.3). They are the finite eigenvalues of the pencil [[A, b], [c, 0]] - s [[1, 0],
[0, 0]] (Emami-Naeini & Van Dooren, Automatica 18, 1982). The pencil also has r + 1 infinite eigenvalues, which rounding
makes finite: of the size eps^(-1 / (r + 1)), so 1400 times that of the poles if springs transmit the force (r = 4).

Resonances of a plant are the poles with its open loops. Its anti-resonances are the zeros of one output: at such a frequency
the effort moves the other coordinates, and the output does not move.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from msgspec import Struct

from linkplan.studies.feedback.frequency.feedback_loops import OperatingPoint, channel_effort, outputs_of

# A Markov parameter c A^k b below this share of the product of its factors' norms is a rounding error and counts as zero.
_ROUNDING_SHARE = 1e-10
# Zeros beyond this many times the fastest pole are infinite: they change the response by 1e-4 at most.
_INFINITE_SHARE = 1e4
# Poles and zeros below this share of the fastest pole are at the origin; rounding splits a pair there by 1e-8. Those below
# this rate (a period of a week) are too, because a mechanism in neutral equilibrium has no faster pole.
_ORIGIN_SHARE, _ORIGIN_RAD_S = 1e-7, 1e-5
# Poles and zeros with a smaller distance, as a share of their size, cancel: the effort does not excite the mode.
_CANCELLING_SHARE = 1e-6
# A root is in the right half plane if its real part is above this share of its size.
_RIGHT_SHARE = 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class TransferFunction:
    """A transfer function k (s - z_1) ... / ((s - p_1) ...) without common poles and zeros, by rising size [rad/s].

    `gain` k is zero, without any poles and zeros, where the input does not move the output.
    """

    poles: np.ndarray
    zeros: np.ndarray
    gain: float

    @property
    def relative_degree(self) -> int:
        """The number of poles minus that of zeros; at high frequencies the gain falls by 20 dB per decade for each."""
        return len(self.poles) - len(self.zeros)

    @property
    def integrators(self) -> int:
        """The number of poles at the origin, or minus the number of zeros there."""
        return int(np.sum(self.poles == 0)) - int(np.sum(self.zeros == 0))

    @property
    def low_frequency_gain(self) -> float:
        """The limit of s^n G(s) as s tends to zero, n the number of `integrators`."""
        top, below = (np.prod(-roots[roots != 0]) for roots in (self.zeros, self.poles))
        return float(np.real(self.gain * top / below))

    def at(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Return the complex gains (n,) at frequencies (n,) [Hz]."""
        s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
        return self.gain * _product(s, self.zeros, self.poles)


def transfer_function(A: np.ndarray, b: np.ndarray, c: np.ndarray) -> TransferFunction:
    """Return the transfer function of x' = A x + b u, y = c x with A (n, n), b (n,) and c (n,)."""
    nothing = np.zeros(0, dtype=complex)
    A, (scale, _) = scipy.linalg.matrix_balance(A, permute=False, separate=True)
    b, c = b / scale, c * scale
    poles = np.linalg.eigvals(A)
    fastest = float(np.abs(poles).max(initial=0.0))
    zeros = _zeros(A, b, c, fastest)
    if zeros is None:
        return TransferFunction(poles=nothing, zeros=nothing, gain=0.0)
    poles = np.where(np.abs(poles) < max(_ORIGIN_SHARE * fastest, _ORIGIN_RAD_S), 0.0, poles)
    n_poles = int(np.sum(poles == 0))
    zeros[np.argsort(np.abs(zeros))[: n_poles + _order_at_zero(A, b, c, n_poles)]] = 0.0
    own, seen = _without(poles, zeros), _without(zeros, poles)
    sizes = np.abs(poles[poles != 0])
    amid = (np.exp(np.mean(np.log(sizes))) if sizes.size else 1.0) * np.exp(0.25j * np.pi)  # neither tiny nor near a pole
    value = c @ np.linalg.solve(amid * np.eye(len(A)) - A, b)
    gain = float(np.real(value / _product(np.array([amid]), seen, own)[0]))
    return TransferFunction(poles=own, zeros=seen, gain=gain)


def in_right_half_plane(roots: np.ndarray) -> np.ndarray:
    """Return the roots with a positive real part, beyond rounding."""
    return roots[roots.real > _RIGHT_SHARE * np.abs(roots)]


def _zeros(A: np.ndarray, b: np.ndarray, c: np.ndarray, fastest: float) -> np.ndarray | None:
    """Return the finite zeros, or None if the input does not move the output."""
    rows, row = [], c
    for _ in range(len(A)):
        size = float(np.linalg.norm(row))
        if size == 0.0:
            return None
        rows.append(row / size)
        row, markov = row @ A / size, float(row @ b) / size
        if abs(markov) > _ROUNDING_SHARE * np.linalg.norm(b):
            break
    else:
        return None
    space = np.linalg.qr(np.array(rows).T, mode="complete")[0][:, len(rows) :]
    found = np.linalg.eigvals(space.T @ (A @ space - np.outer(b, row @ space) / markov)).astype(complex)
    return found[np.abs(found) < _INFINITE_SHARE * fastest]


def _order_at_zero(A: np.ndarray, b: np.ndarray, c: np.ndarray, n_poles: int) -> int:
    """Return the exponent of the first term of G(s) = ... + g s^order + ... at s = 0, where A has `n_poles` poles.

    With A split into the block N of these poles, with b_0 and c_0, and the rest A_1, with b_1 and c_1, the terms are

        c_0 N^j b_0 s^-(j + 1)   and   -c_1 A_1^-(k + 1) b_1 s^k.

    Zeros at the origin are counted in this way, because rounding splits m of them by eps^(1 / m): four by 1e-4.
    """
    sizes = np.append(np.sort(np.abs(np.linalg.eigvals(A))), np.inf)
    border = 0.5 * sizes[n_poles] if n_poles else -1.0
    T, Q, found = scipy.linalg.schur(  # pyright: ignore[reportAssignmentType]  three values with `sort`
        A.astype(complex), output="complex", sort=lambda x: abs(x) <= border
    )
    N, rest = np.triu(T[:found, :found], 1), T[found:, found:]
    b, c = Q.conj().T @ b, c @ Q
    apart = scipy.linalg.solve_sylvester(T[:found, :found], -rest, -T[:found, found:])  # [[1, X], [0, 1]] decouples T
    b_0, b_1, c_0, c_1 = b[:found] - apart @ b[found:], b[found:], c[:found], c[:found] @ apart + c[found:]
    size = _ROUNDING_SHARE * float(np.linalg.norm(c) * np.linalg.norm(b))
    for j in reversed(range(found)):
        if abs(c_0 @ np.linalg.matrix_power(N, j) @ b_0) > size * max(1.0, float(np.linalg.norm(N))) ** j:
            return -(j + 1)
    row = c_1
    for order in range(len(A)):
        row = np.linalg.solve(rest.T, row)
        row = row / np.linalg.norm(row)
        if abs(row @ b_1) > _ROUNDING_SHARE * np.linalg.norm(b_1):
            return order
    return 0


def _product(s: np.ndarray, zeros: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """Return the product of (s - z) over that of (s - p), with alternating factors so that neither product overflows."""
    found = np.ones(len(s), dtype=complex)
    for k in range(max(len(zeros), len(poles))):
        found = found * (s - zeros[k] if k < len(zeros) else 1.0) / (s - poles[k] if k < len(poles) else 1.0)
    return found


def _without(some: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the values that are not among `others`, by ascending size."""
    left, kept = list(others), []
    for value in some:
        near = [k for k, other in enumerate(left) if abs(other - value) <= _CANCELLING_SHARE * abs(value)]
        if near:
            left.pop(near[0])
        else:
            kept.append(value)
    return np.array(sorted(kept, key=lambda value: (abs(value), value.imag)), dtype=complex)


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
