"""The differential equation integrated under a solution's efforts, against the solution.

Every interval is integrated from the planned state, together with its transition matrix, and its defect is propagated along
the motion to first order. Along an unstable motion an error grows by many orders of magnitude (e^40 in 20 s for a pole at
2 / s), and rounding decides where one integration would end. So the integration is restarted wherever an error would have
grown by `RESTART_GROWTH`, as for mechanisms (`linkplan.planner.certificate.integration`). The certificate then states that
the solution satisfies the differential equation, not that it can be followed without feedback. It reports the number of
restarts.
"""

import functools
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.planner.certificate.flow import INTEGRATION_RTOL, side_by_side
from linkplan.planner.certificate.integration import RESTART_GROWTH, relative_violation
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.transcription.bernstein import bernstein_value


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class IntegratedOde:
    """How far the integrated state is from a solution.

    `errors` (n, n_x) are its distances at the intervals' ends, as shares of each state's size; `defects` (n, n_x) what each
    interval adds to them; `objective` is that along it; `misjudged` (n,) the errors of the solution's running cost up to
    each interval's end, as shares of the objective's size; `beyond` (n,) how far the integrated state leaves its limits
    within each interval, as a share of its size; `restarts` counts the restarts.
    """

    errors: np.ndarray
    defects: np.ndarray
    objective: float
    misjudged: np.ndarray
    beyond: np.ndarray
    restarts: int


def integrate(problem: OdeProblem, trajectory: OdeTrajectory, size: np.ndarray, points: np.ndarray) -> IntegratedOde:
    """Return the integrated state's errors against a solution; infinite where an interval cannot be integrated.

    Args:
        problem: what was asked.
        trajectory: the solution.
        size: (n_x,) of the states.
        points: shares (m,) of an interval at which limits are looked at, the last of them 1.
    """
    n_x, breaks, planned = problem.n_x, trajectory.breaks_s, _planned(trajectory)
    n = len(breaks) - 1
    errors, added, spent, beyond = np.full((n, n_x), np.inf), np.zeros((n, n_x)), np.full(n, np.inf), np.full(n, np.inf)
    still = np.concatenate([[0.0], np.vstack([np.eye(n_x), np.zeros(n_x)]).ravel(order="F")])
    begins = np.hstack([planned[:-1], np.tile(still, (n, 1))])
    shares, varied = np.append(points[1:-1], 1.0), _varied_on(problem, trajectory.effort.shape[0])
    reached = side_by_side(varied, np.diff(breaks), _inputs(trajectory), begins, shares, problem.solver.certificate_deadline)
    if reached is None:
        return IntegratedOde(errors=errors, defects=errors, objective=np.inf, misjudged=spent, beyond=beyond, restarts=0)
    states, transitions = reached[:, :, : n_x + 1], reached[:, :, n_x + 1 :].reshape(n, -1, n_x, n_x + 1).swapaxes(2, 3)

    def propagated(most: float) -> IntegratedOde:
        """Return the errors with a restart wherever an error made before would have grown by more than a factor."""
        error, carried, restarts, inside = np.zeros(n_x), np.eye(n_x), 0, states[0]
        for k in range(n):
            # States and cost from where the motion before has come to, to first order.
            inside = states[k] + transitions[k] @ (error * size)
            error = (inside[-1, :n_x] - planned[k + 1]) / size
            errors[k], added[k] = np.abs(error), np.abs(states[k, -1, :n_x] - planned[k + 1]) / size
            spent[k], beyond[k] = inside[-1, n_x], relative_violation(inside[:, :n_x], problem.state_limit.T, size)
            carried = transitions[k, -1, :n_x] * size / size[:, None] @ carried
            # An error that has shrunk below one made now can be forgotten. The spectral norm bounds its growth: that of a
            # product of matrices is at most the product of their norms.
            grown = np.linalg.norm(carried, 2)
            if grown > most:
                error, restarts = np.zeros(n_x), restarts + 1
            if grown > most or grown < 1:
                carried = np.eye(n_x)
        share = errors.max(axis=0) / np.maximum(added.sum(axis=0), np.finfo(float).tiny)
        defects = added * share if restarts else np.abs(np.diff(errors, axis=0, prepend=0.0))
        objective, off = _costs(problem, trajectory, np.cumsum(spent), inside[-1, :n_x])
        return IntegratedOde(
            errors=errors, defects=defects, objective=objective, misjudged=off, beyond=beyond, restarts=restarts
        )

    # If errors grow by more than this factor, rounding alone decides where one integration ends.
    whole = propagated(problem.tolerance / np.finfo(float).eps)
    if not whole.restarts and whole.errors.max() <= problem.tolerance:
        return whole
    # If errors grow by this factor at most, the integrator's own error stays within the tolerance.
    return propagated(max(RESTART_GROWTH, problem.tolerance / INTEGRATION_RTOL))


def _inputs(trajectory: OdeTrajectory) -> np.ndarray:
    """Return for every interval (n, k) the coefficients of its efforts, its beginning [s] and its width [s]."""
    breaks = trajectory.breaks_s
    efforts = trajectory.effort.transpose(1, 2, 0).reshape(len(breaks) - 1, -1)
    return np.column_stack([efforts, breaks[:-1], np.diff(breaks)])


def _planned(trajectory: OdeTrajectory) -> np.ndarray:
    """Return the planned states (n + 1, n_x) at the intervals' ends."""
    return np.vstack([trajectory.state_at(trajectory.breaks_s[:-1]), trajectory.state[-1, -1, : trajectory.n_x]])


def _costs(problem: OdeProblem, trajectory: OdeTrajectory, spent: np.ndarray, end: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the objective along the integrated state, and its errors; `spent` (n,) is up to each interval's end."""
    final = 0.0
    if problem.final_cost is not None:
        begin = trajectory.state_at(trajectory.breaks_s[:1])[0]
        final = float(problem.at_ends("final_cost")(begin, end, trajectory.duration_s, problem.parameters))
    if trajectory.running is None:
        return spent[-1] + final, np.zeros(len(spent))
    scale = np.abs(trajectory.running).sum() + abs(final)
    return spent[-1] + final, (spent - np.cumsum(trajectory.running)) / (scale if scale > 0 else 1.0)


@functools.lru_cache(maxsize=16)
def _varied_on(problem: OdeProblem, n_coefficients: int) -> ca.Function:
    """Return the rate of state, cost and their derivatives by the state at an interval's begin (column by column) within it.

    The arguments are these quantities, one of `_inputs`' rows, and the share of the interval.
    """
    n_x = problem.n_x
    y, given, share = ca.SX.sym("y", (n_x + 1) ** 2), ca.SX.sym("c", n_coefficients * problem.n_u + 2), ca.SX.sym("tau")
    x, p, t = y[:n_x], ca.DM(problem.parameters), given[-2] + share * given[-1]
    u = bernstein_value(ca.reshape(given[:-2], n_coefficients, problem.n_u), share).T
    running = problem.at_instant("running_cost")(x, u, p, t) if problem.running_cost is not None else ca.SX(0)
    value = ca.vertcat(problem.at_instant("rate")(x, u, p, t), running)
    varied = ca.jacobian(value, x) @ ca.reshape(y[n_x + 1 :], n_x + 1, n_x)[:n_x, :]
    return ca.Function("varied", [y, given, share], [ca.densify(ca.vertcat(value, ca.vec(varied)))], {"cse": True})
