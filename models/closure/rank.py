"""Rank, independent rows and dependent columns of a closure's Jacobian by pivoted factorisation, never by counting.

A planar loop closed by a connect has three rows and rank 2, and repeated pins add rows without rank (Golub & Van Loan,
Matrix Computations, 5.4.2). The choice of rows uses several closed poses, because one pose may be special.
"""

from collections.abc import Iterable, Sequence

import numpy as np

# Singular values below this share of the largest count as zero. An exact planar loop has 1e-16; a pose a millionth of a link
# length from a singular pose has 1e-6.
RANK_TOLERANCE = 1e-9
# Singular values between RANK_TOLERANCE and this share are often due to rounding of the file (axes not quite parallel).
WEAK_SHARE = 1e-4
# Values below this share of the largest one are zero to rounding of the arithmetic,
ROUNDING_SHARE = 1e-9
# and to rounding of the numbers in a file, which often have seven digits.
FILE_ROUNDING_SHARE = 1e-6


def blocks(pattern: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the rows and columns of the diagonal blocks of a matrix with nonzeros `pattern` (m, n), without zero columns.

    Columns that share a row are of one block; in a closure's Jacobian these are the joints of loops that share joints.
    """
    of, last = np.arange(pattern.shape[1]), None
    while last is None or np.any(of != last):  # each column takes the least number among those that it shares a row with
        last, by_row = of, np.where(pattern, of, len(of)).min(axis=1, initial=len(of))
        of = np.minimum(of, np.where(pattern, by_row[:, None], len(of)).min(axis=0, initial=len(of)))
    columns = [np.flatnonzero(of == block) for block in np.unique(of[pattern.any(axis=0)])]
    return [(np.flatnonzero(pattern[:, block].any(axis=1)), block) for block in columns]


def shares(jacobian: np.ndarray) -> np.ndarray:
    """Return the singular values of a matrix as shares of the largest, in descending order."""
    values = np.zeros(min(jacobian.shape))
    found = [np.linalg.svd(jacobian[np.ix_(*block)], compute_uv=False) for block in blocks(jacobian != 0)]
    known = np.sort(np.concatenate([[], *found]))[::-1]
    values[: len(known)] = known
    return values / values.max(initial=np.finfo(float).tiny)


def numerical_rank(jacobian: np.ndarray, tolerance: float = RANK_TOLERANCE) -> int:
    """Return the rank of a matrix. Singular values below `tolerance` times the largest count as zero."""
    return int(np.sum(shares(jacobian) > tolerance))


def weak_rank(jacobian: np.ndarray, tolerance: float = RANK_TOLERANCE) -> int:
    """Return the number of singular values between `tolerance` and WEAK_SHARE times the largest."""
    found = shares(jacobian)
    return int(np.sum((found > tolerance) & (found < WEAK_SHARE)))


def independent_rows(jacobians: Sequence[np.ndarray], rank: int, tolerance: float = RANK_TOLERANCE) -> np.ndarray:
    """Return the indices (rank,) of rows that span the row space at every pose, in file order.

    Args:
        jacobians: at several closed poses, (n_rows, n_q) each. If no rows chosen from all poses span every row space, the
            rows are chosen from the first pose.
        rank: of each Jacobian.
        tolerance: of the rank.
    """
    if rank == 0:
        return np.zeros(0, dtype=int)
    for stack in (np.hstack(jacobians), jacobians[0]):
        rows = np.sort(_pivots(stack.T, range(len(stack)), rank, 0.0)[1])
        if all(numerical_rank(jacobian[rows], tolerance) == rank for jacobian in jacobians):
            break
    return rows


def dependent_columns(jacobian: np.ndarray, rank: int, groups: Sequence[Sequence[int]]) -> np.ndarray:
    """Return the dependent columns (rank,): a well-conditioned set with columns from the earliest possible groups.

    The method is Gram-Schmidt with pivoting over the columns of each group in turn. The joints of the last groups (actuated
    and named ones) therefore stay independent if the other columns have full rank.
    """
    work = np.array(jacobian, dtype=float)
    floor = RANK_TOLERANCE * max(np.linalg.norm(work, axis=0).max(initial=0.0), np.finfo(float).tiny)
    chosen: list[int] = []
    for group in groups:
        work, more = _pivots(work, group, rank - len(chosen), floor)
        chosen += more
    return np.array(sorted(chosen), dtype=int)


def _pivots(matrix: np.ndarray, columns: Iterable[int], most: int, floor: float) -> tuple[np.ndarray, list[int]]:
    """Return the chosen columns and the matrix without its components along them.

    Each step chooses the longest remaining column, until `most` are chosen or none is longer than `floor`.
    """
    work, candidates, chosen = np.array(matrix, dtype=float), list(columns), []
    while candidates and len(chosen) < most:
        norms = np.linalg.norm(work[:, candidates], axis=0)
        best = int(np.argmax(norms))
        if norms[best] <= floor:
            break
        chosen.append(candidates.pop(best))
        direction = work[:, chosen[-1]] / norms[best]
        work -= np.outer(direction, direction @ work)
    return work, chosen
