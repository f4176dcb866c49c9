"""The computing cost of a tracker: memory, stored numbers, floating-point operations and measured time."""

import casadi as ca
import numpy as np
from msgspec import Struct

from linkplan.controllers.rollout import Rollout
from linkplan.controllers.trackers.computed_torque import ComputedTorque
from linkplan.controllers.trackers.integral_lqr import IntegralLQR
from linkplan.controllers.trackers.mpc import HORIZON_BLOCKS, MPC
from linkplan.controllers.trackers.prediction import condensing
from linkplan.controllers.trackers.tracker import AnyTracker, StateFeedback, steps_of
from linkplan.models.mechanism import Mechanism
from linkplan.models.reduction.closing import calls_near


class RunTime(Struct, frozen=True, kw_only=True):
    """A tracker's cost in a control period; None if unknown, for a tracker that is not built in.

    `remembered`: numbers kept from one period to the next. `stored`: numbers stored for each control instant of the plan
    (reference, gains). `operations`: floating-point operations of the law. `operations_at_limit`: the same if predicted
    efforts reach a limit, without the iterations of the quadratic program. `median_us` and `percentile90_us` [us]: measured
    times of this implementation for one state.
    """

    remembered: int
    stored: int | None
    operations: int | None
    operations_at_limit: int | None
    median_us: float
    percentile90_us: float


def run_time(tracker: AnyTracker, mechanism: Mechanism, rollout: Rollout) -> RunTime:
    """Return a tracker's cost, with the times of a run."""
    stored, free, at_limit = _counted(tracker, mechanism)
    times = 1e6 * rollout.asked_s
    return RunTime(
        remembered=int(steps_of(tracker).start(1).shape[1]),
        stored=stored,
        operations=free,
        operations_at_limit=at_limit,
        median_us=float(np.median(times)),
        percentile90_us=float(np.percentile(times, 90)),
    )


def _counted(tracker: AnyTracker, mechanism: Mechanism) -> tuple[int | None, int | None, int | None]:
    """Return the numbers stored per instant, and the operations of a period without and with a limit reached."""
    n_s, n_u, n_q = mechanism.dof, mechanism.n_u, mechanism.n_q
    state, dynamics = 2 * n_s, mechanism.forced
    if isinstance(tracker, StateFeedback):
        added = n_u if tracker.feedforward else 0
        free = state + n_u * (2 * state - 1) + added
        return state + n_u * state + added, free, free
    if isinstance(tracker, IntegralLQR):
        n_i = len(tracker.integrated)
        free = state + 2 * n_u * (state + n_i) + 2 * n_i + 2 * n_u
        return state + n_u + n_u * (state + n_i), free, free
    closing = sum(calls * _size(function) for function, calls in calls_near(dynamics))
    if isinstance(tracker, ComputedTorque):
        free = 8 * n_s + n_u + closing + _size(dynamics.effort_map) + _size(dynamics.inverse_dynamics) + 4 * n_u * n_s
        return state + n_s + n_q + n_u, free, free
    if isinstance(tracker, MPC):
        m, n, many = len(tracker.kept), HORIZON_BLOCKS, HORIZON_BLOCKS * n_u
        free = state + 2 * n_u * m + many * (2 * m + 1)
        # The Runge-Kutta method evaluates the dynamics four times.
        predicted = closing + n * (4 * _size(dynamics.flow) + _size(dynamics.linearisation))
        stored = state + n_s + 2 * n_q + 2 * n_u + m * m + n_u * m * (1 + n)
        return stored, free, free + predicted + _size(condensing(n, m, n_u))
    return None, None, None


def _size(function: ca.Function) -> int:
    """Return the number of operations of a CasADi function, and of those that it calls."""
    if function.is_a("SXFunction"):
        return int(function.n_instructions())
    return int(function.n_nodes()) + sum(_size(inner) for inner in function.find_functions(0))
