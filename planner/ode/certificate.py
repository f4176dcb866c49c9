"""The certificate of a solution to a user's optimal-control problem: what holds between the nodes."""

from dataclasses import dataclass

import numpy as np

from linkplan.planner.certificate.integration import relative_violation
from linkplan.planner.limits.samples import least_between, sample_points
from linkplan.planner.ode.integration import integrate
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.problem.extra import as_no_number, not_finite
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


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OdeCertificate:
    """ErrorReport on a solution; `failures` say why it does not pass.

    `integration_error` is the largest distance of the integrated state from the planned one, as a share of each state's
    size;
    `integrated_objective` the objective along the integrated state, and `objective_error` how far the solution's own is from
    it, as a share of the sum of its parts' sizes; `overrun` how far the integrated state leaves its limits at the most, as a
    share of its size; margins are negative outside, infinite where nothing limits.
    """

    effort_excess: float
    integration_error: float
    integrated_objective: float
    objective_error: float
    overrun: float
    state_margin: np.ndarray  # (n_x,)
    leaves_states: bool
    path_margin: np.ndarray  # (n_path,)
    path_overrun: np.ndarray  # (n_path, n_intervals)
    touching: np.ndarray  # (n_intervals,) whether a state or path quantity is at a limit on part of the interval only
    boundary_error: float
    integration_restarts: int  # how often the integration was restarted, the motion being unstable; 0 as a rule
    growth: np.ndarray  # (n_intervals,) of the integration error, in shares of what is allowed
    residual_share: np.ndarray  # (n_intervals,), zero: the integration tells all
    effort_overrun: np.ndarray  # (n_intervals,), zero: efforts are bounded at every instant
    failures: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether everything holds."""
        return not self.failures


def certify_ode(problem: OdeProblem, trajectory: OdeTrajectory) -> OdeCertificate:
    """Return the certificate of a solution against its problem."""
    points = sample_points(trajectory.state.shape[0] - 1)
    n_x, time = problem.n_x, trajectory.times_at(points)
    x, u = trajectory.state_at(time), trajectory.effort_at(time)
    size = sizes_of(x)
    integrated = integrate(problem, trajectory, size, points)
    misjudged, beyond = integrated.misjudged, integrated.beyond
    over = np.maximum(u - problem.effort_limit[:, 1], problem.effort_limit[:, 0] - u).max()
    state_margin = _inside(x, problem.state_limit).min(axis=0)
    path = np.array(problem.at_instant("path")(x.T, u.T, problem.parameters, time[None])).reshape(-1, len(time))
    limit = problem.path_limit
    inside = np.minimum(path - limit[:, :1], limit[:, 1:] - path)
    n = len(trajectory.breaks_s) - 1
    by_interval = np.array([least_between(row, points) for row in inside]).reshape(-1, n)
    path_margin = by_interval.min(axis=1, initial=np.inf)
    path_size = np.abs(path).max(axis=1, initial=1.0)
    # For states these are the coefficients: rows keep the coefficients within the limits.
    beside = _inside(trajectory.state[..., :n_x], problem.state_limit) / size
    along = (inside / path_size[:, None]).reshape(len(inside), n, len(points))
    touching = _in_part(beside.transpose(2, 1, 0)) | _in_part(along)
    boundary = _boundary_error(problem, trajectory, size)
    error = float(integrated.errors.max())
    failures = []
    if over > 0:
        failures.append(f"an effort exceeds its limit by {over:.3g}")
    if not error <= INTEGRATION_SHARE:
        failures.append(
            f"the integrated state ends {error:.3g} of its size from the solution (allowed: {INTEGRATION_SHARE:g})"
        )
    # The polynomial is no nearer to the motion than its own error; the integrated state is judged by itself.
    outside = state_margin < -max(LIMIT_SLACK, min(error, OVERRUN_SHARE)) * size
    for name, value, left in zip(problem.states, state_margin, outside, strict=True):
        if left:
            failures.append(f"state {name} leaves its limits by {-value:.3g} between the nodes")
    if beyond.max() > INTEGRATION_SHARE:
        failures.append(f"the integrated state leaves its limits by {beyond.max():.3g} of its size between the nodes")
    failures += functions_not_finite(problem, time, x, u, trajectory.duration_s)
    for k, value in enumerate(path_margin):
        if value < -LIMIT_SLACK * path_size[k]:
            failures.append(f"path quantity {k} leaves its limits by {-value:.3g} between the nodes")
    if not abs(misjudged[-1]) <= OBJECTIVE_ERROR_FACTOR * INTEGRATION_SHARE:
        failures.append(f"the objective is {abs(misjudged[-1]):.3g} of its size from that of the integrated motion")
    if boundary > LIMIT_SLACK:
        failures.append(f"start, goal or ends are missed by {boundary:.3g}")
    with np.errstate(invalid="ignore"):  # beyond a failed integration, infinity less infinity
        misjudged_there = np.abs(np.diff(misjudged, prepend=0.0)) / OBJECTIVE_ERROR_FACTOR
    growth = np.maximum(integrated.defects.max(axis=1), misjudged_there) / INTEGRATION_SHARE
    # An overrun at its limit asks for as much refinement as a state at its tolerance.
    growth = np.maximum(growth, beyond / OVERRUN_SHARE * problem.tolerance / INTEGRATION_SHARE)
    return OdeCertificate(
        effort_excess=max(0.0, float(over)),
        integration_error=error,
        integrated_objective=integrated.objective,
        objective_error=float(abs(misjudged[-1])),
        overrun=float(beyond.max()),
        state_margin=state_margin,
        leaves_states=bool(outside.any()),
        path_margin=path_margin,
        path_overrun=np.maximum(0.0, -by_interval),
        touching=touching,
        boundary_error=boundary,
        integration_restarts=integrated.restarts,
        growth=np.nan_to_num(growth, nan=np.inf),
        residual_share=np.zeros(len(growth)),
        effort_overrun=np.zeros(len(growth)),
        failures=tuple(failures),
    )


def functions_not_finite(
    problem: OdeProblem, time: np.ndarray, x: np.ndarray, u: np.ndarray, duration_s: float
) -> list[str]:
    """Return the sentences on the problem's functions that are not finite along x (n, n_x) and u (n, n_u) at times (n,)."""
    at, found = (x.T, u.T, problem.parameters, time[None]), []
    for name in ("rate", "running_cost", "path"):
        found += not_finite(name, np.array(problem.at_instant(name)(*at)).reshape(-1, len(time)).T, time)
    for name in ("final_cost", "ends"):
        values = np.array(problem.at_ends(name)(x[0], x[-1], duration_s, problem.parameters)).ravel()
        found += [f"{name} is {as_no_number(value)}" for value in values[~np.isfinite(values)][:1]]
    return found


