"""The certificate of a solution to a user's optimal-control problem: what holds between the nodes.

The differential equation is integrated under the solution's efforts. Every interval is integrated from the planned state,
together with its transition matrix, and its defect is propagated along the motion to first order, with restarts as along
mechanisms' motions (`linkplan.planner.certificate.integration`).
"""

import functools
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.planner.certificate.flow import INTEGRATION_RTOL, side_by_side
from linkplan.planner.certificate.integration import RESTART_GROWTH, propagated, relative_violation, scaled_defects
from linkplan.planner.limits.limit import LimitFacts, Margin, Measured, limited_rows, margin_of
from linkplan.planner.limits.samples import sample_points
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.problem.extra import not_finite
from linkplan.planner.transcription.bernstein import bernstein_value
from linkplan.planner.transcription.schemes import Scheme

# The integrated state may end this share of each state's size from the solution; a smaller tolerance is refined towards.
INTEGRATION_SHARE = 1e-4
# Limits may be exceeded by this share: rounding, and what the solver leaves of its rows.
LIMIT_SLACK = 1e-8
# Between the nodes the integrated state may exceed a limit by this share of its size.
OVERRUN_SHARE = 1e-6
# A quantity within this share of its size from a limit is at the limit.
AT_LIMIT_SHARE = 1e-6
# The objective may differ from that of the integrated motion by this multiple of the states' relative error.
OBJECTIVE_ERROR_FACTOR = 10.0
_EFFORT = LimitFacts(kind="effort", tightened=None)  # rows keep efforts and states at every instant
_STATE = LimitFacts(kind="state", tightened=None)
_PATH = LimitFacts(kind="path", words="path quantity {}")


@dataclass(frozen=True, eq=False, slots=True)
class OdeLimit:
    """A limit on one effort, state or path quantity: the two fields that a `Margin` reads."""

    facts: LimitFacts
    item: int


@dataclass(frozen=True, eq=False, slots=True)
class OdeSamples:
    """A motion at `time` (n,), at the shares `points` of every interval: `x` (n, n_x), `u` (n, n_u), `path` (n, n_path)."""

    points: np.ndarray
    time: np.ndarray
    x: np.ndarray
    u: np.ndarray
    path: np.ndarray


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


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OdeCertificate:
    """What holds between the nodes of a solution; `failures` say why it does not pass.

    `integration_error` is the largest distance of the integrated state from the planned one, as a share of each state's
    size; `integrated_objective` the objective along the integrated state, and `objective_error` how far the solution's own
    is from it, as a share of the sum of its parts' sizes; `overrun` how far the integrated state leaves its limits at most,
    as a share of its size. `margins` are those of limited efforts, states and path quantities.
    """

    integration_error: float
    integrated_objective: float
    objective_error: float
    overrun: float
    margins: tuple[Margin, ...]
    touching: np.ndarray  # (n_intervals,) whether a state or path quantity is at a limit on part of the interval only
    boundary_error: float
    integration_restarts: int  # how often the integration was restarted, the motion being unstable; 0 as a rule
    growth: np.ndarray  # (n_intervals,) of the integration error, in shares of what is allowed
    failures: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether everything holds."""
        return not self.failures

    @property
    def residual_share(self) -> np.ndarray:
        """Zero on every interval (n_intervals,): the integration tells all."""
        return np.zeros(len(self.growth))

    @property
    def effort_overrun(self) -> np.ndarray:
        """Zero on every interval (n_intervals,): efforts are bounded at every instant."""
        return np.zeros(len(self.growth))


def certify_ode(problem: OdeProblem, trajectory: OdeTrajectory) -> OdeCertificate:
    """Return the certificate of a solution against its problem."""
    samples = _samples_of(problem, trajectory)
    size, path_size = sizes_of(samples.x), np.abs(samples.path).max(axis=0, initial=1.0)
    integrated = integrate(problem, trajectory, size, samples.points)
    objective, misjudged = _costs(problem, trajectory, integrated)
    error, beyond, off = float(integrated.errors.max()), float(integrated.beyond.max()), float(abs(misjudged.sum()))
    missed = _boundary_error(problem, trajectory, size)
    # The polynomial is no nearer to the motion than its own error; the integrated state is judged by itself.
    kinds = (
        (_EFFORT, problem.efforts, samples.u, problem.effort_limit, np.zeros(problem.n_u)),
        (_STATE, problem.states, samples.x, problem.state_limit, max(LIMIT_SLACK, min(error, OVERRUN_SHARE)) * size),
        (_PATH, [*map(str, range(len(path_size)))], samples.path, problem.path_limit, LIMIT_SLACK * path_size),
    )
    margins = tuple(
        margin_of(OdeLimit(facts, k), Measured(names[k], values[:, k], limit[k], slack=slack[k]), samples)
        for facts, names, values, limit, slack in kinds
        for k in limited_rows(limit)
    )
    # For states these are the coefficients: rows keep the coefficients within the limits.
    beside = _inside(trajectory.state, problem.state_limit) / size
    along = _inside(samples.path, problem.path_limit) / path_size
    faults = [
        (
            not error <= INTEGRATION_SHARE,
            f"the integrated state ends {error:.3g} of its size from the solution (allowed: {INTEGRATION_SHARE:g})",
        ),
        *((margin.left < -margin.slack, margin.sentence()) for margin in margins),
        (
            beyond > INTEGRATION_SHARE,
            f"the integrated state leaves its limits by {beyond:.3g} of its size between the nodes",
        ),
        *((True, sentence) for sentence in functions_not_finite(problem, trajectory)),
        (
            not off <= OBJECTIVE_ERROR_FACTOR * INTEGRATION_SHARE,
            f"the objective differs from that of the integrated motion by {off:.3g} of its size",
        ),
        (missed > LIMIT_SLACK, f"start, goal or ends are missed by {missed:.3g}"),
    ]
    growth = np.maximum(integrated.defects.max(axis=1), np.abs(misjudged) / OBJECTIVE_ERROR_FACTOR)
    # An overrun at its limit asks for as much refinement as a state at its tolerance.
    growth = np.maximum(growth, integrated.beyond / OVERRUN_SHARE * problem.tolerance) / INTEGRATION_SHARE
    return OdeCertificate(
        integration_error=error,
        integrated_objective=objective,
        objective_error=off,
        overrun=beyond,
        margins=margins,
        touching=_in_part(beside.transpose(2, 1, 0)) | _in_part(along.T.reshape(-1, len(growth), len(samples.points))),
        boundary_error=missed,
        integration_restarts=integrated.restarts,
        growth=np.nan_to_num(growth, nan=np.inf),
        failures=tuple(sentence for wrong, sentence in faults if wrong),
    )


def _samples_of(problem: OdeProblem, trajectory: OdeTrajectory) -> OdeSamples:
    points = sample_points(len(trajectory.state) - 1)
    time = trajectory.times_at(points)
    x, u = trajectory.state_at(time), trajectory.effort_at(time)
    return OdeSamples(points, time, x, u, problem.along("path", x, u, time))


def functions_not_finite(problem: OdeProblem, motion: OdeTrajectory) -> list[str]:
    """Return the sentences on the problem's functions that are not finite along a motion."""
    at, last_s = _samples_of(problem, motion), motion.breaks_s[-1:]
    rows = [(name, problem.along(name, at.x, at.u, at.time), at.time) for name in ("rate", "running_cost", "path")]
    for name in ("final_cost", "ends"):
        rows.append((name, problem.at_ends(name, at.x[0], at.x[-1], motion.duration_s)[None], last_s))
    return [sentence for row in rows for sentence in not_finite(*row)]


