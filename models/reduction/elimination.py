"""Symbolic solution of A x = b by the block triangular form of A.

The second loop of a mechanism is usually attached to the first, so J_z is block triangular with blocks of two or three
rows. Blocks of up to three rows are solved by Cramer's rule, larger blocks by QR. Neither needs a pivot, which could vanish
while A is regular. Determinants of blocks of up to twelve rows are expanded in minors, whose number grows exponentially with
the size; those of larger blocks come from Givens rotations, which keep the sign.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca

# Largest block that is solved by Cramer's rule, which gives the shortest expressions up to this size.
_MAX_CRAMER_SIZE = 3
# Largest block whose determinant is expanded: a dense one of twelve rows has 4096 minors.
_MAX_EXPANDED_SIZE = 12


def factorise(A: ca.SX) -> Callable[[ca.SX], ca.SX]:
    """Return the function b -> A^-1 b, whose calls share the expressions that depend only on A."""
    n = A.shape[0]
    if n == 0:
        return lambda b: ca.SX(0, b.shape[1])
    A = ca.sparsify(A)
    rows, columns, blocks = _blocks(A)
    permuted = A[rows, columns]
    solvers = [_block_solver(permuted[block, block]) for block in blocks]
    position = [0] * n
    for place, column in enumerate(columns):
        position[column] = place

    def solve(b: ca.SX) -> ca.SX:
        b = b[rows, :]
        x = ca.SX(n, b.shape[1])
        # CasADi's block triangular form is lower triangular.
        for block, solver in zip(blocks, solvers, strict=True):
            known = slice(0, block.start)
            x[block, :] = solver(b[block, :] - (permuted[block, known] @ x[known, :] if block.start else 0))
        return x[position, :]

    return solve


def solved_in_numbers(n: int) -> bool:
    """Return True if n unknowns have no short formula: LDL^T in scalars grows with the cube of n."""
    return n > _MAX_CRAMER_SIZE


def solve_positive(A: Any, b: Any) -> Any:
    """Return A^-1 b for a positive definite A such as an inertia. Beyond three unknowns LDL^T is a quarter as long as QR.

    A and b are expressions of scalars (SX), or of matrices (MX): then one node factorises numbers by LDL^T.
    """
    if isinstance(A, ca.MX):
        return ca.solve(A, b, "ldl")
    if A.shape[0] <= _MAX_CRAMER_SIZE:
        return factorise(A)(b)
    A = ca.sparsify(A)
    pattern = A.sparsity()  # may be asymmetric where terms cancel on one side of the diagonal only
    D, LT, order = ca.ldl(ca.project(A, pattern.unite(pattern.T)))
    return ca.ldl_solve(b, D, LT, order)


def block_determinants(A: ca.SX) -> ca.SX:
    """Return the determinants (n_blocks,) of A's diagonal blocks; det A is their product up to its sign.

    If two loops fold at once, as in a mirrored gripper, both determinants change sign and their product does not.
    """
    if A.shape[0] == 0:
        return ca.SX(ca.DM.ones(1))
    A = ca.sparsify(A)
    rows, columns, blocks = _blocks(A)
    permuted = A[rows, columns]
    ones = [permuted[block, block] for block in blocks]
    return ca.vertcat(*[_minor(one) if one.shape[0] <= _MAX_EXPANDED_SIZE else _rotated_determinant(one) for one in ones])


def block_rows(A: ca.SX) -> list[list[int]]:
    """Return the rows of each of A's diagonal blocks, in the order of `block_determinants`."""
    if A.shape[0] == 0:
        return [[]]
    rows, _, blocks = _blocks(ca.sparsify(A))
    return [rows[block] for block in blocks]


def determinant(A: ca.SX) -> ca.SX:
    """Return det A with its sign."""
    if A.shape[0] == 0:
        return ca.SX(1)
    rows, columns, _ = _blocks(ca.sparsify(A))
    product = ca.SX(_parity(rows) * _parity(columns))
    for det in ca.vertsplit(block_determinants(A)):
        product *= det
    return product


def _blocks(A: ca.SX) -> tuple[list[int], list[int], list[slice]]:
    """Return the row and column order that make A block triangular, and its diagonal blocks."""
    n_blocks, rows, columns, starts, _, _, _ = A.sparsity().btf()
    return list(rows), list(columns), [slice(starts[k], starts[k + 1]) for k in range(n_blocks)]


