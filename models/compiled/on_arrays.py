"""CasADi's functions on numpy's memory: its own matrices take longer to convert than many functions take to evaluate."""

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np


def on_arrays(function: ca.Function, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray]) -> Callable[[], None]:
    """Return a call that evaluates a function from the values in some arrays, and writes its outputs to others.

    Args:
        function: to evaluate.
        inputs: contiguous arrays of floats with the nonzeros of each input, in column order; the call keeps them alive.
        outputs: the same for the first outputs.
    """
    buffer, evaluate = function.buffer()
    for put, arrays in ((buffer.set_arg, inputs), (buffer.set_res, outputs)):
        for k, array in enumerate(arrays):
            if array.size:
                put(k, memoryview(array))  # pyright: ignore[reportCallIssue, reportArgumentType]  a memoryview has its size

    def call(kept: object = (function, buffer, inputs, outputs)) -> None:  # CasADi keeps addresses only
        del kept
        evaluate()

    return call