def running_cost(problem: OdeProblem, trajectory: OdeTrajectory, chosen: Scheme) -> np.ndarray:
    """Return the running cost of each interval (n,) by the quadrature of the transcription."""
    # The right end of an interval is the next one's left end, where efforts may jump: just before it.
    time = trajectory.times_at(np.clip(chosen.nodes, 0.0, 1.0 - 1e-12))
    x, u = trajectory.state_at(time), trajectory.effort_at(time)
    rate = problem.along("running_cost", x, u, time)
    return np.diff(trajectory.breaks_s) * (rate.reshape(-1, chosen.n_nodes) @ chosen.weights)


def sizes_of(x: np.ndarray) -> np.ndarray:
    """Return the sizes (n_x,) of states (n, n_x) along a motion: of what they are and of how far they go."""
    size = np.maximum(np.abs(x).max(axis=0), np.ptp(x, axis=0))
    return np.where(size > 0, size, 1.0)


def _costs(problem: OdeProblem, trajectory: OdeTrajectory, integrated: IntegratedOde) -> tuple[float, np.ndarray]:
    """Return the integrated objective, and the errors (n,) of the running costs as shares of the objective's size."""
    final = float(problem.at_ends("final_cost", trajectory.state[0, 0], integrated.end, trajectory.duration_s)[0])
    running = integrated.cost if trajectory.running is None else trajectory.running
    scale = float(np.abs(running).sum() + abs(final))
    return float(integrated.cost.sum() + final), (integrated.cost - running) / (scale or 1.0)


def _inside(value: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return the margin of values (..., n) within limits (n, 2), negative outside."""
    return np.minimum(value - limit[:, 0], limit[:, 1] - value)


def _in_part(beside: np.ndarray) -> np.ndarray:
    """Return on which intervals (n,) quantities (n_quantities, n, n_points) are at a limit at a point, but not at all."""
    at = beside <= AT_LIMIT_SHARE
    return np.any(at.any(axis=2) & ~at.all(axis=2), axis=0)


def _boundary_error(problem: OdeProblem, trajectory: OdeTrajectory, size: np.ndarray) -> float:
    """Return the violation of the boundary conditions, relative to the sizes of the states and of psi."""
    first, last, back = trajectory.state[0, 0], trajectory.state[-1, -1], list(problem.returns)
    psi = problem.at_ends("ends", first, last, trajectory.duration_s)
    return max(
        relative_violation(first, problem.start.T, size),
        relative_violation(last, problem.goal.T, size),
        relative_violation(last[back], (first[back], first[back]), size[back]),
        relative_violation(psi, problem.ends_limit.T, np.maximum(1.0, np.abs(psi))),
    )
