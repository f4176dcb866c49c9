"""The reduced model integrated under a plan's efforts, against the plan.

From the start to the end in one go, as a rule. Where a motion is unstable (it passes upright, or waits there) an error grows
along it by many orders of magnitude, and after some seconds rounding alone decides where the model ends: then every interval
is integrated from the planned state, its defect is propagated by the motion's own transition matrices, and the integration
is restarted wherever an error would have grown by `GROWTH`. What is judged is then whether the plan is a motion of the
model, not whether somebody could follow it blindly; how often it was restarted is reported.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.flow import Rate, flow, flows
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.schemes import bernstein_value

# An error that has grown so much restarts the integration: rounding, grown so, is far below a certificate's hundredth of a
# degree.
GROWTH = 1e4
# Size of the steps by which transition matrices are found, of the motion's spans and speeds.
_STEP = 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Integrated:
    """How far the integrated model is from a plan.

    `position` (n_s,) [rad or m] and `velocity` [share of the largest speed] are the largest errors, `growth` (n_intervals,)
    is what each interval adds to them in shares of `allowed`, `restarts` counts the restarts.
    """

    position: np.ndarray
    velocity: float
    growth: np.ndarray
    restarts: int


def integrate(
    mechanism: Mechanism, trajectory: Trajectory, speed: float, allowed: np.ndarray, until: float = np.inf
) -> Integrated:
    """Return the integrated model's errors against a plan.

    All joints are integrated, q' = Gamma v, v' = M_r^-1 (...): closure is then an outcome and not an assumption.

    Args:
        mechanism: the model.
        trajectory: the plan.
        speed: its largest speed [rad/s or m/s].
        allowed: errors (n_s,) [rad or m] above which the motion is checked for instability.
        until: when integration is given up, on the monotonic clock [s].
    """
    whole = _in_one_go(mechanism, trajectory, speed, allowed, until)
    if np.all(whole.position <= allowed):
        return whole
    try:
        return _anew(mechanism, trajectory, speed, allowed, until) or whole
    except AssemblyError:  # an infeasible motion
        return whole


def _in_one_go(mechanism: Mechanism, trajectory: Trajectory, speed: float, allowed: np.ndarray, until: float) -> Integrated:
    """Return the errors of one integration, sampled in the middle of every interval and on both sides of every break."""
    n_q, independent = mechanism.n_q, mechanism.independent
    start = follow(mechanism, trajectory.position[0, :1], trajectory.start_pose)[0]
    state = np.concatenate([start, trajectory.velocity[0, 0]])
    n = len(trajectory.breaks_s) - 1
    shares = np.array([0.0, 0.5, 1.0])
    errors, velocity_error = np.zeros((n, mechanism.dof)), 0.0
    for k, reached in enumerate(flows(_rate(mechanism, trajectory), trajectory.breaks_s, state, shares, until)):
        if reached is None:
            errors[k:], velocity_error = np.inf, np.inf
            break
        planned = np.array([bernstein_value(trajectory.position[:, k], tau) for tau in shares])
        planned_velocity = np.array([bernstein_value(trajectory.velocity[:, k], tau) for tau in shares])
        errors[k] = np.abs(reached[:, independent] - planned).max(axis=0)
        velocity_error = max(velocity_error, float(np.abs(reached[:, n_q:] - planned_velocity).max()) / speed)
    with np.errstate(invalid="ignore"):  # beyond a failed integration, infinity less infinity
        growth = np.abs(np.diff(np.vstack([np.zeros(mechanism.dof), errors]), axis=0) / allowed).max(axis=1)
    growth = np.nan_to_num(growth, nan=np.inf)
    return Integrated(position=errors.max(axis=0), velocity=velocity_error, growth=growth, restarts=0)


def _anew(
    mechanism: Mechanism, trajectory: Trajectory, speed: float, allowed: np.ndarray, until: float
) -> Integrated | None:
    """Return the errors propagated from interval to interval with restarts; None where the motion is not so unstable."""
    n, n_s, n_q = len(trajectory.breaks_s) - 1, mechanism.dof, mechanism.n_q
    rate_on, widths = _rate(mechanism, trajectory), np.diff(trajectory.breaks_s)
    span = np.maximum(np.ptp(trajectory.position, axis=(0, 1)), np.finfo(float).tiny)
    unit = np.concatenate([span, np.full(n_s, speed)])
    begins = np.hstack([trajectory.position[0], trajectory.velocity[0]])
    ends = np.hstack([trajectory.position[-1], trajectory.velocity[-1]])
    poses = follow(mechanism, trajectory.position[0], trajectory.start_pose)
    last = np.array([1.0])

    def arrives(k: int, begin: np.ndarray) -> np.ndarray | None:
        pose = poses[k] if np.array_equal(begin, begins[k]) else follow(mechanism, begin[None, :n_s], poses[k])[0]
        reached = flow(rate_on(k), widths[k], np.concatenate([pose, begin[n_s:]]), last, until)
        return None if reached is None else np.concatenate([reached[0, :n_q][mechanism.independent], reached[0, n_q:]])

    error, carried = np.zeros(2 * n_s), np.eye(2 * n_s)
    errors, defects, restarts = np.zeros((n, 2 * n_s)), np.zeros((n, n_s)), 0
    for k in range(n):
        there = [arrives(k, begins[k])]
        there += [arrives(k, begins[k] + _STEP * unit[i] * np.eye(2 * n_s)[i]) for i in range(2 * n_s)]
        if any(reached is None for reached in there):
            return None
        transition = (
            np.array([(reached - there[0]) / _STEP for reached in there[1:]]).T / unit[:, None]
        )  # of errors in units
        defect = (there[0] - ends[k]) / unit
        error = transition @ error + defect
        carried = transition @ carried
        errors[k], defects[k] = np.abs(error), np.abs(defect[:n_s])
        if np.abs(carried).max() > GROWTH:
            error, carried, restarts = np.zeros(2 * n_s), np.eye(2 * n_s), restarts + 1
    if not restarts:
        return None
    position = errors[:, :n_s].max(axis=0) * span
    share = position / np.maximum(defects.sum(axis=0) * span, np.finfo(float).tiny)
    growth = (defects * span * share / allowed).max(axis=1)
    velocity = float(errors[:, n_s:].max(initial=0.0))
    return Integrated(position=position, velocity=velocity, growth=growth, restarts=restarts)


def _rate(mechanism: Mechanism, trajectory: Trajectory) -> Callable[[int], Rate]:
    """Return a maker of the model's right-hand side on an interval, by its number, under the plan's efforts there.

    It is called some thousand times per motion: CasADi reads and writes numpy's memory without copies.
    """
    n, shape = mechanism.n_q + mechanism.dof, trajectory.effort[:, 0].shape
    x, coefficients, tau = ca.SX.sym("x", n), ca.SX.sym("u", *shape), ca.SX.sym("tau")
    rates = mechanism.dynamics.flow(x[: mechanism.n_q], x[mechanism.n_q :], bernstein_value(coefficients, tau).T)
    function = ca.Function("rate", [x, coefficients, tau], [ca.vertcat(*rates)], {"cse": True})
    buffer, evaluate = function.buffer()
    # All of these live as long as the right-hand sides: CasADi keeps addresses only.
    state, flat, at, result = np.zeros(n), np.zeros(shape[0] * shape[1]), np.zeros(1), np.zeros(n)
    effort = flat.reshape(shape, order="F")
    for index, array in enumerate((state, flat, at)):
        buffer.set_arg(index, memoryview(array))
    buffer.set_res(0, memoryview(result))
    kept = function, buffer, flat

    widths = np.diff(trajectory.breaks_s)

    def on_interval(k: int) -> Rate:
        values, width = trajectory.effort[:, k], widths[k]

        def rate(t: float, y: np.ndarray, kept=kept) -> np.ndarray:
            del kept
            state[:], effort[...], at[0] = y, values, t / width
            evaluate()
            return np.array(result)

        return rate

    return on_interval
