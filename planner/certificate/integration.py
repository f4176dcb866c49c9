"""Integration of the reduced model under a plan's efforts, its errors against the plan, and errors of boundary states.

As a rule the model is integrated once from the start to the end. Along an unstable motion (one that passes upright, or waits
there) errors grow by many orders of magnitude, and after some seconds rounding determines the final state. Then every
interval is integrated from the planned state, its defect is propagated by the motion's own transition matrices, and the
integration is restarted whenever an error would have grown by `RESTART_GROWTH`. The certificate then shows that the plan is
a motion of the model, not that open-loop control could follow it. The number of restarts is reported.
"""

import contextlib
import functools
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from linkplan.models.deadline import NO_DEADLINE, Deadline, OutOfTimeError
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.assembly import strides as one_stride
from linkplan.planner.certificate.flow import (
    ERROR_STEP,
    HALVES,
    INTEGRATION_RTOL,
    RESTART_GROWTH,
    called,
    errors_along,
    implicit,
    scaled_defects,
    strides,
)
from linkplan.planner.problem.instant import position_units
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import BodyAngle, Task, key_of
from linkplan.planner.trajectory import VELOCITY_SHARE, Trajectory
from linkplan.planner.transcription.bernstein import bernstein_part, bernstein_value

# Boundary states, and sites and bodies at them, are constraints of the program and kept to rounding: the allowed error as a
# share of the motion's span or largest speed, or of the mechanism's extent.
BOUNDARY_SHARE = 1e-6
Bounds = tuple[np.ndarray, np.ndarray] | np.ndarray
# Start and goal may exceed a limit by this share of its size, because inverse kinematics and rounding are inexact.
POSE_SLACK = 2e-9
# The least length of a part of an interval, as a share of it: a bend of a force closer to an end counts as at that end.
_CUT_SHARE = 1e-7


def relative_violation(values: np.ndarray, bounds: Bounds, size: np.ndarray | float) -> float:
    """Return the largest amount, in units of `size`, by which values (..., n) lie outside the bounds, low and high (2, n).

    It is 0 if all are inside.
    """
    low, high = bounds
    return float((np.maximum(low - values, values - high) / size).max(initial=0.0))


def ends_off_m(problem: Problem, trajectory: Trajectory, time: np.ndarray, q: np.ndarray) -> tuple[float, tuple[str, ...]]:
    """Return the largest error [m] of the sites and bodies prescribed at start, waypoints and goal, and sentences on errors.

    The error of a body's angle is the arc at the mechanism's extent.

    Args:
        problem: the problem; the goal of a periodic motion lies in its middle.
        trajectory: the motion.
        time: (n,) [s] along it, from its start to its end.
        q: poses (n, n_q) at those times.
    """
    worst, failures, motion = 0.0, [], problem.motion
    goal_s = trajectory.breaks_s[0] + (0.5 if motion.kind == "periodic" else 1.0) * trajectory.duration_s
    for name, points, at in (("start", motion.start_at, trajectory.breaks_s[0]), ("goal", motion.goal_at, goal_s)):
        if not points:
            continue
        near = q[int(np.argmin(np.abs(time - at)))]
        pose = follow(problem.mechanism, trajectory.position_at(np.array([at])), near, problem.solver.judging_deadline)[0]
        for point in points:
            off = float(point.off_m(problem.mechanism, pose)[0])
            worst = max(worst, off)
            if not off <= BOUNDARY_SHARE * problem.mechanism.extent_m:
                failures.append(_off_sentence(problem, point, off, f"motion.{name}_{{}}"))
    for k, waypoint in enumerate(motion.waypoints):
        if waypoint.at:
            apart = waypoint_off_m(problem, trajectory, waypoint, waypoint_times(trajectory, waypoint))
            off, point = float(apart.max(axis=1).min()), waypoint.at[int(apart[apart.max(axis=1).argmin()].argmax())]
            worst = max(worst, off)
            if not off <= BOUNDARY_SHARE * problem.mechanism.extent_m:
                failures.append(_off_sentence(problem, point, off, f"motion.waypoints[{k}].{{}}"))
    return worst, tuple(failures)


def _off_sentence(problem: Problem, point: Task, off_m: float, where: str) -> str:
    off = f"{off_m:.3g} m"
    if isinstance(point, BodyAngle):
        off = f"{np.degrees(off_m / problem.mechanism.extent_m):.3g} deg"
    return f"{point.label} is {off} away from the place that {key_of([point], where)} gives"


