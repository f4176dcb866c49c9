"""The optimum of a program with changed numbers, from a known optimum; the feasible point nearest to given unknowns.

Newton steps on the optimality conditions lead from the known optimum to the new one, all with one factorisation.

With the active bounds and rows as equations, the conditions are F(x, lambda) = 0, with

    F = [grad f + J^T lambda;  g - target],   K = F' = [H  J^T;  J  0].

The first step, K d_1 = -F, is the first-order sensitivity of unknowns and multipliers to the numbers (Fiacco, Introduction
to Sensitivity and Stability Analysis, 1983). The active bounds are found for this linearisation, as in the primal-dual
active set strategy (Hintermueller, Ito & Kunisch, SIAM J. Optim. 13, 2003). Simplified steps follow with the same K. They
shrink by about the same ratio Theta, so the error after the last step d is bounded by

    |x - x*|  <=  Theta / (1 - Theta) |d|,   Theta the ratio of the last two steps,

in the largest scaled unknown or row multiplier, if the ratio does not grow (Deuflhard, Newton Methods for Nonlinear
Problems, 2004, section 2.1).

A motion that is optimal on one mesh violates the rows of a finer mesh by the error of the first mesh. Optimizing again takes
as many iterations as the first time, and may not converge if limits are active all along. Feasibility alone takes one to
three quadratic programs of least change in the efforts (`nearest_feasible`),

    min w grad f d + 1/2 d^T W d  subject to  lower <= (x + d, g + J d) <= upper

(Nocedal and Wright, Numerical Optimization, 2006, section 18.1: the restoration of an SQP method). W is small for states and
w for efforts and durations, so these change as little as possible. The gradient of the objective keeps active limits active
(as in an SQP step); it counts in the first program only, since the others remove errors of linearisation. If only a few
intervals violate their rows, only unknowns near them are free. PIQP solves the
programs: its proximal terms permit redundant rows (Schwan, Jiang, Kuhn and Jones, PIQP: a proximal interior-point quadratic
programming solver, 2023).
"""

import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.compiled.functions import on_arrays
from linkplan.models.deadline import NO_DEADLINE, Deadline, one_thread_at_a_time
from linkplan.planner.solvers.solve import SOLVER_TOLERANCE, Solution
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.program import Program

# Tolerance on bounds and on signs of multipliers; scaled unknowns are of order one.
_BOUND_SLACK = 1e-9
# Newton steps below this end the iteration.
_NEGLIGIBLE_STEP = 1e-11
# IPOPT's name for the status of a feasible point that is not an optimum.
FEASIBLE = "Feasible_Point_Found"
# The weights of squared scaled changes: small for states and algebraic unknowns, large for efforts and durations. With
# weights of 1e-6 and 1, the solver of quadratic programs does not converge if limits on jerk are active all along.
_COST_OF_STATES, _COST_OF_EFFORTS = 1e-2, 1e4
# Largest number of quadratic programs to the nearest feasible point; motions of 2 to 10 motors take up to 3.
_MOST_PROGRAMS = 12
# With these costs, rounding keeps dual residuals near 1e-10 in programs of 30,000 unknowns, however many iterations follow.
# They reach 1e-9 after 43 iterations; rows then hold within 1e-12.
_PIQP = {"eps_abs": 1e-9, "eps_rel": 0.0, "max_iter": 100, "verbose": False}
# The last program may leave this violation of nonlinear equations. The certificate measures efforts to 2e-6.
EQUATION_TOLERANCE = 1e-8
# If only a few intervals violate their rows, only their unknowns and those of this number of intervals on each side are
# changed, because the influence of a change decays along the motion. If more than this share of the violation remains, all
# unknowns are changed.
# Second corrections of meshes of 170 to 300 intervals take 0.2 to 0.5 of the time.
NEAR_INTERVALS, _LOCAL_GAIN = 3, 0.5
# The programs diverge if the violation exceeds this factor times the larger of the first and a small violation.
_DIVERGED_FACTOR, _SMALL_VIOLATION = 10.0, 1e-3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Optimum:
    """Unknowns x (n,) and multipliers of rows (n_rows,) and bounds (n,), for f + rows g + bounds x."""

    x: np.ndarray
    rows: np.ndarray
    bounds: np.ndarray


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class NewtonStep:
    """The result of Newton steps from an optimum, with an error bound.

    `error_bound` bounds the error of every scaled unknown and row multiplier; it is infinite if the steps do not shrink or
    the active bounds do not settle. `violation` is the largest violation of a scaled row or bound at the result. `steps` is
    the number of steps.
    """

    optimum: Optimum
    error_bound: float
    violation: float
    steps: int


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Conditions:
    """A program's optimality conditions as functions of x, p and the rows' multipliers.

    `slopes` gives grad f (n,), g (n_rows,) and K; `gaps` gives grad f + J^T lambda (n,) and g (n_rows,). `rows` and
    `columns` are the indices of K's nonzeros, column by column.
    """

    slopes: ca.Function
    gaps: ca.Function
    rows: np.ndarray
    columns: np.ndarray