def _block_solver(A: ca.SX) -> Callable[[ca.SX], ca.SX]:
    if A.shape[0] <= _MAX_CRAMER_SIZE:
        adjugate, det = _adjugate(A), _minor(A)
        return lambda b: (adjugate @ b) / det
    # Columns with few entries come first, so that Q and R of loops that share few joints stay sparse.
    order = sorted(range(A.shape[0]), key=lambda column: A[:, column].nnz())
    Q, R = ca.qr(A[:, order])
    columns, place = ca.horzsplit(Q), [order.index(column) for column in range(len(order))]

    def solve(b: ca.SX) -> ca.SX:
        # CasADi's Q, by modified Gram-Schmidt, is not quite orthogonal: Q^T b, computed column by column from the remainder
        # of b after the earlier columns, is as exact as the last column of a factorised [A, b] (Bjoerck, BIT 7, 1967).
        parts = []
        for column in columns:
            parts.append(column.T @ b)
            b = b - column @ parts[-1]
        return ca.solve(R, ca.vertcat(*parts))[place, :]

    return solve


def _adjugate(A: ca.SX) -> ca.SX:
    n = A.shape[0]
    adjugate = ca.SX(n, n)
    for i in range(n):
        for j in range(n):
            others = A[[k for k in range(n) if k != i], [k for k in range(n) if k != j]]
            adjugate[j, i] = (-1) ** (i + j) * _minor(others)
    return adjugate


def _rotated_determinant(A: ca.SX) -> ca.SX:
    """Return det A as the product of the diagonal that Givens rotations of rows leave (Golub & Van Loan, 5.1.8, 5.2.5).

    Each rotation has the determinant one and needs no pivot. Sparse columns and rows come first.
    """
    n, order = A.shape[0], []
    columns = sorted(range(n), key=lambda column: A[:, column].nnz())
    A = A[:, columns]
    entries: list[dict[int, ca.SX]] = [{} for _ in range(n)]
    for row, column in zip(*A.sparsity().get_triplet(), strict=True):
        entries[row][column] = A[row, column]
    product = ca.SX(_parity(columns))
    for k in range(n):
        touching = sorted((row for row in range(n) if row not in order and k in entries[row]), key=lambda r: len(entries[r]))
        if not touching:
            return ca.SX(0)
        first = touching[0]
        for other in touching[1:]:
            top, low = entries[first], entries[other]
            along = top[k] + 1e-100  # far below rounding, for poses at which both entries are zero
            length = ca.sqrt(along**2 + low[k] ** 2)
            c, s = along / length, low[k] / length
            zero, both = ca.SX(0), top.keys() | low.keys()
            entries[first] = {j: c * top.get(j, zero) + s * low.get(j, zero) for j in both}
            entries[other] = {j: c * low.get(j, zero) - s * top.get(j, zero) for j in both - {k}}
        product *= entries[first][k]
        order.append(first)
    return product * _parity(order)


def _minor(A: ca.SX) -> ca.SX:
    """Return det A by expansion along rows, in an order that touches new columns late. Each minor is computed once.

    The minors of the last rows are as many as the ways to use the columns that both these and earlier rows touch.
    """
    entries: list[dict[int, ca.SX]] = [{} for _ in range(A.shape[0])]
    for row, column in zip(*A.sparsity().get_triplet(), strict=True):
        entries[row][column] = A[row, column]
    order = _row_order([set(row) for row in entries])
    touched_below = [set().union(*(entries[row] for row in order[place:])) for place in range(len(order) + 1)]
    known: dict[tuple[int, ...], ca.SX] = {(): ca.SX(1)}

    def below(columns: tuple[int, ...]) -> ca.SX:
        if columns not in known:
            row, total = entries[order[-len(columns)]], ca.SX(0)
            if touched_below[-len(columns) - 1].issuperset(columns):  # a column without entries leaves zero
                for k, column in enumerate(columns):
                    if column in row:
                        term = row[column] * below(columns[:k] + columns[k + 1 :])
                        total = total - term if k % 2 else total + term
            known[columns] = total
        return known[columns]

    return _parity(order) * below(tuple(range(len(order))))


def _row_order(entries: list[set[int]]) -> list[int]:
    """Return an order of rows in which each touches the fewest new columns; of equals, the first."""
    left, touched, order = list(range(len(entries))), set(), []
    while left:
        row = min(left, key=lambda row: len(entries[row] - touched))
        left.remove(row)
        order.append(row)
        touched |= entries[row]
    return order


def _parity(order: list[int]) -> int:
    sign, seen = 1, list(order)
    for k in range(len(seen)):
        while seen[k] != k:
            other = seen[k]
            seen[k], seen[other] = seen[other], seen[k]
            sign = -sign
    return sign
