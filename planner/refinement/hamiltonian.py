"""How much a finer mesh would gain: the distance of the efforts from the minimum of the Hamiltonian.

By Pontryagin's principle, the efforts of an optimal motion minimise the Hamiltonian within their limits at every instant.
Those of a mesh are polynomials on its intervals, so they cannot jump inside one. At the nodes of Radau's collocation, the
multipliers of the dynamics are the costates times the quadrature's weights and the interval's width (Garg et al.,
Automatica 46, 2010). The distance of the Hamiltonian from its minimum, integrated over an interval, is what the interval
loses, to first order, if the dynamics are exact.
"""

import casadi as ca
import numpy as np

from linkplan.planner.solvers.solve import Solution

# The costs for which the minimum of the Hamiltonian is known: it is linear or quadratic in the efforts.
COSTS_OF_HAMILTONIAN = frozenset({"time", "effort"})


def hamiltonian_gaps(solution: Solution) -> np.ndarray:
    """Return what the intervals (n,) lose by efforts that do not minimise the Hamiltonian, in the objective's unit.

    Of all limits only those on efforts are considered. Where others are active, the loss is overestimated.

    Args:
        solution: has multipliers; its costs are among `COSTS_OF_HAMILTONIAN`.
    """
    transcribed, x = solution.transcribed, solution.x
    program, formulation, effort_at = transcribed.program, transcribed.formulation, transcribed.scheme.effort_at
    interval, mesh, places = program.interval, program.mesh, program.layout.effort()
    n, m, n_u = mesh.n_intervals, interval.n_nodes, places.shape[2]
    jacobian = program.functions["jac_g"](x, transcribed.parameters)[1]
    begins = interval.n_rows * np.arange(n)[:, None] + interval.n_own
    slope = np.empty((n, m, n_u))  # of the Hamiltonian in the efforts at the nodes, times weight and width
    for k, c in enumerate(np.abs(effort_at).argmax(axis=1)):
        equations = begins + k * (interval.n_equations + interval.n_path) + np.arange(interval.n_equations)
        multipliers = np.zeros(program.n_rows)
        multipliers[equations] = solution.multipliers[equations]
        product = np.array(ca.mtimes(jacobian.T, ca.DM(multipliers))).ravel()
        slope[:, k] = product[places[:, c]] / effort_at[k, c]
    weights, costs = np.zeros(n_u), formulation.rows.costs
    if "effort" in costs:
        first = sum(1 if cost == "time" else n_u for cost in costs[: costs.index("effort")])
        weights = formulation.eta[first : first + n_u]
    width = mesh.fraction * x[program.layout.durations()][mesh.segment]
    bend = width[:, None, None] * interval.weights[:, None] * weights
    low, high = transcribed.lower[places].max(axis=1)[:, None], transcribed.upper[places].min(axis=1)[:, None]
    effort = np.einsum("kj,njs->nks", effort_at, x[places])
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.where(bend > 0, np.clip(-0.5 * slope / bend, low, high), np.where(slope > 0, low, high))
    lost = (slope + bend * effort) * effort - (slope + bend * least) * least
    return transcribed.objective_scale * lost.sum(axis=(1, 2))
