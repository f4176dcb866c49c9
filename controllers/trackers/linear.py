"""Small products and sums in which each row is independent of the other rows, to the last bit."""

import numpy as np


def times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return M x (..., p) of M (..., p, m) and x (..., m), summed over m from the first column to the last.

    BLAS chooses its kernels, and so the order of summation, by the size of the batch, which changes the last bit.
    """
    total = matrix[..., 0] * vector[..., :1]
    for j in range(1, vector.shape[-1]):
        total = total + matrix[..., j] * vector[..., j : j + 1]
    return total


def added(terms: np.ndarray) -> np.ndarray:
    """Return the sums (...,) of terms (..., m) in order from the first to the last."""
    total = terms[..., 0]
    for j in range(1, terms.shape[-1]):
        total = total + terms[..., j]
    return total
