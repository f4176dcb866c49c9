"""Bounds on L^-1 d and |L^-1| D W over the boxes of a motion, by the fundamental matrix of e' = A e: see `existence`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import arb, arb_mat

from linkplan.planner.proof.taylor import TaylorForm, above

# Terms of the series of Phi over one box, which decrease by a fourth each.
_SERIES_TERMS = 40


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LinearBox:
    """A box: width [s], A (n_s, 2 n_s) as coefficients of powers of x in [-1, 1], D, the forms of d, the jump at the start.

    `end_s` [s] is the end of the box, and `tube` (2 n_s,) half the width of the tube around the plan.
    """

    end_s: float
    tube: np.ndarray
    width: arb
    slopes: list[list[list[float]]]
    variation: list[list[arb]]
    defect: Sequence[TaylorForm]
    jump: list[arb]


def size_of(coefficients: Sequence[arb], middles: Sequence[float] | None = None) -> arb:
    """Return a bound on |p(x)| over x in [-1, 1], or on the distance of p from a polynomial in floating point."""
    middles = [0.0] * len(coefficients) if middles is None else middles
    return sum((abs(c - arb(m)).upper() for c, m in zip(coefficients, middles, strict=True)), arb(0))


def contracted(boxes: Sequence[LinearBox], n_s: int) -> tuple[np.ndarray, float]:
    """Return the error bound W (n_boxes, 2 n_s) up to the end of each box, and the contraction factor Z.

    Phi propagates d and D W of the earlier boxes to each box. The polynomial of d is integrated with its sign, because
    its mean over an interval of collocation is zero. The remainders, the plan's jumps and D W enter by absolute value.
    """
    # A rate [1/s] that scales velocities to the size of positions: the root of the largest |da/ds|.
    largest = max((abs(entry[0]) for box in boxes for row in box.slopes for entry in row[:n_s]), default=0.0)
    n, unit = 2 * n_s, arb(max(largest, 1.0)).sqrt().mid()
    scale = [arb(1)] * n_s + [1 / unit] * n_s  # of (s, s' / unit)
    eye, signed = arb_mat(n, n, [int(i == j) for i in range(n) for j in range(n)]), arb_mat(n, 1)
    phi: arb_mat | None = None  # Phi(t, t_j) side by side for the ends t_j of earlier boxes
    sources: list[list[arb]] = []  # at each of these ends, row by row: by remainders, and by D W
    radii, contraction = [arb(2) ** -300] * n, arb(0)
    bounds = np.empty((len(boxes), n))

    def forced(grown: arb_mat, width: arb, rates: Sequence[arb]) -> arb_mat:
        return grown * arb_mat(n, 1, [arb(0)] * n_s + [width * x / unit for x in rates])

    for k, box in enumerate(boxes):
        for i, jump in enumerate(box.jump if sources else []):
            sources[i - n][0] += jump * scale[i]
        before = arb_mat(n, 2) if phi is None else _absolute(phi) * arb_mat(sources)
        grown, (step, added) = _growth(box, unit, n_s), _transition(box, unit, n_s)
        own = forced(grown, box.width, [form.remainder for form in box.defect])
        begin = _absolute(signed) + arb_mat(n, 1, [before[i, 0] for i in range(n)])
        here = grown * begin + own + forced(grown, box.width, [size_of(form.coefficients) for form in box.defect])
        radii = [x.max(here[i, 0].upper()) for i, x in enumerate(radii)]
        unscaled = [x / y for x, y in zip(radii, scale, strict=True)]
        bounds[k] = [above(x) for x in unscaled]
        more = forced(
            grown, box.width, [sum((d * w for d, w in zip(row, unscaled, strict=True)), arb(0)) for row in box.variation]
        )
        all_more = grown * arb_mat(n, 1, [before[i, 1] for i in range(n)]) + more
        for i in range(n):
            contraction = contraction.max((all_more[i, 0] / radii[i]).upper())
        phi, signed = eye if phi is None else _beside(step * phi, eye), step * signed + added
        sources += [[own[i, 0], more[i, 0]] for i in range(n)]
    return bounds, above(contraction)


def _absolute(matrix: arb_mat) -> arb_mat:
    return arb_mat(matrix.nrows(), matrix.ncols(), [abs(x).upper() for x in matrix.entries()])


def _beside(left: arb_mat, right: arb_mat) -> arb_mat:
    """Return the block matrix [left right]."""
    rows = zip(left.tolist(), right.tolist(), strict=True)
    return arb_mat([[*a, *b] for a, b in rows])


def _scaled_slopes(box: LinearBox, unit: arb, n_s: int, degree: int) -> arb_mat:
    """Return the coefficient of x^degree of A, for states (s, s' / unit)."""
    rows = [[arb(int(j == i + n_s and not degree)) * unit for j in range(2 * n_s)] for i in range(n_s)]
    for row in box.slopes:
        values = [arb(entry[degree]) if degree < len(entry) else arb(0) for entry in row]
        rows.append([x / unit for x in values[:n_s]] + values[n_s:])
    return arb_mat(rows)


def _growth(box: LinearBox, unit: arb, n_s: int) -> arb_mat:
    """Return a bound on |Phi(t, tau)| for all times of a box: exp(h |A|)."""
    terms = max(len(entry) for row in box.slopes for entry in row)
    total = arb_mat(2 * n_s, 2 * n_s)
    for degree in range(terms):
        total += _absolute(_scaled_slopes(box, unit, n_s, degree))
    return _absolute((box.width * total).exp())


def _transition(box: LinearBox, unit: arb, n_s: int) -> tuple[arb_mat, arb_mat]:
    """Return Phi over a box, and the integral over the box of Phi times the polynomial of -d.

    Both are columns of Y with Y' = A Y, A extended by a column of -d. The series of Y in x + 1 has terms with
    m Y_m = h / 2 sum_i A_i Y_(m - 1 - i). With |Y(z)| <= Y_R = exp(int_0^R |A|) on the disc of radius R = 8, the remainder
    after term p is below Y_R 4^-p / 3 on |z| <= 2.
    """
    n, half = 2 * n_s, box.width / 2
    terms = max(*(len(entry) for row in box.slopes for entry in row), *(len(form.coefficients) for form in box.defect))
    about_middle = []
    for degree in range(terms):
        forces = [-form.coefficients[degree] / unit if degree < len(form.coefficients) else arb(0) for form in box.defect]
        column = arb_mat([[x] for x in [arb(0)] * n_s + forces])
        rows = _beside(_scaled_slopes(box, unit, n_s, degree), column).tolist()
        about_middle.append(arb_mat([*rows, [arb(0)] * (n + 1)]))
    A = []
    for i in range(terms):  # of powers of x + 1
        shifted = arb_mat(n + 1, n + 1)
        for j in range(i, terms):
            shifted += about_middle[j] * (math.comb(j, i) * (-1) ** (j - i))
        A.append(shifted * half)
    series = [arb_mat(n + 1, n + 1, [int(i == j) for i in range(n + 1) for j in range(n + 1)])]
    for m in range(1, _SERIES_TERMS + 1):
        term = arb_mat(n + 1, n + 1)
        for i in range(min(m, terms)):
            term += A[i] * series[m - 1 - i]
        series.append(term * (arb(1) / m))
    total, power = arb_mat(n + 1, n + 1), arb(1)
    for term in series:
        total, power = total + term * power, 2 * power
    grown = arb(0)
    for i, a in enumerate(A):
        norm = arb(0)
        for row in _absolute(a).tolist():
            norm = norm.max(sum(row, arb(0)))
        grown += norm * arb(8) ** (i + 1) / (i + 1)
    tail = arb(0, (grown.exp() / 3 / arb(4) ** _SERIES_TERMS).upper())
    rows = [[x + tail for x in row] for row in total.tolist()[:n]]
    return arb_mat([row[:n] for row in rows]), arb_mat([row[n:] for row in rows])
