"""The differential equation integrated under a solution's efforts, against the solution.

From the start to the end in one go, as a rule. Along an unstable motion an error grows by many orders of magnitude (e^40 in
20 s for a pole at 2 / s), and rounding decides where the integration ends. Then every interval
is integrated from the planned state, its defect is propagated by the transition matrices along the motion, and the
integration is restarted wherever an error would have grown by `RESTART_GROWTH`, as for mechanisms
(`linkplan.planner.certificate.integration`). The certificate then states that the solution satisfies the differential
equation, not that it can be followed without feedback. It reports the number of restarts.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy

from linkplan.planner.certificate.flow import INTEGRATION_RTOL, called, flow, side_by_side
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
    """Return the integrated state's errors against a solution.

    Args:
        problem: what was asked.
        trajectory: the solution.
        size: (n_x,) of the states.
        points: shares (m,) of an interval at which limits are looked at, the last of them 1.
    """
    if _grows(problem, trajectory, size, problem.tolerance / np.finfo(float).eps):
        # Rounding alone decides where one integration would end.
        return _anew(problem, trajectory, size, points) or _in_one_go(problem, trajectory, size, points)
    whole = _in_one_go(problem, trajectory, size, points)
    if whole.errors.max() <= problem.tolerance or not is_unstable(problem, trajectory, size):
        return whole
    return _anew(problem, trajectory, size, points) or whole


def is_unstable(problem: OdeProblem, trajectory: OdeTrajectory, size: np.ndarray) -> bool:
    """True if an error grows too much along a motion for one integration to certify it.

    Args:
        problem: what was asked.
        trajectory: the motion.
        size: (n_x,) of the states.
    """
    return _grows(problem, trajectory, size, _most(problem))


def _grows(problem: OdeProblem, trajectory: OdeTrajectory, size: np.ndarray, most: float) -> bool:
    """True if an error grows by more than a factor, with the dynamics of each interval frozen at its middle."""
    breaks, n_x = trajectory.breaks_s, problem.n_x
    widths = np.diff(breaks)
    middle = breaks[:-1] + 0.5 * widths
    x, u = trajectory.state_at(middle), trajectory.effort_at(middle)
    _, slope = _variation(problem)(x.T, u.T, problem.parameters, middle[None])
    slopes = np.array(slope).reshape(n_x + 1, len(widths), n_x).transpose(1, 0, 2)[:, :n_x] * size / size[:, None]
    if not np.all(np.isfinite(slopes)):
        return False
    carried = np.eye(n_x)
    with np.errstate(all="ignore"):  # what grows beyond all numbers grows too much
        for transition in scipy.linalg.expm(slopes * widths[:, None, None]):
            carried = transition @ carried
            # The spectral norm: that of a product is at most the product of theirs, so that nothing is lost by forgetting an
            # error that is less than one made now. Of the largest entries that is not so: on a fine mesh all fall at first.
            grown = np.linalg.norm(carried, 2) if np.all(np.isfinite(carried)) else np.inf
            if grown > most:
                return True
            if grown < 1:
                carried = np.eye(n_x)
    return False


def _most(problem: OdeProblem) -> float:
    """Return the growth of an error up to which the integrator's own error stays within the tolerance."""
    return max(RESTART_GROWTH, problem.tolerance / INTEGRATION_RTOL)


def _in_one_go(problem: OdeProblem, trajectory: OdeTrajectory, size: np.ndarray, points: np.ndarray) -> IntegratedOde:
    """Return the errors of one integration."""
    n_x, breaks, planned = problem.n_x, trajectory.breaks_s, _planned(trajectory)
    n, widths, inputs = len(breaks) - 1, np.diff(breaks), _inputs(trajectory)
    errors, spent, beyond = np.full((n, n_x), np.inf), np.full(n, np.inf), np.full(n, np.inf)
    function = _rate_on(problem, trajectory.effort.shape[0])
    state, shares, until = np.append(planned[0], 0.0), np.append(points[:-1], 1.0), problem.solver.certificate_deadline
    for k in range(n):
        reached = flow(called(function, inputs[k], widths[k]), widths[k], state, shares, until)
        if reached is None:
            return IntegratedOde(
                errors=errors, defects=errors, objective=np.inf, misjudged=spent, beyond=np.full(n, np.inf), restarts=0
            )
        state = reached[-1]
        errors[k] = np.abs(state[:n_x] - planned[k + 1]) / size
        spent[k] = state[n_x]
        beyond[k] = relative_violation(reached[:, :n_x], problem.state_limit.T, size)
    with np.errstate(invalid="ignore"):
        defects = np.abs(np.diff(np.vstack([np.zeros(n_x), errors]), axis=0))
    objective, misjudged = _costs(problem, trajectory, spent, state[:n_x])
    return IntegratedOde(errors=errors, defects=defects, objective=objective, misjudged=misjudged, beyond=beyond, restarts=0)


