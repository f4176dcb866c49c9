"""The differential equation integrated under a solution's efforts, against the solution.

Every interval is integrated from the planned state, together with its transition matrix, and its defect is propagated along
the motion to first order, with restarts as along mechanisms' motions (`linkplan.planner.certificate.integration`).
"""

import functools
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.planner.certificate.flow import INTEGRATION_RTOL, side_by_side
from linkplan.planner.certificate.integration import RESTART_GROWTH, propagated, relative_violation, scaled_defects
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.transcription.bernstein import bernstein_value


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class IntegratedOde:
    """The integrated motion beside a solution.

    `errors` (n, n_x) are its distances at the intervals' ends, as shares of each state's size; `defects` (n, n_x) what each
    interval adds to them; `cost` (n,) what it adds to the running cost; `beyond` (n,) how far the integrated state leaves
    its limits within it, as a share of its size; `end` (n_x,) is the last state; `restarts` counts the restarts.
    """

    errors: np.ndarray
    defects: np.ndarray
    cost: np.ndarray
    beyond: np.ndarray
    end: np.ndarray
    restarts: int = 0


def integrate(problem: OdeProblem, trajectory: OdeTrajectory, size: np.ndarray, points: np.ndarray) -> IntegratedOde:
    """Return the integrated motion beside a solution; infinite where an interval cannot be integrated.

    Args:
        problem: what was asked.
        trajectory: the solution.
        size: (n_x,) of the states.
        points: shares (m,) of an interval at which limits are looked at, the last of them 1.
    """
    n_x, breaks, effort = problem.n_x, trajectory.breaks_s, trajectory.effort
    n, widths = len(breaks) - 1, np.diff(trajectory.breaks_s)
    planned = np.vstack([trajectory.state_at(breaks[:-1]), trajectory.state[-1, -1]])
    varied = np.eye(n_x + 1, n_x).ravel(order="F")  # of state and cost by the state at the interval's begin
    begins = np.hstack([planned[:-1], np.zeros((n, 1)), np.tile(varied, (n, 1))])
    inputs = np.column_stack([effort.transpose(1, 2, 0).reshape(n, -1), breaks[:-1], widths])
    rate, shares = _varied_rate(problem, len(effort)), np.append(points[1:-1], 1.0)
    reached = side_by_side(rate, widths, inputs, begins, shares, problem.solver.certificate_deadline)
    if reached is None:
        lost = np.full((n, n_x), np.inf)
        return IntegratedOde(errors=lost, defects=lost, cost=lost[:, 0], beyond=lost[:, 0], end=planned[-1])
    along, transitions = reached[:, :, : n_x + 1], reached[:, :, n_x + 1 :].reshape(n, -1, n_x, n_x + 1).swapaxes(2, 3)
    added = (along[:, -1, :n_x] - planned[1:]) / size
    begun, errors, restarts = propagated(
        added,
        transitions[:, -1, :n_x] * size / size[:, None],
        # If errors grow by this factor at most, the integrator's own error stays within the tolerance.
        max(RESTART_GROWTH, problem.tolerance / INTEGRATION_RTOL),
    )
    # States and cost from where the motion before has come to, to first order.
    along = along + np.einsum("kmij,kj->kmi", transitions, begun * size)
    errors = np.abs(errors)
    return IntegratedOde(
        errors=errors,
        defects=scaled_defects(added, errors) if restarts else np.abs(np.diff(errors, axis=0, prepend=0.0)),
        cost=along[:, -1, n_x],
        beyond=np.array([relative_violation(rows[:, :n_x], problem.state_limit.T, size) for rows in along]),
        end=along[-1, -1, :n_x],
        restarts=restarts,
    )


@functools.lru_cache(maxsize=16)
def _varied_rate(problem: OdeProblem, n_coefficients: int) -> ca.Function:
    """Return the rate of state, cost and their derivatives by the state at an interval's begin (column by column) within it.

    The arguments are these quantities; the coefficients of the interval's efforts, its beginning [s] and its width [s]; and
    the share of the interval.
    """
    n_x = problem.n_x
    y, given, share = ca.SX.sym("y", (n_x + 1) ** 2), ca.SX.sym("c", n_coefficients * problem.n_u + 2), ca.SX.sym("tau")
    u = bernstein_value(ca.reshape(given[:-2], n_coefficients, problem.n_u), share).T
    at = (y[:n_x], u, ca.DM(problem.parameters), given[-2] + share * given[-1])
    value = ca.vertcat(problem.function("rate")(*at), problem.function("running_cost")(*at))
    varied = ca.jacobian(value, y[:n_x]) @ ca.reshape(y[n_x + 1 :], n_x + 1, n_x)[:n_x, :]
    return ca.Function("varied", [y, given, share], [ca.densify(ca.vertcat(value, ca.vec(varied)))], {"cse": True})