@one_thread_at_a_time
def conditions_of(program: Program) -> Conditions:
    """Return the optimality conditions of a program."""
    functions, n = program.functions, program.layout.size
    x, p, lam = ca.MX.sym("x", n), ca.MX.sym("p", functions["nlp"].size1_in(1)), ca.MX.sym("lam", program.n_rows)
    (_, gradient), (g, J) = functions["grad_f"](x, p), functions["jac_g"](x, p)
    H = ca.triu2symm(program.hess_lag()(x, p, 1.0, lam))
    K = ca.blockcat([[H, J.T], [J, ca.MX(program.n_rows, program.n_rows)]])
    return Conditions(
        slopes=ca.Function("slopes", [x, p, lam], [ca.densify(gradient), ca.densify(g), K]),
        gaps=ca.Function("gaps", [x, p, lam], [ca.densify(gradient + J.T @ lam), ca.densify(g)]),
        rows=np.array(K.sparsity().row()),
        columns=np.repeat(np.arange(K.shape[1]), np.diff(K.sparsity().colind())),
    )


def newton_step(conditions: Conditions, last: Transcribed, optimum: Optimum, asked: Transcribed, most: int) -> NewtonStep:
    """Return the result of Newton steps from an optimum to another problem's numbers.

    Args:
        conditions: of the program of both problems.
        last: the numbers of the optimum.
        optimum: the starting point.
        asked: the new numbers.
        most: the largest number of steps, at least three; negligible steps end the iteration earlier.
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
    for _ in range(8):  # at most eight changes of the active bounds for one linearisation
        kept = (sides == 0) == (np.arange(len(sides)) < n)  # free unknowns and active rows
        to = np.where(sides > 0, upper, lower)
        factors = _factors(conditions, K, kept)
        if factors is None:
            break
        d = np.where((sides != 0) & ~kept, to - here, 0.0)  # fixed unknowns move to their bounds
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
        return NewtonStep(optimum=optimum, error_bound=np.inf, violation=_violation(here, lower, upper), steps=0)
    x, rows = x + d[:n], d[n:].copy()
    sizes = [max(np.abs(d[:n]).max(), np.abs(rows - lam).max(initial=0.0))]
    free, binds = kept[:n], kept[n:]
    slope, g = _values(conditions.gaps, x, p, rows)
    while len(sizes) < most and (sizes[-1] > _NEGLIGIBLE_STEP or len(sizes) < 2):
        found = factors.solve(np.concatenate([-slope[free], (to[n:] - g)[binds]]))
        x[free] += found[: free.sum()]
        rows[binds] += found[free.sum() :]
        sizes.append(np.abs(found).max(initial=0.0))
        slope, g = _values(conditions.gaps, x, p, rows)
        if not sizes[-1] < sizes[-2]:
            break
    there, pushes = np.concatenate([x, g]), np.concatenate([np.where(free, 0.0, -slope), rows])
    ratio = sizes[-1] / sizes[-2] if sizes[-2] > _NEGLIGIBLE_STEP else 0.0
    # Steps that shrink by less than a factor of two give no reliable bound.
    sure = ratio < 0.5 and np.array_equal(_changed(sides, there, pushes, lower, upper), sides)
    return NewtonStep(
        optimum=Optimum(x=np.clip(x, asked.lower, asked.upper), rows=rows, bounds=pushes[:n]),
        error_bound=float(ratio / (1 - ratio) * sizes[-1]) if sure else np.inf,
        violation=_violation(there, lower, upper),
        steps=len(sizes),
    )


def _values(function: ca.Function, *numbers: np.ndarray) -> list[np.ndarray]:
    """Return the values of a function's outputs, nonzeros if they are sparse."""
    given = [np.ascontiguousarray(a, dtype=float) for a in numbers]
    found = [np.empty(function.nnz_out(k)) for k in range(function.n_out())]
    on_arrays(function, given, found)()
    return found


