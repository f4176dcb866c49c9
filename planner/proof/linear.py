"""Small linear systems over balls and series, by elimination that skips the zeros of the structure."""

from collections.abc import Sequence

from flint import arb

from linkplan.planner.proof.walk import Ball, constant_term

Matrix = dict[tuple[int, int], Ball]


class NotSeparatedError(ArithmeticError):
    """The balls are too wide: a pivot may vanish, or a root is not isolated."""


def solve(matrix: Matrix, columns: Sequence[Sequence[Ball | None]]) -> list[list[Ball]]:
    """Return the solutions x (n,) of A x = b for several right sides b (n,); None is a zero.

    Args:
        matrix: A (n, n) by its nonzero entries.
        columns: the right sides.

    Raises:
        NotSeparatedError: when every possible pivot of a column contains zero.
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
                _subtract(rows[row], factor, rows[pivot], column)
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


def _subtract(row: dict[int, Ball], factor: Ball, of: dict[int, Ball], after: int) -> None:
    """Subtract a multiple of a row from another, in the columns after one."""
    for column, entry in of.items():
        if column > after:
            row[column] = row[column] - factor * entry if column in row else -(factor * entry)


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
