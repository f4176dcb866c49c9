"""Newton's method on a program's optimality conditions, from an optimum to other numbers, all steps by one factorisation.

With the bounds and rows that bind held as equations, the conditions are F(x, lambda) = 0, with

    F = [grad f + J^T lambda;  g - target],   K = F' = [H  J^T;  J  0].

The first step, K d_1 = -F, is the first-order change of unknowns and multipliers with the numbers (Fiacco, Introduction to
Sensitivity and Stability Analysis, 1983); which bounds bind is settled on that linearisation, as in the primal-dual active
set strategy (Hintermueller, Ito & Kunisch, SIAM J. Optim. 13, 2003). Simplified steps follow by the same K. They shrink by
about the same ratio Theta from one to the next, and so what is left after the last one, d, is

    |x - x*|  <=  Theta / (1 - Theta) |d|,   Theta the ratio of the last two,

in the largest of the scaled unknowns and row multipliers, as far as the ratio does not grow (Deuflhard, Newton Methods for
Nonlinear Problems, 2004, section 2.1).
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.program import Program

# How often bounds may come to bind, or cease to, on one linearisation.
_MOST_CHANGES = 8
# A bound is overstepped, or a multiplier has the wrong sign, beyond this: scaled unknowns are of order one.
_SLACK = 1e-9
# Steps that shrink by less than this tell nothing of what is left.
_SLOW = 0.5
# Steps that are smaller than this need no further ones: what is left is a share of them.
_SMALL = 1e-11


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Optimum:
    """Unknowns x (n,) with their multipliers: of rows (n_rows,) and bounds (n,), of f + rows g + bounds x."""

    x: np.ndarray
    rows: np.ndarray
    bounds: np.ndarray


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class NewtonStep:
    """Where Newton steps from an optimum led, and how far that may be from the optimum sought.

    `left` is the largest error of a scaled unknown or row multiplier, as the steps shrink; infinite where that tells
    nothing of it: they do not shrink, or which bounds bind has not settled. `violation` is the most by which a scaled row or
    bound is overstepped, evaluated there; `steps` is how many steps were taken.
    """

    optimum: Optimum
    left: float
    violation: float
    steps: int


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Conditions:
    """A program's optimality conditions as functions of x, p and the rows' multipliers.

    `slopes` gives grad f (n,), g (n_rows,) and K, `gaps` grad f + J^T lambda (n,) and g (n_rows,); `rows` and `columns` are
    the places of K's values, column by column.
    """

    slopes: ca.Function
    gaps: ca.Function
    rows: np.ndarray
    columns: np.ndarray


def conditions_of(program: Program) -> Conditions:
    """Return the optimality conditions of a program."""
    functions, n = program.functions, program.layout.size
    x, p, lam = ca.MX.sym("x", n), ca.MX.sym("p", functions["nlp"].size1_in(1)), ca.MX.sym("lam", program.n_rows)
    (_, gradient), (g, J) = functions["grad_f"](x, p), functions["jac_g"](x, p)
    H = ca.triu2symm(functions["hess_lag"](x, p, 1.0, lam))
    K = ca.blockcat([[H, J.T], [J, ca.MX(program.n_rows, program.n_rows)]])
    return Conditions(
        slopes=ca.Function("slopes", [x, p, lam], [ca.densify(gradient), ca.densify(g), K]),
        gaps=ca.Function("gaps", [x, p, lam], [ca.densify(gradient + J.T @ lam), ca.densify(g)]),
        rows=np.array(K.sparsity().row()),
        columns=np.repeat(np.arange(K.shape[1]), np.diff(K.sparsity().colind())),
    )


def newton_step(conditions: Conditions, last: Transcribed, optimum: Optimum, asked: Transcribed, most: int) -> NewtonStep:
    """Return where Newton steps lead from an optimum to another problem's numbers.

    Args:
        conditions: of the program that both have.
        last: the numbers of the optimum.
        optimum: where to begin.
        asked: the numbers to go to.
        most: how many steps, three at the least; fewer where they become small.
    """
    x, lam, p, n = optimum.x, optimum.rows, asked.parameters, len(optimum.x)
    before = _values(conditions.gaps, x, last.parameters, lam)[1]
    sides = np.concatenate(
        [
            _sides(x, optimum.bounds, last.lower, last.upper, asked.lower, asked.upper),
            _sides(before, lam, last.row_lower, last.row_upper, asked.row_lower, asked.row_upper),
        ]
    )
    lower, upper = np.concatenate([asked.lower, asked.row_lower]), np.concatenate([asked.upper, asked.row_upper])
    gradient, g, K = _values(conditions.slopes, x, p, lam)
    here, settled = np.concatenate([x, g]), False
    for _ in range(_MOST_CHANGES):
        kept = (sides == 0) == (np.arange(len(sides)) < n)  # unknowns that no bound holds, and rows that bind
        to = np.where(sides > 0, upper, lower)
        factors = _factors(conditions, K, kept)
        if factors is None:
            break
        d = np.where((sides != 0) & ~kept, to - here, 0.0)  # unknowns that are bound go where they are bound
        known = np.concatenate([-gradient, to[n:] - g]) - _product(conditions, K, d)
        d[kept] = factors.solve(known[kept])
        moved = _product(conditions, K, d)
        pushes = np.concatenate([np.where(kept[:n], 0.0, -(gradient + moved[:n])), d[n:]])
        there = here + np.concatenate([d[:n], moved[n:]])
        held, sides = sides, _changed(sides, there, pushes, lower, upper)
        if np.array_equal(sides, held):
            settled = True
            break
    if not settled or not np.all(np.isfinite(d)):
        return NewtonStep(optimum=optimum, left=np.inf, violation=_violation(here, lower, upper), steps=0)
    x, rows = x + d[:n], d[n:].copy()
    sizes = [max(np.abs(d[:n]).max(), np.abs(rows - lam).max(initial=0.0))]
    free, binds = kept[:n], kept[n:]
    slope, g = _values(conditions.gaps, x, p, rows)
    while len(sizes) < most and (sizes[-1] > _SMALL or len(sizes) < 2):
        found = factors.solve(np.concatenate([-slope[free], (to[n:] - g)[binds]]))
        x[free] += found[: free.sum()]
        rows[binds] += found[free.sum() :]
        sizes.append(np.abs(found).max(initial=0.0))
        slope, g = _values(conditions.gaps, x, p, rows)
        if not sizes[-1] < sizes[-2]:
            break
    there, pushes = np.concatenate([x, g]), np.concatenate([np.where(free, 0.0, -slope), rows])
    ratio = sizes[-1] / sizes[-2] if sizes[-2] > _SMALL else 0.0
    sure = ratio < _SLOW and np.array_equal(_changed(sides, there, pushes, lower, upper), sides)
    return NewtonStep(
        optimum=Optimum(x=np.clip(x, asked.lower, asked.upper), rows=rows, bounds=pushes[:n]),
        left=float(ratio / (1 - ratio) * sizes[-1]) if sure else np.inf,
        violation=_violation(there, lower, upper),
        steps=len(sizes),
    )


def _values(function: ca.Function, *numbers: np.ndarray) -> list[np.ndarray]:
    """Return the values of a function's outputs, nonzeros where they are sparse; CasADi reads and writes numpy's memory."""
    buffer, evaluate = function.buffer()
    given = [np.ascontiguousarray(a, dtype=float) for a in numbers]
    found = [np.empty(function.nnz_out(k)) for k in range(function.n_out())]
    for put, arrays in ((buffer.set_arg, given), (buffer.set_res, found)):
        for k, array in enumerate(arrays):
            if array.size:
                put(k, memoryview(array))
    evaluate()
    return found


def _product(conditions: Conditions, K: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return K d."""
    return np.bincount(conditions.rows, K * d[conditions.columns], minlength=len(d))


