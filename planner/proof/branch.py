"""The branch of a closed chain: enclosures of the dependent coordinates z with phi(s, z) = 0 along given s(t).

On a box of positions s, Krawczyk's operator

    K(Z) = z_0 - C phi(s, z_0) + (1 - C J_z(s, Z)) (Z - z_0),   C near J_z^-1,

proves that Z has exactly one root for each s of the box if K(Z) lies inside of Z (Krawczyk, Computing 4, 1969; Neumaier,
Interval Methods for Systems of Equations, 1990, theorem 5.1.8). J_z is then regular in all of Z. The Taylor coefficients of
z(t) follow by Newton's method on power series, which doubles the number of correct coefficients in each step.
"""

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import arb, arb_mat, arb_series, ctx

from linkplan.planner.proof.taylor import NotSeparatedError, solve_enclosed
from linkplan.planner.proof.walk import Ball, Blocks, dense

# Krawczyk's trial ball is enlarged up to so often by half, until the operator maps it into itself.
_MOST_INFLATIONS = 6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class EnclosedRoot:
    """The root z for every s of a box: `enclosure` contains the root, and `region` contains no other root."""

    enclosure: list[arb]
    region: list[arb]


def pose_of(blocks: Blocks, s: Sequence[Ball], z: Sequence[Ball]) -> list[Ball]:
    """Return the pose q (n_q,) with the given independent and dependent coordinates."""
    found: list = [None] * (len(s) + len(z))
    for index, value in (*zip(blocks.independent, s, strict=True), *zip(blocks.dependent, z, strict=True)):
        found[index] = value
    return found


def newton(blocks: Blocks, s: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return the dependent coordinates (rank,) by Newton's method in floating point: a guess, which is not proved.

    Raises:
        NotSeparatedError: if the iteration does not converge.
    """
    if not blocks.rank:
        return np.zeros(0)
    q = np.empty(len(s) + len(z))
    q[list(blocks.independent)], q[list(blocks.dependent)] = s, z
    of = list(blocks.dependent)
    size = np.inf
    for _ in range(12):
        phi, jacobian = blocks.numbers(q)
        try:
            step = np.linalg.solve(jacobian[:, of], -phi)
        except np.linalg.LinAlgError:
            break
        q[of] += step
        last, size = size, float(np.abs(step).max(initial=0.0))
        if size < 1e-14 or (size < 1e-9 and size >= last):
            return q[of]
        if not size < 1e3:
            break
    raise NotSeparatedError("Newton's method did not converge")


def krawczyk(blocks: Blocks, s: Sequence[arb], guess: np.ndarray) -> EnclosedRoot:
    """Return an enclosure of the root near a guess for every s of a box, by Krawczyk's operator.

    Raises:
        NotSeparatedError: if the operator proves neither existence nor uniqueness of the root.
    """
    n = blocks.rank
    if n == 0:
        return EnclosedRoot(enclosure=[], region=[])
    at = np.empty(n + len(s))
    at[list(blocks.independent)], at[list(blocks.dependent)] = [float(x.mid()) for x in s], guess
    J = blocks.numbers(at)[1][:, list(blocks.dependent)]
    try:
        C = arb_mat(n, n, [float(x) for x in np.linalg.inv(J).ravel()])
    except (np.linalg.LinAlgError, ValueError) as error:
        raise NotSeparatedError("J_z is singular") from error
    start = [arb(float(x)) for x in guess]
    phi = dense(blocks.closure(pose_of(blocks, s, start))[0], n)
    step = -(C * arb_mat(n, 1, phi))  # pyright: ignore[reportArgumentType]  constants, no series
    one = arb_mat(n, n, [int(i == j) for i in range(n) for j in range(n)])
    moved = step
    for _ in range(_MOST_INFLATIONS):
        around = [arb(0, abs(moved[i, 0]).upper() * arb(1.5) + arb(2) ** -60) for i in range(n)]
        region = [x + d for x, d in zip(start, around, strict=True)]
        tangent = blocks.tangent(pose_of(blocks, s, region))[0]
        entries = [tangent.get((i, j), arb(0)) for i in range(n) for j in blocks.dependent]
        J_z = arb_mat(n, n, entries)  # pyright: ignore[reportArgumentType]  constants, no series
        moved = step + (one - C * J_z) * arb_mat(n, 1, around)
        if all(around[i].contains_interior(moved[i, 0]) for i in range(n)):
            return EnclosedRoot(enclosure=[start[i] + moved[i, 0] for i in range(n)], region=region)
        if not all(moved[i, 0].is_finite() for i in range(n)):
            break
    raise NotSeparatedError("Krawczyk's operator does not map the box into itself")


def series_of(blocks: Blocks, s: Sequence[arb_series], root: Sequence[arb], order: int) -> list[arb_series]:
    """Return the series z (rank,) with `order` coefficients along the series s (n_s,), from the constant terms `root`.

    If the balls of s and z_0 contain the coefficients at every expansion point of a box, so do the balls of the result.
    """
    n = len(root)
    coefficients = [[z] for z in root]
    for known, cap in _doublings(order) if n else ():
        ctx.cap = cap
        short = [arb_series(x.coeffs(), prec=cap) for x in s]
        q = pose_of(blocks, short, [arb_series(c, prec=cap) for c in coefficients])
        phi = dense(blocks.closure(q)[0], n)
        # The coefficients before `known` vanish for the exact root, and only the first of J_z act on the new ones.
        left = [arb_series([-phi_i[k] for k in range(known, cap)], prec=cap - known) for phi_i in map(_series, phi)]
        tangent = blocks.tangent([arb_series(x.coeffs(), prec=cap - known) for x in q])[0]
        J_z = {(i, j): tangent[i, c] for i in range(n) for j, c in enumerate(blocks.dependent) if (i, c) in tangent}
        (added,) = solve_enclosed(J_z, [left])
        for of, more in zip(coefficients, map(_series, added), strict=True):
            of += [more[k] for k in range(cap - known)]
    ctx.cap = order
    return [arb_series(c, prec=order) for c in coefficients]


@functools.cache
def _doublings(order: int) -> tuple[tuple[int, int], ...]:
    """Return the numbers of coefficients before and after each Newton step, which at most doubles the number."""
    caps = [order]
    while caps[-1] > 1:
        caps.append((caps[-1] + 1) // 2)
    return tuple(itertools.pairwise(reversed(caps)))


def _series(x: Ball) -> arb_series:
    return x if isinstance(x, arb_series) else arb_series([x])
