"""The certificate of a solution to a user's optimal-control problem: checks between the nodes.

The differential equation is integrated under the solution's efforts, interval by interval, like unstable motions
of mechanisms (`linkplan.planner.certificate.flow.errors_along`).
"""

import functools
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.planner.certificate.flow import (
    ERROR_STEP,
    INTEGRATION_RTOL,
    RESTART_GROWTH,
    ErrorsAlong,
    errors_along,
    scaled_defects,
)
from linkplan.planner.certificate.integration import relative_violation
from linkplan.planner.limits.limit import LimitedRow, LimitFacts, Margin, Measured, limited_rows, margin_of
from linkplan.planner.limits.samples import sample_points
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.problem.extra import not_finite
from linkplan.planner.transcription.bernstein import bernstein_value
from linkplan.planner.transcription.collocation import Curves
from linkplan.planner.transcription.schemes import Scheme

# The integrated state may end this share of each state's size from the solution. Refinement may reach a smaller tolerance.
INTEGRATION_SHARE = 1e-4
# Limits may be exceeded by this share, because of rounding and the solver's tolerance.
LIMIT_SLACK = 1e-8
# Between the nodes the integrated state may exceed a limit by this share of its size.
OVERRUN_SHARE = 1e-6
# A quantity within this share of its size from a limit is at the limit.
AT_LIMIT_SHARE = 1e-6
# The objective may differ from that of the integrated motion by this multiple of the states' relative error.
OBJECTIVE_ERROR_FACTOR = 10.0
# Constraint rows keep efforts and states at every instant.
_EFFORT, _STATE = (LimitFacts(kind=kind, tightened=None) for kind in ("effort", "state"))
PATH = LimitFacts(kind="path", words="path quantity {}")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OdeCertificate:
    """Findings on a solution between its nodes; `failures` are the reasons why it does not pass.

    `integration_error` is the largest distance of the integrated state from the planned one, as a share of each state's
    size; `integrated_objective` is the objective along the integrated state, and `objective_error` its distance from the
    solution's own, as a share of the sum of its parts' sizes. `overrun` is the largest excess of the integrated state over
    its limits, as a share of its size. `margins` are those of limited efforts, states and path quantities.
    """

    integration_error: float
    integrated_objective: float
    objective_error: float
    overrun: float
    margins: tuple[Margin, ...]
    touching: np.ndarray  # (n_intervals,) whether a state or path quantity is at a limit on part of the interval only
    boundary_error: float
    integration_restarts: int  # number of restarts of the integration because of an unstable motion; 0 as a rule
    growth: np.ndarray  # (n_intervals,) of the integration error, in shares of what is allowed
    failures: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether there is no failure."""
        return not self.failures


@np.errstate(invalid="ignore")  # infinity minus infinity, where the integration fails
def certify_ode(problem: OdeProblem, motion: Curves) -> OdeCertificate:
    """Return the certificate of a solution against its problem."""
    points, n_x, n = sample_points(len(motion.state) - 1), problem.n_x, len(motion.breaks_s) - 1
    time, x, u = sampled_motion(motion, points)
    path = problem.along("path", x, u, time)
    size, path_size = sizes_of(x), np.abs(path).max(axis=0, initial=1.0)
    found = integrate(problem, motion, size, points)
    error, cost = float(found.errors.max()), found.states[:, -1, n_x]
    beyond = np.array([relative_violation(of, problem.state_limit.T, size) for of in found.states[..., :n_x]])
    # The running cost as integrated, and as the program took it.
    taken = cost if motion.running is None else motion.running
    final = float(problem.at_ends("final_cost", motion.state[0, 0], found.states[-1, -1, :n_x], motion.duration_s)[0])
    misjudged = (cost - taken) / (float(np.abs(taken).sum() + abs(final)) or 1.0)
    off, missed = float(abs(misjudged.sum())), _boundary_error(problem, motion, size)
    # The polynomial is only as close to the motion as its own error; limits of the integrated state are checked separately.
    kinds = (
        (_EFFORT, problem.efforts, u, problem.effort_limit, np.zeros(problem.n_u)),
        (_STATE, problem.states, x, problem.state_limit, max(LIMIT_SLACK, min(error, OVERRUN_SHARE)) * size),
        (PATH, [*map(str, range(len(path_size)))], path, problem.path_limit, LIMIT_SLACK * path_size),
    )
    margins = tuple(
        margin_of(LimitedRow(facts, k), Measured(names[k], values[:, k], limit[k], slack=slack[k]), points, time)
        for facts, names, values, limit, slack in kinds
        for k in limited_rows(limit)
    )
    faults = [
        (
            not error <= INTEGRATION_SHARE,
            f"the integrated state ends {error:.3g} of its size from the solution (allowed: {INTEGRATION_SHARE:g})",
        ),
        *((margin.left < -margin.slack, margin.sentence()) for margin in margins),
        (
            beyond.max() > INTEGRATION_SHARE,
            f"the integrated state leaves its limits by {beyond.max():.3g} of its size between the nodes",
        ),
        *((True, sentence) for sentence in functions_not_finite(problem, motion)),
        (
            not off <= OBJECTIVE_ERROR_FACTOR * INTEGRATION_SHARE,
            f"the objective differs from that of the integrated motion by {off:.3g} of its size",
        ),
        (missed > LIMIT_SLACK, f"start, goal or ends are missed by {missed:.3g}"),
    ]
    defects = scaled_defects(found.defects, found.errors) if found.restarts else np.diff(found.errors, axis=0, prepend=0.0)
    # An overrun at its allowed value requires as much refinement as a state at its tolerance.
    shares = (
        np.abs(defects).max(axis=1),
        np.abs(misjudged) / OBJECTIVE_ERROR_FACTOR,
        beyond / OVERRUN_SHARE * problem.tolerance,
    )
    return OdeCertificate(
        integration_error=error,
        integrated_objective=float(cost.sum() + final),
        objective_error=off,
        overrun=float(beyond.max()),
        margins=margins,
        # Rows keep the coefficients of states within the limits.
        touching=_in_part(motion.state.swapaxes(0, 1), problem.state_limit, size)
        | _in_part(path.reshape(n, len(points), len(path_size)), problem.path_limit, path_size),
        boundary_error=missed,
        integration_restarts=found.restarts,
        growth=np.nan_to_num(np.max(shares, axis=0) / INTEGRATION_SHARE, nan=np.inf),
        failures=tuple(sentence for wrong, sentence in faults if wrong),
    )


def integrate(problem: OdeProblem, motion: Curves, size: np.ndarray, points: np.ndarray) -> ErrorsAlong:
    """Return the integrated motion beside a solution, its states followed by the interval's running cost.

    Args:
        problem: the user's problem.
        motion: the solution.
        size: (n_x,) of the states.
        points: shares (m,) of an interval, from 0 to 1.
    """
    n_x, breaks, n = problem.n_x, motion.breaks_s, len(motion.breaks_s) - 1
    planned, widths = motion.state_at(breaks), np.diff(breaks)
    begins = np.column_stack([planned[:-1], np.zeros(n)])
    aside = np.eye(n_x + 1, n_x + 1, -1)[:, :n_x] * ERROR_STEP * size
    states = begins[:, None] + np.column_stack([aside, np.zeros(n_x + 1)])
    inputs = np.column_stack([motion.effort.transpose(1, 2, 0).reshape(n, -1), breaks[:-1], widths])
    shares, until = np.append(points[1:-1], 1.0), problem.solver.certificate_deadline
    # If errors grow at most by this factor, the integrator's own error stays within the tolerance.
    most = max(RESTART_GROWTH, problem.tolerance / INTEGRATION_RTOL)
    rate, judged = _rate(problem, len(motion.effort)), range(n_x)
    return errors_along(rate, widths, inputs, states, judged, planned[1:], size, shares, most, until)


@functools.lru_cache(maxsize=16)
def _rate(problem: OdeProblem, n_coefficients: int) -> ca.Function:
    """Return the rate of states and running cost within an interval, as a function for `errors_along`.

    The inputs of an interval are the coefficients of its efforts, its beginning [s] and its width [s].
    """
    y, given, share = ca.SX.sym("y", problem.n_x + 1), ca.SX.sym("c", n_coefficients * problem.n_u + 2), ca.SX.sym("tau")
    u = bernstein_value(ca.reshape(given[:-2], n_coefficients, problem.n_u), share).T
    at = (y[:-1], u, ca.DM(problem.parameters), given[-2] + share * given[-1])
    value = ca.vertcat(problem.functions["rate"](*at), problem.functions["running_cost"](*at))
    return ca.Function("rate", [y, given, share], [value], {"cse": True})


def sampled_motion(motion: Curves, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the times (n,) [s], states (n, n_x) and efforts (n, n_u) at shares `points` of every interval."""
    time = motion.times_at(points)
    return time, motion.state_at(time), motion.effort_at(time)