def _factors(conditions: Conditions, K: np.ndarray, kept: np.ndarray):
    """Return the factors of K over some of its rows and columns; None where it is singular there."""
    import scipy.sparse.linalg

    of = kept[conditions.rows] & kept[conditions.columns]
    place, size = np.cumsum(kept) - 1, int(kept.sum())
    begins = np.concatenate([[0], np.cumsum(np.bincount(place[conditions.columns[of]], minlength=size))])
    matrix = scipy.sparse.csc_matrix((K[of], place[conditions.rows[of]], begins), shape=(size, size))
    try:
        return scipy.sparse.linalg.splu(matrix)
    except RuntimeError:
        return None


def _sides(value, multiplier, lower, upper, new_lower, new_upper) -> np.ndarray:
    """Return which bound binds at an optimum: 1 the upper, -1 the lower, 0 none; what is fixed is at its upper."""
    above, below = multiplier > upper - value, -multiplier > value - lower
    return np.where(new_lower == new_upper, 1, np.where(above, 1, np.where(below, -1, 0)))


def _changed(sides: np.ndarray, value: np.ndarray, push: np.ndarray, lower, upper) -> np.ndarray:
    """Return which bounds bind next: those overstepped come in, those that pull in place of pushing leave."""
    kept = np.where(sides * push < -_SLACK, 0, sides)
    come = np.where(value > upper + _SLACK, 1, np.where(value < lower - _SLACK, -1, 0))
    return np.where(lower == upper, sides, np.where(sides == 0, come, kept))


def _violation(value: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    """Return the most by which bounds are overstepped."""
    return float(np.maximum(lower - value, value - upper).max(initial=0.0))
