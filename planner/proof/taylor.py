"""Taylor forms: a function of time on a box as a polynomial with balls as coefficients, and a remainder.

With x in [-1, 1] over the box, f(x) = sum_k f_k x^k + R x^n: f_k are Taylor coefficients at the middle, R contains the n-th
Taylor coefficient at every point of the box (Tucker, Validated Numerics, 2011, ch. 5). Bernstein coefficients bound the
polynomial, and its halves bound it more tightly without new evaluations of the model.

Small linear systems over balls and series are solved by an elimination that skips structural zeros.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from flint import arb, arb_mat, arb_series, fmpq

from linkplan.planner.proof.walk import Ball, constant_term

Matrix = dict[tuple[int, int], Ball]
# Halvings of a polynomial, which divide a box by up to a million.
_MAX_HALVINGS = 20
# A bound is loose if more than this share of it comes from the remainder, or if it lies further than this share beyond the
# polynomial's values at both ends. Each halving of the polynomial divides that distance by four. This number of halvings is
# the most for this purpose.
LOOSE_SHARE, _TIGHTENING_HALVINGS = 1e-2, 4


class NotSeparatedError(ArithmeticError):
    """The balls are too wide: a pivot may vanish, or a root is not isolated from others."""


def solve_enclosed(matrix: Matrix, columns: Sequence[Sequence[Ball | None]]) -> list[list[Ball]]:
    """Return the solutions x (n,) of A x = b for several right-hand sides b (n,); an entry None is zero.

    Args:
        matrix: A (n, n) by its nonzero entries.
        columns: the right-hand sides b.

    Raises:
        NotSeparatedError: if every possible pivot of a column contains zero.
    """
    n = len(columns[0])
    rows = [{column: matrix[row, column] for column in range(n) if (row, column) in matrix} for row in range(n)]
    right = [[of[row] for of in columns] for row in range(n)]
    order = []
    for column in range(n):
        left = [row for row in range(n) if row not in order and column in rows[row]]
        if not left:
            raise NotSeparatedError("a column without a pivot")
        pivot = max(left, key=lambda row: constant_term(rows[row][column]).abs_lower())
        if not abs(constant_term(rows[pivot][column])) > 0:
            raise NotSeparatedError("a pivot may vanish")
        order.append(pivot)
        for row in left:
            if row != pivot:
                factor = rows[row].pop(column) / rows[pivot][column]
                for k, entry in rows[pivot].items():
                    if k > column:
                        rows[row][k] = rows[row][k] - factor * entry if k in rows[row] else -(factor * entry)
                right[row] = [_less(b, factor, top) for b, top in zip(right[row], right[pivot], strict=True)]
    solutions: list[list[Ball]] = [[arb(0)] * n for _ in columns]
    for column in reversed(range(n)):
        pivot = order[column]
        for k, found in enumerate(solutions):
            value = right[pivot][k]
            for other, entry in rows[pivot].items():
                if other > column:
                    value = _less(value, entry, found[other])
            found[column] = arb(0) if value is None else value / rows[pivot][column]
    return solutions


def _less(value: Ball | None, factor: Ball, other: Ball | None) -> Ball | None:
    """Return value - factor * other, where None is zero."""
    if other is None:
        return value
    return -(factor * other) if value is None else value - factor * other


def transposed(matrix: Matrix) -> Matrix:
    """Return the transposed matrix."""
    return {(column, row): entry for (row, column), entry in matrix.items()}


def product(matrix: Matrix, x: Sequence[Ball], n_rows: int) -> list[Ball]:
    """Return A x (n_rows,)."""
    found: list[Ball] = [arb(0)] * n_rows
    for (row, column), entry in matrix.items():
        found[row] = found[row] + entry * x[column]
    return found


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Verdict:
    """A bound on one box: `answer` is True (within the marks), False (outside at x = `at` in [-1, 1]) or None (undecided).

    `least` and `greatest` enclose the values on the box; for a violation, they enclose the value at that point.
    """

    answer: bool | None
    least: float
    greatest: float
    at: float = 0.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class TaylorForm:
    """A polynomial with coefficients (n,), and the size of its remainder; `whole` contains all values on the box."""

    coefficients: list[arb]
    remainder: arb
    whole: arb

    @classmethod
    def of(cls, middle: Ball, box: Ball, order: int) -> "TaylorForm":
        """Return the form of at most `order` coefficients from the series at the middle and over the whole box.

        A derivative of a series has fewer coefficients. Near a kink the form has as many as the function has bounded
        derivatives. Near a jump it consists of the range alone.
        """
        if isinstance(box, arb):
            return cls(coefficients=[box], remainder=arb(0), whole=box)
        known = min(order, box.prec - 1)  # a coefficient beyond the known ones reads as zero
        n = next((k for k in range(known) if not box[k + 1].is_finite()), known)
        if not n:
            return cls(coefficients=[box[0]], remainder=arb(0), whole=box[0])
        first = middle if isinstance(middle, arb_series) else arb_series([middle])
        return cls(coefficients=[first[k] for k in range(n)], remainder=box[n].abs_upper(), whole=box[0])

    def at_start(self) -> arb:
        """Return the value at the box's start, x = -1."""
        value = sum(((-1) ** k * c for k, c in enumerate(self.coefficients)), arb(0))
        return value + arb(0, self.remainder)

    def at_end(self) -> arb:
        """Return the value at the box's end, x = 1."""
        return sum(self.coefficients, arb(0)) + arb(0, self.remainder)

    def verdict(
        self, low: arb, high: arb, *, known: tuple[float, float] = (-math.inf, math.inf), size: float = 0.0
    ) -> Verdict:
        """Return whether all values lie between two marks, and bounds on them.

        Args:
            low: a mark.
            high: likewise.
            known: the range of the values on other boxes. Bounds outside of it are tightened if they are loose.
            size: the least size of which the share of a loose bound is taken.
        """
        if self.whole > low and self.whole < high and not self.remainder.is_finite():
            return Verdict(answer=True, least=below(self.whole), greatest=above(self.whole))
        n, E = len(self.coefficients), arb(0, self.remainder)
        if not self.remainder.is_finite() or not all(c.is_finite() for c in self.coefficients):
            return Verdict(answer=None, least=below(self.whole), greatest=above(self.whole))
        column = _to_bernstein(n) * arb_mat(n, 1, self.coefficients)
        pieces = [([column[i, 0] for i in range(n)], -1.0, 1.0, 0)]
        least, greatest = math.inf, -math.inf
        answer: bool | None = True
        while pieces:
            b, begin, end, depth = pieces.pop()
            values = [c + E for c in b]
            bottom, top = min(v.lower() for v in values), max(v.upper() for v in values)
            loose = depth < _TIGHTENING_HALVINGS and _is_loose(values, bottom, top, known, size)
            if bottom >= low and top <= high and not loose:
                least, greatest = min(least, below(bottom)), max(greatest, above(top))
                continue
            for value, at in ((values[0], begin), (values[-1], end)):
                if value > high or value < low:
                    return Verdict(answer=False, least=below(value), greatest=above(value), at=at)
            spread = max(c.upper() for c in b) - min(c.lower() for c in b)
            if depth == _MAX_HALVINGS or not spread > self.remainder / 2:
                answer = answer if bottom >= low and top <= high else None
                least, greatest = min(least, below(bottom)), max(greatest, above(top))
                continue
            left, right = _halves(b)
            middle = 0.5 * (begin + end)
            pieces += [(right, middle, end, depth + 1), (left, begin, middle, depth + 1)]
        return Verdict(answer=answer, least=least, greatest=greatest)