def _anew(problem: OdeProblem, trajectory: OdeTrajectory, size: np.ndarray, points: np.ndarray) -> IntegratedOde | None:
    """Return the errors propagated from interval to interval with restarts; None where the motion is not so unstable."""
    n_x, breaks, planned = problem.n_x, trajectory.breaks_s, _planned(trajectory)
    n = len(breaks) - 1
    errors, added, spent, beyond = np.zeros((n, n_x)), np.zeros((n, n_x)), np.zeros(n), np.zeros(n)
    error, carried, restarts = np.zeros(n_x), np.eye(n_x), 0
    still = np.concatenate([[0.0], np.vstack([np.eye(n_x), np.zeros(n_x)]).ravel(order="F")])
    begins = np.hstack([planned[:-1], np.tile(still, (n, 1))])
    shares, end = np.append(points[1:-1], 1.0), planned[0]
    varied = _varied_on(problem, trajectory.effort.shape[0])
    reached = side_by_side(varied, np.diff(breaks), _inputs(trajectory), begins, shares, problem.solver.certificate_deadline)
    if reached is None:
        return None
    states, transitions = reached[:, :, : n_x + 1], reached[:, :, n_x + 1 :].reshape(n, -1, n_x, n_x + 1).swapaxes(2, 3)
    for k in range(n):
        # States and cost from where the motion before has come to, to first order.
        inside = states[k] + transitions[k] @ (error * size)
        end = inside[-1, :n_x]
        error = (end - planned[k + 1]) / size
        errors[k], added[k] = np.abs(error), np.abs(states[k, -1, :n_x] - planned[k + 1]) / size
        spent[k], beyond[k] = inside[-1, n_x], relative_violation(inside[:, :n_x], problem.state_limit.T, size)
        carried = transitions[k, -1, :n_x] * size / size[:, None] @ carried
        if np.abs(carried).max() > _most(problem):
            error, carried, restarts = np.zeros(n_x), np.eye(n_x), restarts + 1
    if not restarts:
        return None
    share = errors.max(axis=0) / np.maximum(added.sum(axis=0), np.finfo(float).tiny)
    objective, misjudged = _costs(problem, trajectory, np.cumsum(spent), end)
    return IntegratedOde(
        errors=errors, defects=added * share, objective=objective, misjudged=misjudged, beyond=beyond, restarts=restarts
    )


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


def _variation(problem: OdeProblem) -> ca.Function:
    """Return f and L, one below the other (n_x + 1,), and their derivatives by x (n_x + 1, n_x), of (x, u, p, t)."""
    rate = problem.at_instant("rate")
    x, u, p, t = (ca.SX.sym(name, *rate.size_in(i)) for i, name in enumerate("xupt"))
    running = problem.at_instant("running_cost")(x, u, p, t) if problem.running_cost is not None else ca.SX(0)
    value = ca.vertcat(rate(x, u, p, t), running)
    return ca.Function("variation", [x, u, p, t], [ca.densify(value), ca.densify(ca.jacobian(value, x))])


def _rate_on(problem: OdeProblem, n_coefficients: int) -> ca.Function:
    """Return the rate of state and cost within an interval, of `called`'s inputs.

    The arguments are the state with the cost, one of `_inputs`' rows, and the share of the interval.
    """
    y, given, share = _arguments(problem, problem.n_x + 1, n_coefficients)
    value, _ = _variation(problem)(*_at_share(problem, y, given, share, n_coefficients))
    return ca.Function("rate", [y, given, share], [value], {"cse": True})


def _varied_on(problem: OdeProblem, n_coefficients: int) -> ca.Function:
    """Return the rate of state, cost and transition matrix (column by column) within an interval, as `_rate_on` does."""
    n_x = problem.n_x
    y, given, share = _arguments(problem, (n_x + 1) ** 2, n_coefficients)
    value, slope = _variation(problem)(*_at_share(problem, y, given, share, n_coefficients))
    transition = ca.reshape(y[n_x + 1 :], n_x + 1, n_x)
    return ca.Function("varied", [y, given, share], [ca.vertcat(value, ca.vec(slope @ transition[:n_x, :]))], {"cse": True})


def _arguments(problem: OdeProblem, n: int, n_coefficients: int) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return symbols for n integrated quantities, one of `_inputs`' rows, and the share of the interval."""
    return ca.SX.sym("y", n), ca.SX.sym("c", n_coefficients * problem.n_u + 2), ca.SX.sym("tau")


def _at_share(problem: OdeProblem, y: ca.SX, given: ca.SX, share: ca.SX, n_coefficients: int) -> tuple:
    """Return (x, u, p, t) at a share of an interval."""
    u = bernstein_value(ca.reshape(given[:-2], n_coefficients, problem.n_u), share).T
    return y[: problem.n_x], u, ca.DM(problem.parameters), given[-2] + share * given[-1]