def waypoint_times(trajectory: Trajectory, waypoint: Waypoint) -> np.ndarray:
    """Return the times (n,) [s] at which a motion may pass a waypoint: its own time, or all breaks if that is free."""
    return trajectory.breaks_s if waypoint.time_s is None else trajectory.breaks_s[:1] + waypoint.time_s


def waypoint_off_m(problem: Problem, trajectory: Trajectory, waypoint: Waypoint, time: np.ndarray) -> np.ndarray:
    """Return the errors [m] (n, n_tasks) of a waypoint's sites and bodies at times (n,) [s], as in `ends_off_m`."""
    if not waypoint.at:
        return np.zeros((len(time), 1))
    # Loops are followed from break to break, so the result does not depend on the given times.
    along, back = np.unique(np.concatenate([trajectory.breaks_s, time]), return_inverse=True)
    until = problem.solver.judging_deadline
    poses = follow(problem.mechanism, trajectory.position_at(along), trajectory.start_pose, until)
    q = poses[back[len(trajectory.breaks_s) :]]
    return np.array([point.off_m(problem.mechanism, q) for point in waypoint.at]).T


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Integrated:
    """Errors of the integrated model against a plan.

    `position` (n_s,) [rad or m] and `velocity` [share of the largest speed] are the largest errors. `growth` (n_intervals,)
    is each interval's contribution in shares of `allowed`. `restarts` counts the restarts.
    """

    position: np.ndarray
    velocity: float
    growth: np.ndarray
    restarts: int


def integrate(
    mechanism: Mechanism,
    trajectory: Trajectory,
    speed: float,
    allowed: np.ndarray,
    until: Deadline = NO_DEADLINE,
    rtol: float = INTEGRATION_RTOL,
) -> Integrated:
    """Return the integrated model's errors against a plan.

    All joints are integrated, q' = Gamma v, v' = M_r^-1 (...), so closure is a result and not an assumption.

    Args:
        mechanism: the model.
        trajectory: the plan.
        speed: its largest speed [rad/s or m/s].
        allowed: errors (n_s,) [rad or m] above which the motion is checked for instability, as it is for those of velocity.
        until: deadline of the integration.
        rtol: relative error tolerance of the integration without restarts.
    """
    # Cut into intervals over which forces over time are cubics.
    breaks, shares = trajectory.breaks_s, [np.array([0.0, 1.0])] * (len(trajectory.breaks_s) - 1)
    times = np.zeros(0) if mechanism.forces is None else mechanism.forces.curve.inner_times(float(breaks[-1]))
    for k in np.unique(np.searchsorted(breaks, times, side="right") - 1):
        at = (times - breaks[k]) / (breaks[k + 1] - breaks[k])
        shares[k] = np.concatenate([[0.0], at[(at > _CUT_SHARE) & (at < 1 - _CUT_SHARE)], [1.0]])
    trajectory, first = _cut(trajectory, shares)
    found = _integrated_once(mechanism, trajectory, speed, allowed, until, rtol)
    if not (until.passed or (np.all(found.position <= allowed) and found.velocity <= VELOCITY_SHARE)):
        with contextlib.suppress(AssemblyError, OutOfTimeError):  # the motion is infeasible, or the deadline has passed
            found = _integrated_with_restarts(mechanism, trajectory, speed, allowed, until) or found
    return replace(found, growth=np.add.reduceat(found.growth, first))


def _integrated_once(
    mechanism: Mechanism, trajectory: Trajectory, speed: float, allowed: np.ndarray, until: Deadline, rtol: float
) -> Integrated:
    """Return the errors of one integration, sampled at the middle of every interval and on both sides of every break."""
    n_q, independent = mechanism.n_q, mechanism.independent
    start = follow(mechanism, trajectory.position[0, :1], trajectory.start_pose)[0]
    state = np.concatenate([start, trajectory.velocity[0, 0]])
    n = len(trajectory.breaks_s) - 1
    errors, velocity_error = np.full((n, mechanism.dof), np.inf), np.inf
    reached = _states(mechanism, trajectory, state, until, rtol)
    m = len(reached) - 1
    planned, speeds = (
        np.stack([bernstein_value(c[:, :m], tau) for tau in (0.0, 0.5, 1.0)], axis=1)
        for c in (trajectory.position, trajectory.velocity)
    )
    inside = np.stack([reached[:-1, 1], reached[1:, 0], reached[1:, 1]], axis=1)
    errors[:m] = np.abs(inside[:, :, independent] - planned).max(axis=1, initial=0.0)
    if m == n:
        velocity_error = float(np.abs(inside[:, :, n_q:] - speeds).max()) / speed
    with np.errstate(invalid="ignore"):  # after a failed integration: infinity minus infinity
        growth = np.abs(np.diff(np.vstack([np.zeros(mechanism.dof), errors]), axis=0) / allowed).max(axis=1)
    growth = np.nan_to_num(growth, nan=np.inf)
    return Integrated(position=errors.max(axis=0), velocity=velocity_error, growth=growth, restarts=0)


