"""Newton's method on a program's optimality conditions, from an answer to other numbers: two steps by one factorisation.

With the bounds and rows that bind held as equations, the conditions are F(x, lambda) = 0, with

    F = [grad f + J^T lambda;  g - target],   K = F' = [H  J^T;  J  0].

A Newton step from the last answer, K d_1 = -F, is the first-order change of unknowns and multipliers with the numbers (Fiacco,
Introduction to Sensitivity and Stability Analysis, 1983); which bounds bind is settled on that linearisation, as in the
primal-dual active set strategy (Hintermueller, Ito & Kunisch, SIAM J. Optim. 13, 2003). A simplified step d_2 follows by the
same K. If further ones shrink by no less than Theta = |d_2| / |d_1|, what is left after both is at most

    |x - x*|  <=  Theta / (1 - Theta) |d_2|

(Deuflhard, Newton Methods for Nonlinear Problems, 2004, section 2.1, for simplified Newton steps), in the largest of the scaled
unknowns and row multipliers.
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
# Simplified steps after the first: the ratio of the last two says how fast they shrink.
_CORRECTIONS = 2
# Steps that shrink by less than this tell nothing of what is left.
_SLOW = 0.5


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Optimum:
    """A point with its multipliers: unknowns x (n,), those of rows (n_rows,) and of bounds (n,), of f + rows g + bounds x."""

    x: np.ndarray
    rows: np.ndarray
    bounds: np.ndarray


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class NewtonStep:
    """Where two Newton steps from an optimum led, and how far that may be from the optimum sought.

    `left` is the largest error of a scaled unknown or row multiplier, by the shrinking of the steps; infinite where they tell
    nothing of it: they do not shrink, or which bounds bind has not settled. `violation` is the most by which a scaled row or
    bound is overstepped, evaluated there.
    """

    optimum: Optimum
    left: float
    violation: float


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Conditions:
    """A program's optimality conditions as functions.

    `at` gives, from x, p and rows' multipliers lambda, grad f, g, and the values of J and of the whole H; `rows` and `hessian`
    are their patterns as scipy has them: (row of each value, beginnings of columns).
    """

    at: ca.Function
    rows: tuple[np.ndarray, np.ndarray]
    hessian: tuple[np.ndarray, np.ndarray]


def conditions_of(program: Program) -> Conditions:
    """Return the optimality conditions of a program."""
    functions, n = program.functions, program.layout.size
    x, p, lam = ca.MX.sym("x", n), ca.MX.sym("p", functions["nlp"].size1_in(1)), ca.MX.sym("lam", program.n_rows)
    (_, gradient), (g, J) = functions["grad_f"](x, p), functions["jac_g"](x, p)
    H = ca.triu2symm(functions["hess_lag"](x, p, 1.0, lam))
    at = ca.Function("conditions", [x, p, lam], [ca.densify(gradient), ca.densify(g), J, H])
    rows, hessian = ((np.array(A.row()), np.array(A.colind())) for A in (J.sparsity(), H.sparsity()))
    return Conditions(at=at, rows=rows, hessian=hessian)


def newton_step(conditions: Conditions, last: Transcribed, optimum: Optimum, asked: Transcribed) -> NewtonStep:
    """Return where two Newton steps lead from an optimum to another problem's numbers.

    Args:
        conditions: of the program that both have.
        last: the numbers of the optimum.
        optimum: where to begin.
        asked: the numbers to go to.
    """
    x, lam, p = optimum.x, optimum.rows, asked.parameters
    before = np.array(last.program.functions["nlp"](x, last.parameters)[1]).ravel()
    sides = _sides(x, optimum.bounds, last.lower, last.upper, asked.lower, asked.upper)
    row_sides = _sides(before, lam, last.row_lower, last.row_upper, asked.row_lower, asked.row_upper)
    gradient, g, J, H = _evaluated(conditions, x, p, lam)
    settled, n = False, len(x)
    for _ in range(_MOST_CHANGES):
        free, binds = np.flatnonzero(sides == 0), np.flatnonzero(row_sides)
        factors = _factors(H, J, free, binds)
        if factors is None:
            break
        to, rows_to = (np.where(of > 0, high, low) for of, low, high in _bounds(asked, sides, row_sides))
        d = np.where(sides == 0, 0.0, to - x)  # what binds goes where it is bound
        missing = rows_to[binds] - g[binds] - (J @ d)[binds]
        found = factors.solve(np.concatenate([-(gradient + H @ d)[free], missing]))
        d[free] = found[: len(free)]
        rows = np.zeros(len(lam))
        rows[binds] = found[len(free) :]
        bounds = np.where(sides == 0, 0.0, -(gradient + H @ d + J.T @ rows))
        held = sides, row_sides
        sides = _changed(sides, x + d, bounds, asked.lower, asked.upper)
        row_sides = _changed(row_sides, g + J @ d, rows, asked.row_lower, asked.row_upper)
        settled = np.array_equal(sides, held[0]) and np.array_equal(row_sides, held[1])
        if settled:
            break
    if not settled:
        return NewtonStep(optimum=optimum, left=np.inf, violation=_violation(asked, x))
    x, sizes = x + d, [max(np.abs(d).max(), np.abs(rows - lam).max(initial=0.0))]
    for _ in range(_CORRECTIONS):
        gradient, g, J, _ = _evaluated(conditions, x, p, rows)
        found = factors.solve(np.concatenate([-(gradient + J.T @ rows)[free], rows_to[binds] - g[binds]]))
        x[free] += found[: len(free)]
        rows[binds] += found[len(free) :]
        sizes.append(np.abs(found).max())
    ratio = sizes[-1] / sizes[-2] if sizes[-2] > 0 else 0.0
    return NewtonStep(
        optimum=Optimum(x=np.clip(x, asked.lower, asked.upper), rows=rows, bounds=bounds),
        left=float(ratio / (1 - ratio) * sizes[-1]) if ratio < _SLOW else np.inf,
        violation=_violation(asked, x),
    )


def _evaluated(conditions: Conditions, *numbers: np.ndarray):
    """Return grad f, g, J and H; the latter as scipy's."""
    import scipy.sparse

    at = conditions.at
    buffer, evaluate = at.buffer()
    given, found = [np.ascontiguousarray(a, dtype=float) for a in numbers], [np.empty(at.nnz_out(k)) for k in range(4)]
    for put, arrays in ((buffer.set_arg, given), (buffer.set_res, found)):
        for k, array in enumerate(arrays):
            if array.size:
                put(k, memoryview(array))
    evaluate()
    gradient, g, J, H = found
    matrices = ((J, conditions.rows, len(g)), (H, conditions.hessian, len(gradient)))
    shaped = [scipy.sparse.csc_matrix((values, *of), shape=(rows, len(gradient))) for values, of, rows in matrices]
    return gradient, g, *shaped