def _product(conditions: Conditions, K: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return K d."""
    return np.bincount(conditions.rows, K * d[conditions.columns], minlength=len(d))


def _factors(conditions: Conditions, K: np.ndarray, kept: np.ndarray):
    """Return the factors of the submatrix of K with the kept rows and columns; None if it is singular."""
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
    """Return the active bounds at an optimum: 1 upper, -1 lower, 0 none; for fixed values the upper."""
    above, below = multiplier > upper - value, -multiplier > value - lower
    return np.where(new_lower == new_upper, 1, np.where(above, 1, np.where(below, -1, 0)))


def _changed(sides: np.ndarray, value: np.ndarray, push: np.ndarray, lower, upper) -> np.ndarray:
    """Return the next active bounds: violated bounds become active, bounds with multipliers of the wrong sign inactive."""
    kept = np.where(sides * push < -_BOUND_SLACK, 0, sides)
    come = np.where(value > upper + _BOUND_SLACK, 1, np.where(value < lower - _BOUND_SLACK, -1, 0))
    return np.where(lower == upper, sides, np.where(sides == 0, come, kept))


def _violation(value: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    """Return the largest violation of bounds."""
    return float(np.maximum(lower - value, value - upper).max(initial=0.0))


def nearest_feasible(transcribed: Transcribed, x: np.ndarray, deadline: Deadline = NO_DEADLINE) -> Solution:
    """Return a feasible point near the unknowns x (n,), of about the same cost; if none is found, `converged` is False."""
    begin, program, p, n = time.perf_counter(), transcribed.program, transcribed.parameters, len(x)
    lower = np.concatenate([transcribed.lower, transcribed.row_lower])
    upper = np.concatenate([transcribed.upper, transcribed.row_upper])
    tolerance = np.where(lower == upper, EQUATION_TOLERANCE, SOLVER_TOLERANCE)
    durations, cost = program.layout.durations(), np.full(n, _COST_OF_STATES)
    cost[program.layout.effort().ravel()] = cost[durations] = _COST_OF_EFFORTS
    x, steps = np.clip(x, transcribed.lower, transcribed.upper), 0
    near, everywhere = np.zeros(n, dtype=bool), np.ones(n, dtype=bool)
    here, jacobian = _linearised(program, x, p)
    pattern = jacobian.sparsity()
    places = np.array(pattern.row()), np.repeat(np.arange(n), np.diff(pattern.colind()))
    violation = _violation(here, lower, upper)
    largest = _DIVERGED_FACTOR * max(violation, _SMALL_VIOLATION)
    while _violation(here, lower - tolerance, upper + tolerance) > 0 and violation <= largest:
        if steps == _MOST_PROGRAMS or deadline.passed:
            break
        # Without the gradient, least times with pin forces are up to 5e-4 longer, least efforts of an excavator 5e-4 larger.
        slope = np.zeros(n) if steps else _COST_OF_EFFORTS * np.array(program.functions["grad_f"](x, p)[1]).ravel()
        wrong = ((here < lower - tolerance) | (here > upper + tolerance))[n:]
        near |= _near(places, wrong, n, durations)
        for free in (near, everywhere):
            change = _least_change(cost, slope, jacobian, places, lower - here, upper - here, free)
            there = np.clip(x + change, transcribed.lower, transcribed.upper)
            here_then, jacobian_then = _linearised(program, there, p)
            if np.all(free) or _violation(here_then, lower, upper) < _LOCAL_GAIN * violation:
                break
        x, here, jacobian, steps = there, here_then, jacobian_then, steps + 1
        violation = _violation(here, lower, upper)
    return Solution(
        transcribed=transcribed,
        x=x,
        objective=float(program.functions["grad_f"](x, p)[0]) * transcribed.objective_scale,
        converged=_violation(here, lower - tolerance, upper + tolerance) == 0,
        status=FEASIBLE,
        iterations=steps,
        build_s=0.0,
        solve_s=time.perf_counter() - begin,
    )


def _linearised(program: Program, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ca.DM]:
    """Return unknowns and rows (n + n_rows,), and the rows' Jacobian."""
    g, jacobian = program.functions["jac_g"](x, p)
    return np.concatenate([x, np.array(g).ravel()]), jacobian


def _near(places: tuple[np.ndarray, np.ndarray], wrong: np.ndarray, n: int, durations: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of the unknowns in the intervals of wrong rows (n_rows,) and near them, without durations.

    If half of the unknowns or more are near, the mask has all of them. `places` are the row and the column of each nonzero
    of the rows' Jacobian.
    """
    (rows, columns), near, touched = places, np.zeros(n, dtype=bool), wrong.copy()
    for _ in range(1 + NEAR_INTERVALS):
        near[columns[touched[rows]]] = True
        near[durations] = False
        touched[rows[near[columns]]] = True
    return near if near.sum() < 0.5 * len(near) else np.ones(len(near), dtype=bool)


def _least_change(
    cost: np.ndarray,
    slope: np.ndarray,
    jacobian: ca.DM,
    places: tuple[np.ndarray, np.ndarray],
    lower: np.ndarray,
    upper: np.ndarray,
    free: np.ndarray,
) -> np.ndarray:
    """Return the change (n,) of the quadratic program in which only the unknowns of a mask (n,) are free.

    The solver's own status is ignored: the violation at the next point decides.

    Args:
        cost: of squared changes (n,).
        slope: of the objective (n,).
        jacobian: of the rows.
        places: the row and the column of each of its nonzeros.
        lower: bounds on the changes of unknowns and rows (n + n_rows,).
        upper: likewise.
        free: the mask.
    """
    n, (rows, columns) = len(free), places
    limited = np.isfinite(lower[n:]) | np.isfinite(upper[n:])
    limited &= np.bincount(rows, free[columns], len(limited)) > 0
    h = ca.diag(ca.DM(cost[free]))
    a = jacobian[np.flatnonzero(limited).tolist(), np.flatnonzero(free).tolist()]
    options = {"piqp": _PIQP, "error_on_fail": False}
    step = ca.conic("step", "piqp", {"h": h.sparsity(), "a": a.sparsity()}, options)
    (low, low_rows), (high, high_rows) = ((of[:n][free], of[n:][limited]) for of in (lower, upper))
    found = step(h=h, g=slope[free], a=a, lbx=low, ubx=high, lba=low_rows, uba=high_rows)
    change = np.zeros(n)
    change[free] = np.array(found["x"]).ravel()
    return change
