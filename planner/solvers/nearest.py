"""The feasible point of a program that is nearest to given unknowns, by an interior point method.

It minimises 1/2 (x - x_0)^T W (x - x_0) subject to the program's bounds and rows. The few Newton steps of
`linkplan.planner.solvers.newton.nearest_feasible` hold every bound that a step comes near to. Where efforts and speeds bind
together, no such step exists although a feasible point does; this method lets unknowns leave their bounds.
"""

from dataclasses import replace

import casadi as ca
import numpy as np

from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.solvers.newton import FEASIBLE
from linkplan.planner.solvers.solve import Solution, build_solver, run_solver
from linkplan.planner.transcription.collocation import Transcribed

# The squared costs of a change of states and algebraic unknowns, and of efforts and durations, all scaled. Smaller ones let
# the barrier move unknowns away from their bounds by more than 1e-7; larger ones take twice the iterations.
_STATE_WEIGHT, _EFFORT_WEIGHT = 1e4, 1e6
# At most so many iterations; 15 to 43 find the point.
_MOST_ITERATIONS = 60


def nearest_inside(transcribed: Transcribed, x: np.ndarray, settings: SolverSettings) -> Solution:
    """Return the feasible point near unknowns x (n,), or a solution that has not converged."""
    program, near = transcribed.program, np.clip(x, transcribed.lower, transcribed.upper)
    weight = np.full(len(x), _STATE_WEIGHT)
    weight[program.layout.effort().ravel()] = weight[program.layout.durations()] = _EFFORT_WEIGHT
    nearest = replace(program, functions=_functions(program.functions, ca.DM(near), ca.DM(weight)))
    solver = build_solver(nearest, settings.replace(max_iterations=_MOST_ITERATIONS), close=True)
    found = run_solver(solver, replace(transcribed, program=nearest, start=near))
    objective = float(program.functions["grad_f"](found.x, transcribed.parameters)[0]) * transcribed.objective_scale
    status = FEASIBLE if found.converged else found.status
    own = {"transcribed": transcribed, "objective": objective, "multipliers": None, "bound_multipliers": None}
    return replace(found, status=status, **own)


def _functions(of: dict[str, ca.Function], near: ca.DM, weight: ca.DM) -> dict[str, ca.Function]:
    """Return a program's functions with the weighted squared distance from `near` (n,) as the objective."""
    x, p = ca.MX.sym("x", near.numel()), ca.MX.sym("p", of["nlp"].sparsity_in(1))
    g = of["nlp"](x, p)[1]
    by_f, by_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.sparsity())
    slope = weight * (x - near)
    distance = 0.5 * ca.dot(slope, x - near)
    hessian = of["hess_lag"](x, p, 0.0, by_g) + by_f * ca.diag(weight)
    return {
        "nlp": ca.Function("nlp", [x, p], [distance, g], ["x", "p"], ["f", "g"]),
        "grad_f": ca.Function("grad_f", [x, p], [distance, slope]),
        "jac_g": of["jac_g"],
        "hess_lag": ca.Function("hess_lag", [x, p, by_f, by_g], [hessian]),
    }