def _factors(H, J, free: np.ndarray, binds: np.ndarray):
    """Return the factors of K over what is free and what binds; None where it is singular."""
    import scipy.sparse
    import scipy.sparse.linalg

    held = J[binds][:, free]
    K = scipy.sparse.bmat([[H[free][:, free], held.T], [held, None]], format="csc")
    try:
        return scipy.sparse.linalg.splu(K)
    except RuntimeError:
        return None


def _bounds(asked: Transcribed, sides: np.ndarray, row_sides: np.ndarray):
    return (sides, asked.lower, asked.upper), (row_sides, asked.row_lower, asked.row_upper)


def _sides(value, multiplier, lower, upper, new_lower, new_upper) -> np.ndarray:
    """Return which bound binds at an optimum: 1 the upper, -1 the lower, 0 none; what is fixed is at its upper."""
    above, below = multiplier > upper - value, -multiplier > value - lower
    return np.where(new_lower == new_upper, 1, np.where(above, 1, np.where(below, -1, 0)))


def _changed(sides: np.ndarray, value: np.ndarray, multiplier: np.ndarray, lower, upper) -> np.ndarray:
    """Return which bounds bind next: those overstepped come in, those that pull in place of pushing leave."""
    kept = np.where(sides * multiplier < -_SLACK, 0, sides)
    come = np.where(value > upper + _SLACK, 1, np.where(value < lower - _SLACK, -1, 0))
    return np.where(lower == upper, sides, np.where(sides == 0, come, kept))


def _violation(asked: Transcribed, x: np.ndarray) -> float:
    """Return the most by which a scaled row or bound is overstepped at x."""
    g = np.array(asked.program.functions["nlp"](x, asked.parameters)[1]).ravel()
    pairs = ((x, asked.lower, asked.upper), (g, asked.row_lower, asked.row_upper))
    return max(float(np.maximum(low - value, value - high).max(initial=0.0)) for value, low, high in pairs)