def _integrated_with_restarts(
    mechanism: Mechanism, trajectory: Trajectory, speed: float, allowed: np.ndarray, until: Deadline
) -> Integrated | None:
    """Return the errors propagated from interval to interval with restarts; None if no restart was needed."""
    n_s, n_q = mechanism.dof, mechanism.n_q
    span = position_units(mechanism, trajectory.position)
    unit = np.concatenate([span, np.full(n_s, speed)])
    poses = follow(mechanism, trajectory.position[0], trajectory.start_pose, until)
    if _linear_growth(mechanism, trajectory, poses, unit) < 0.1 * RESTART_GROWTH:  # saves 2 n_s integrations
        return None
    trajectory, first = _in_pieces(mechanism, trajectory, poses)
    n, widths = len(trajectory.breaks_s) - 1, np.diff(trajectory.breaks_s)
    function, inputs = _rate(mechanism, *trajectory.effort[:, 0].shape), _inputs(mechanism, trajectory)
    begins = np.hstack([trajectory.position[0], trajectory.velocity[0]])
    ends = np.hstack([trajectory.position[-1], trajectory.velocity[-1]])
    poses = follow(mechanism, trajectory.position[0], trajectory.start_pose, until)
    aside = np.vstack([np.zeros(2 * n_s), ERROR_STEP * np.diag(unit)])
    starts = (begins[:, None] + aside).reshape(-1, 2 * n_s)
    closed = one_stride(mechanism, np.repeat(poses, len(aside), axis=0), starts[:, :n_s])
    states = np.hstack([closed, starts[:, n_s:]]).reshape(n, len(aside), -1)
    if not np.all(np.isfinite(states)):  # next to a singular pose the loops may not close at a slightly different position
        return None
    judged = [*mechanism.independent, *range(n_q, n_q + n_s)]
    found = errors_along(function, widths, inputs, states, judged, ends, unit, HALVES, RESTART_GROWTH, until)
    if not found.restarts:
        return None
    errors, defects = found.errors, found.defects
    adds = scaled_defects(defects[:, :n_s], errors[:, :n_s]) * span
    return Integrated(
        position=errors[:, :n_s].max(axis=0) * span,
        velocity=float(errors[:, n_s:].max(initial=0.0)),
        growth=np.maximum.reduceat((adds / allowed).max(axis=1), first),
        restarts=found.restarts,
    )


def _in_pieces(mechanism: Mechanism, trajectory: Trajectory, poses: np.ndarray) -> tuple[Trajectory, np.ndarray]:
    """Return a trajectory cut into intervals over which no error grows to a restart, and each old interval's first part.

    The first parts are indices (n_intervals,). The growth is that at intervals' first poses (n, n_q).
    """
    shares = []
    for width, slope in zip(np.diff(trajectory.breaks_s), _slopes(mechanism, trajectory, poses), strict=True):
        fastest = np.linalg.eigvals(slope).real.max()
        n = max(1, int(np.ceil(2.0 * width * fastest / np.log(RESTART_GROWTH))))
        shares.append(np.arange(n + 1) / n)
    return _cut(trajectory, shares)


def _cut(trajectory: Trajectory, shares: list[np.ndarray]) -> tuple[Trajectory, np.ndarray]:
    """Return a trajectory on parts of its intervals, and the first part (n_intervals,) of each.

    The parts of an interval have ends (n + 1,) at shares of it, from 0 to 1.
    """
    first = np.concatenate([[0], np.cumsum([len(of) - 1 for of in shares])[:-1]]).astype(int)
    if first[-1] == len(shares) - 1 and len(shares[-1]) == 2:
        return trajectory, first
    parts, breaks = [(k, *ends) for k, of in enumerate(shares) for ends in itertools.pairwise(of)], trajectory.breaks_s
    cut = {
        name: np.stack([bernstein_part(len(whole) - 1, begin, end) @ whole[:, k] for k, begin, end in parts], axis=1)
        for name in ("position", "velocity", "effort")
        if len(whole := getattr(trajectory, name))
    }
    at = np.append([breaks[k] + begin * (breaks[k + 1] - breaks[k]) for k, begin, _ in parts], breaks[-1])
    return replace(trajectory, breaks_s=at, **cut), first