def sizes_of(x: np.ndarray) -> np.ndarray:
    """Return the sizes (n_x,) of states (n, n_x) along a motion: of what they are and of how far they go."""
    size = np.maximum(np.abs(x).max(axis=0), np.ptp(x, axis=0))
    return np.where(size > 0, size, 1.0)


def _inside(value: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return the margin of values (..., n) within limits (n, 2), negative outside."""
    return np.minimum(value - limit[:, 0], limit[:, 1] - value)


def _in_part(beside: np.ndarray) -> np.ndarray:
    """Return on which intervals (n,) quantities (n_quantities, n, n_points) are at a limit at a point, but not at all."""
    at = beside <= AT_LIMIT_SHARE
    return np.any(at.any(axis=2) & ~at.all(axis=2), axis=0)


def running_cost(problem: OdeProblem, trajectory: OdeTrajectory, chosen: Scheme) -> np.ndarray:
    """Return the running cost of each interval (n,) by the quadrature of the transcription."""
    breaks, m = trajectory.breaks_s, chosen.n_nodes
    # The right end of an interval is the next one's left end, where efforts may jump: a hair inside.
    time = breaks[:-1, None] + np.diff(breaks)[:, None] * np.clip(chosen.nodes, 0.0, 1.0 - 1e-12)
    x, u = trajectory.state_at(time.ravel()).T, trajectory.effort_at(time.ravel()).T
    rate = np.array(problem.at_instant("running_cost")(x, u, problem.parameters, time.reshape(1, -1)))
    return np.diff(breaks) * (rate.reshape(-1, m) @ chosen.weights)


def _boundary_error(problem: OdeProblem, trajectory: OdeTrajectory, size: np.ndarray) -> float:
    """Return the violation of the boundary conditions, relative to the sizes of the states and of psi."""
    first, last = trajectory.state[0, 0, : problem.n_x], trajectory.state[-1, -1, : problem.n_x]
    back = list(problem.returns)
    apart = [relative_violation(first, problem.start.T, size), relative_violation(last, problem.goal.T, size)]
    apart.append(relative_violation(last[back], (first[back], first[back]), size[back]))
    if problem.ends is not None:
        psi = np.array(problem.at_ends("ends")(first, last, trajectory.duration_s, problem.parameters)).ravel()
        apart.append(relative_violation(psi, problem.ends_limit.T, np.maximum(1.0, np.abs(psi))))
    return max(apart)