def _is_loose(values: list[arb], bottom: arb, top: arb, known: tuple[float, float], size: float) -> bool:
    """Return True if a bound lies outside of the known range, and far beyond a polynomial's values at both ends."""
    far = LOOSE_SHARE * max(abs(float(bottom)), abs(float(top)), size)
    first, last = values[0], values[-1]
    above_ends = top > known[1] and top - max(first.upper(), last.upper()) > far
    return above_ends or (bottom < known[0] and min(first.lower(), last.lower()) - bottom > far)


def below(value: arb) -> float:
    """Return a floating-point number that is at most the lower end of a ball."""
    return math.nextafter(float(value.lower()), -math.inf)


def above(value: arb) -> float:
    """Return a floating-point number that is at least the upper end of a ball."""
    return math.nextafter(float(value.upper()), math.inf)


def _halves(b: list[arb]) -> tuple[list[arb], list[arb]]:
    """Return the Bernstein coefficients of both halves of an interval, by de Casteljau."""
    left, right, row = [b[0]], [b[-1]], b
    while len(row) > 1:
        row = [(x + y) / 2 for x, y in itertools.pairwise(row)]
        left.append(row[0])
        right.append(row[-1])
    return left, right[::-1]


@functools.cache
def _to_bernstein(n: int) -> arb_mat:
    """Return the matrix (n, n) from coefficients of powers of x in [-1, 1] to Bernstein coefficients."""
    d = n - 1
    found = [[fmpq(0)] * n for _ in range(n)]
    for k in range(n):  # x^k = (2 t - 1)^k = sum_j C(k, j) 2^j (-1)^(k - j) t^j, and t^j = sum_i C(i, j) / C(d, j) B_i
        for i in range(n):
            found[i][k] = sum(
                (
                    fmpq(math.comb(k, j) * 2**j * (-1) ** (k - j) * math.comb(i, j), math.comb(d, j))
                    for j in range(min(i, k) + 1)
                ),
                fmpq(0),
            )
    return arb_mat(n, n, [arb(x) for row in found for x in row])
