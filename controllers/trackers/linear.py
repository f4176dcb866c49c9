"""Small products whose every row is the same to the last bit whatever stands in the rows beside it."""

import numpy as np


def times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return M x (..., p) of M (..., p, m) and x (..., m), summed over m from the first column to the last.

    BLAS picks its kernels, and so the order of its sums, by the size of the batch: results would differ in the last bit.
    """
    total = matrix[..., 0] * vector[..., :1]
    for j in range(1, vector.shape[-1]):
        total = total + matrix[..., j] * vector[..., j : j + 1]
    return total


def added(terms: np.ndarray) -> np.ndarray:
    """Return the sums (...,) of terms (..., m), from the first to the last."""
    total = terms[..., 0]
    for j in range(1, terms.shape[-1]):
        total = total + terms[..., j]
    return total