def _slopes(mechanism: Mechanism, trajectory: Trajectory, poses: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the slopes of `_slope` at the intervals' first poses (n, n_q)."""
    forces = mechanism.forces_at(trajectory.breaks_s[:-1])
    for q, v, u, *w in zip(poses, trajectory.velocity[0], trajectory.effort[0], *forces, strict=True):
        yield _slope(mechanism, q, v, u, *w)


def _slope(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, u: np.ndarray, *forces: np.ndarray) -> np.ndarray:
    """Return the derivative (2 n_s, 2 n_s) of the rates of s and v by s and v."""
    by_s, by_v, _ = mechanism.forced.linearisation(q, v, u, *forces)
    n_s = mechanism.dof
    return np.block([[np.zeros((n_s, n_s)), np.eye(n_s)], [np.array(by_s), np.array(by_v)]])


def _linear_growth(mechanism: Mechanism, trajectory: Trajectory, poses: np.ndarray, unit: np.ndarray) -> float:
    """Return the largest growth of an error in units, linearised at intervals' first poses (n, n_q).

    Growth beyond that of a restart is not followed.
    """
    eye, largest = np.eye(2 * mechanism.dof), 1.0
    carried = eye
    for width, slope in zip(np.diff(trajectory.breaks_s), _slopes(mechanism, trajectory, poses), strict=True):
        # The exponential by n steps of the trapezoidal rule, which no stiff friction makes unstable.
        n = 64
        half = width / (2 * n) * slope * unit / unit[:, None]
        carried = np.linalg.matrix_power(np.linalg.solve(eye - half, eye + half), n) @ carried
        largest = max(largest, float(np.abs(carried).max()))
        if largest > RESTART_GROWTH:  # over minutes the product overflows
            break
    return largest


def _states(mechanism: Mechanism, trajectory: Trajectory, state: np.ndarray, until: Deadline, rtol: float) -> np.ndarray:
    """Return the states (m + 1, 2, n): the start twice, then the middle and end of every interval before a failure."""
    widths, inputs = np.diff(trajectory.breaks_s), _inputs(mechanism, trajectory)
    rate = _rate(mechanism, *trajectory.effort[:, 0].shape)
    reached, stiff = np.array([[state, state]]), False
    while (k := len(reached) - 1) < len(widths):
        if not stiff:
            found = strides(rate, widths[k:], inputs[k:], reached[-1, 1], until=until, rtol=rtol)
            reached = np.concatenate([reached, found])
        if (k := len(reached) - 1) < len(widths):
            half = implicit(called(rate, inputs[k], widths[k]), widths[k], reached[-1, 1], HALVES, until, rtol)
            if half is None:
                break
            # After one stiff interval the others are taken as stiff too.
            reached, stiff = np.concatenate([reached, half[None]]), True
    return reached


def _inputs(mechanism: Mechanism, trajectory: Trajectory) -> np.ndarray:
    """Return the coefficients of every interval's efforts, and of forces over time, as rows (n_intervals, k).

    Those of the forces belong to powers of the share of the interval, over which they are cubics.
    """
    n, inside = trajectory.effort.shape[1], np.array([0.125, 0.375, 0.625, 0.875])
    to_powers = np.linalg.inv(np.vander(inside, increasing=True))
    forces = [to_powers @ w.reshape(n, 4, -1) for w in mechanism.forces_at(trajectory.times_at(inside))]
    return np.hstack([c.reshape(n, -1) for c in (trajectory.effort.transpose(1, 2, 0), *forces)])


@functools.lru_cache(maxsize=16)
def _rate(mechanism: Mechanism, n_coefficients: int, n_u: int) -> ca.Function:
    """Return the model's right-hand side: (state, coefficients of `_inputs`, share of the interval) to its rate."""
    n, n_forces = mechanism.n_q + mechanism.dof, 0 if mechanism.forces is None else 3 * len(mechanism.forces.sites)
    x, flat, tau = ca.MX.sym("x", n), ca.MX.sym("u", n_coefficients * n_u + 4 * n_forces), ca.MX.sym("tau")
    own, pushing = ca.vertsplit(flat, [0, n_coefficients * n_u, flat.numel()])
    effort = bernstein_value(ca.reshape(own, n_coefficients, n_u), tau).T
    powers = ca.vertcat(1, tau, tau**2, tau**3)
    forces = [ca.reshape(pushing, n_forces, 4) @ powers] if n_forces else []
    rates = mechanism.forced.flow(x[: mechanism.n_q], x[mechanism.n_q :], effort, *forces)
    return ca.Function("rate", [x, flat, tau], [ca.vertcat(*rates)])
