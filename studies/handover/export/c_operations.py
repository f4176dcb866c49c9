"""The cost of a CasADi function: its operations by kind, and the error of its evaluation in single precision.

The function's instructions are executed one by one on arrays of float32, so no compiler is needed.
"""

from collections import Counter
from collections.abc import Callable

import casadi as ca
import numpy as np

_BINARY: dict[int, Callable] = {
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_FMIN: np.minimum,
    ca.OP_FMAX: np.maximum,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_HYPOT: np.hypot,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_LT: np.less,
    ca.OP_LE: np.less_equal,
    ca.OP_EQ: np.equal,
    ca.OP_NE: np.not_equal,
    ca.OP_AND: np.logical_and,
    ca.OP_OR: np.logical_or,
    ca.OP_IF_ELSE_ZERO: lambda condition, x: np.where(condition != 0, x, np.float32(0)),
}
_UNARY: dict[int, Callable] = {
    ca.OP_ASSIGN: np.array,
    ca.OP_NEG: np.negative,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda x: x + x,
    ca.OP_INV: lambda x: np.float32(1) / x,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_TANH: np.tanh,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_NOT: np.logical_not,
}
_KINDS = {
    ca.OP_ADD: "additions", ca.OP_SUB: "additions", ca.OP_NEG: "additions", ca.OP_TWICE: "additions",
    ca.OP_MUL: "multiplications", ca.OP_SQ: "multiplications", ca.OP_DIV: "divisions", ca.OP_INV: "divisions",
    ca.OP_SQRT: "square roots", ca.OP_SIN: "sines and cosines", ca.OP_COS: "sines and cosines",
}  # fmt: skip
_MOVES = (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_ASSIGN)


def operations(function: ca.Function) -> dict[str, int]:
    """Return the number of operations by kind."""
    ids = [function.instruction_id(k) for k in range(function.n_instructions())]
    return dict(Counter(_KINDS.get(op, "other") for op in ids if op not in _MOVES))


def in_single_precision(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    """Return the outputs (n, numel) of a function over samples (n, numel) in float32, operation by operation."""
    given = [np.asarray(a, dtype=np.float32) for a in arguments]
    n = len(given[0])
    work: list = [None] * function.sz_w()
    found = [np.zeros((n, function.numel_out(k)), dtype=np.float32) for k in range(function.n_out())]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for k in range(function.n_instructions()):
            op, into, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
            if op == ca.OP_CONST:
                work[into[0]] = np.full(n, function.instruction_constant(k), dtype=np.float32)
            elif op == ca.OP_INPUT:
                work[into[0]] = given[of[0]][:, of[1]]
            elif op == ca.OP_OUTPUT:
                found[into[0]][:, into[1]] = work[of[0]]
            elif op in _UNARY:
                work[into[0]] = _UNARY[op](work[of[0]]).astype(np.float32)
            else:
                work[into[0]] = _BINARY[op](work[of[0]], work[of[1]]).astype(np.float32)
    return found