def functions_not_finite(problem: OdeProblem, motion: Curves) -> list[str]:
    """Return the sentences on the problem's functions that are not finite along a motion."""
    time, x, u = sampled_motion(motion, sample_points(len(motion.state) - 1))
    rows = [(name, problem.along(name, x, u, time), time) for name in ("rate", "running_cost", "path")]
    for name in ("final_cost", "ends"):
        rows.append((name, problem.at_ends(name, x[0], x[-1], motion.duration_s)[None], motion.breaks_s[-1:]))
    return [sentence for row in rows for sentence in not_finite(*row)]


def running_cost(problem: OdeProblem, motion: Curves, chosen: Scheme) -> np.ndarray:
    """Return the running cost of each interval (n,) by the quadrature of the transcription."""
    # The right end of an interval is the next one's left end, where efforts may jump: just before it.
    time, x, u = sampled_motion(motion, np.clip(chosen.nodes, 0.0, 1.0 - 1e-12))
    rate = problem.along("running_cost", x, u, time)
    return np.diff(motion.breaks_s) * (rate.reshape(-1, chosen.n_nodes) @ chosen.weights)


def sizes_of(x: np.ndarray) -> np.ndarray:
    """Return the sizes (n_x,) of states (n, n_x) along a motion, from their values and from their changes."""
    size = np.maximum(np.abs(x).max(axis=0), np.ptp(x, axis=0))
    return np.where(size > 0, size, 1.0)


def _in_part(values: np.ndarray, limit: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return on which intervals (n,) values (n, n_points, k) of sizes (k,) are at a limit at a point, but not at all."""
    at = np.minimum(values - limit[:, 0], limit[:, 1] - values) <= AT_LIMIT_SHARE * size
    return np.any(at.any(axis=1) & ~at.all(axis=1), axis=1)


def _boundary_error(problem: OdeProblem, motion: Curves, size: np.ndarray) -> float:
    """Return the violation of the boundary conditions, relative to the sizes of the states and of psi."""
    first, last, back = motion.state[0, 0], motion.state[-1, -1], list(problem.returns)
    psi = problem.at_ends("ends", first, last, motion.duration_s)
    return max(
        relative_violation(first, problem.start.T, size),
        relative_violation(last, problem.goal.T, size),
        relative_violation(last[back], (first[back], first[back]), size[back]),
        relative_violation(psi, problem.ends_limit.T, np.maximum(1.0, np.abs(psi))),
    )
