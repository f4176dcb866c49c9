"""The nearest feasible point of a program: Newton steps on its rows alone, each of least change in the efforts.

A motion that is optimal on one mesh misses the rows of a finer mesh by the error of the first. Optimizing again takes as
many iterations as the first time, and may not end where limits bind all along. Feasibility alone takes three or four
linear systems,

    min 1/2 d^T W d  subject to  J d = target - g,   [W J^T; J 0] [d; lambda] = [0; target - g],

with the binding bounds held (Nocedal and Wright, Numerical Optimization, 2006, section 18.1, the restoration of an SQP
method). W is large for efforts and durations: these change where the motion has to, and the states follow.
"""

import time

import casadi as ca
import numpy as np

from linkplan.planner.solvers.solve import SOLVER_TOLERANCE, Solution
from linkplan.planner.transcription.collocation import Transcribed

# The status of a solution that is feasible, as IPOPT names it; nothing is minimized.
FEASIBLE = "Feasible_Point_Found"
# The squared cost of a change of states and of algebraic unknowns; that of efforts and durations is 1. All are scaled.
_STATE_WEIGHT = 1e-6
# Scaled unknowns and rows within this distance of a bound are held there.
_HELD_DISTANCE = 1e-7


def nearest_feasible(transcribed: Transcribed, x: np.ndarray) -> Solution:
    """Return the feasible point near unknowns x (n,), or a solution that has not converged."""
    begin, program = time.perf_counter(), transcribed.program
    lower = np.concatenate([transcribed.lower, transcribed.row_lower])
    upper = np.concatenate([transcribed.upper, transcribed.row_upper])
    weight = np.full(len(x), _STATE_WEIGHT)
    weight[program.layout.effort().ravel()] = weight[program.layout.durations()] = 1.0
    rows_of, f, n = program.functions["jac_g"], program.functions["grad_f"], len(x)
    x = np.clip(x, transcribed.lower, transcribed.upper)
    fixed, binding, converged, steps = np.zeros(n, dtype=bool), np.zeros(len(lower) - n, dtype=bool), False, 0
    while not converged and steps < 12:  # each step doubles the digits
        g, jacobian = rows_of(x, transcribed.parameters)
        here = np.concatenate([x, np.array(g).ravel()])
        violation = np.maximum(np.maximum(lower - here, here - upper), 0.0)
        if not np.isfinite(violation).all():
            break
        converged = bool(violation.max(initial=0.0) <= SOLVER_TOLERANCE)
        near = (here < lower + _HELD_DISTANCE) | (here > upper - _HELD_DISTANCE)
        fixed, binding = fixed | near[:n], binding | near[n:]
        to = np.clip(here, lower, upper)[n:]
        to = np.where(transcribed.row_lower == transcribed.row_upper, transcribed.row_lower, to)
        step = None if converged else _least_step(jacobian, to - here[n:], weight, fixed, binding)
        if step is None:
            break
        x, steps = np.clip(x + step, transcribed.lower, transcribed.upper), steps + 1
    return Solution(
        transcribed=transcribed,
        x=x,
        objective=float(f(x, transcribed.parameters)[0]) * transcribed.objective_scale,
        converged=converged,
        status=FEASIBLE,
        iterations=steps,
        build_s=0.0,
        solve_s=time.perf_counter() - begin,
    )


def _least_step(
    jacobian: ca.DM, missing: np.ndarray, weight: np.ndarray, fixed: np.ndarray, binding: np.ndarray
) -> np.ndarray | None:
    """Return the step (n,) of least weighted norm that mends the binding rows; None where these contradict each other."""
    import scipy.sparse.linalg

    free = np.flatnonzero(~fixed)
    J = jacobian.tocsc()[binding][:, free]
    corner = scipy.sparse.identity(J.shape[0]) * -1e-13  # rows that say the same twice: of normal equations
    matrix = scipy.sparse.bmat([[scipy.sparse.diags(weight[free]), J.T], [J, corner]], format="csc")
    try:
        found = scipy.sparse.linalg.splu(matrix).solve(np.concatenate([np.zeros(len(free)), missing[binding]]))
    except RuntimeError:
        return None
    step = np.zeros(len(weight))
    step[free] = found[: len(free)]
    return step if np.isfinite(step).all() else None
