"""The slopes of an optimal objective by the parameters of the mechanism, from the multipliers of the solved program.

At an optimum of min f(x, p) with rows g(x, p) between bounds that do not depend on p, the envelope theorem gives

    dJ/dp = d_p f + lam^T d_p g

(Fiacco, Introduction to Sensitivity and Stability Analysis in Nonlinear Programming, 1983, ch. 3). The parameters of a
mechanism stand in the equations, path quantities and costs of the program's nodes only. Where a limit is just reached, the
slope differs on both sides; a multiplier of an active limit near zero shows it.
"""

import functools

import casadi as ca
import numpy as np

from linkplan.models.compiled.functions import over_columns
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.implicit import Implicit
from linkplan.planner.transcription.program import gather
from linkplan.planner.transcription.system import System


def parameter_slopes(solution: Solution) -> np.ndarray:
    """Return the slopes (n,) of an optimum's objective by the n parameters of its program's mechanism [SI].

    Args:
        solution: a converged one, with multipliers.
    """
    transcribed, x, mechanism = solution.transcribed, solution.x, solution.transcribed.origin.mechanism
    assert solution.multipliers is not None
    program, interval = transcribed.program, transcribed.program.interval
    mesh, n, m, n_open = program.mesh, program.mesh.n_intervals, interval.n_nodes, interval.n_open_ends
    system = transcribed.formulation.build_system()
    n_xi, n_f = system.n_xi, interval.n_equations + interval.n_path
    n_eta, n_theta = interval.chain.own.size1_in(2), interval.node.node_value.size1_in(1)
    numbers = transcribed.parameters[: n * (1 + n_eta + (m + n_open) * n_theta)].reshape(n, -1)
    share, theta = numbers[:, 0], numbers[:, 1 + n_eta :].reshape(n, m + n_open, n_theta)
    points = over_columns(interval.chain.nodes, lanes=interval.chain.lanes, n=n)
    points = np.array(points(ca.DM(x[gather(program.layout, mesh)].T), ca.DM(share[None]))).T.reshape(n, m + n_open, n_xi)
    lam = solution.multipliers[: n * interval.n_rows].reshape(n, -1)[:, interval.n_own :]
    at_nodes, of_ends = lam[:, : m * n_f].reshape(n, m, n_f), list(interval.node.open_end_rows)
    running = share[:, None] * x[program.layout.durations()][mesh.segment][:, None] * interval.weights
    weights = np.zeros((n, m + n_open, n_f + 1))
    weights[:, :m, :n_f], weights[:, :m, n_f] = at_nodes, running
    weights[:, m:, of_ends] = lam[:, m * n_f :].reshape(n, n_open, len(of_ends))
    # The forces over time come last among a node's parameters, after those of the mechanism.
    last = system.n_theta - (0 if mechanism.forces is None else 3 * len(mechanism.forces.sites))
    slope = _slopes(system, last - len(mechanism.parameters), last)
    columns = [one.reshape(n * (m + n_open), -1).T for one in (points, theta[:, :, : system.n_theta], weights)]
    each = np.array(slope.map(columns[0].shape[1])(*columns))
    return transcribed.objective_scale * each.sum(axis=1)


@functools.lru_cache(maxsize=4)
def _slopes(system: System, first: int, stop: int) -> ca.Function:
    """Return the function from a node, its parameters and weights of rows and cost to their slopes in some parameters."""
    xi, theta = ca.SX.sym("xi", system.n_xi), ca.SX.sym("theta", system.n_theta)
    y, n_rows = ca.SX.sym("y", sum(system.eliminated)), system.n_equations + system.n_path
    lam = ca.SX.sym("lam", n_rows + 1)
    column = system.node(ca.vertcat(xi, y), theta)
    implicit = Implicit(ca.vertcat(xi, theta), y, column[n_rows + 1 :], system.eliminated)
    slopes = implicit.jacobian(ca.dot(lam, column[: n_rows + 1]))[:, system.n_xi + first : system.n_xi + stop]
    return ca.Function("slopes", [xi, theta, lam], implicit.inserted([ca.densify(slopes.T)]))
