"""Integration under a plan's efforts, interval by interval, because efforts may jump at an interval's end.

`strides` takes even steps of Dormand and Prince's method of order eight (Hairer, Norsett & Wanner, Solving ODEs I, section
II.10), many intervals in one call of a CasADi function, and then checks the method's own error estimate. `flow` is scipy's
version with adaptive steps, for intervals on which even steps are too long, or the implicit method Radau IIA of order five
(ibid. II, section IV.8), for intervals on which damping makes explicit steps too short.
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.compiled.functions import on_arrays
from linkplan.models.deadline import NO_DEADLINE, Deadline, check
from linkplan.models.poses.along import evaluated
from linkplan.planner.certificate.dormand_prince import E3, E5, A, B, C

# Least relative error tolerance of the integration: two digits below the 1e-10 of certificates. The absolute one is a tenth.
INTEGRATION_RTOL = 1e-12
# Largest number of evaluations of the dynamics on one interval: sixteen hundred explicit or three thousand implicit steps.
# Feasible motions need about ten steps. At a fold, where the reduced dynamics end, steps become ever smaller.
_MAX_EVALUATIONS = 20_000
# Number of evaluations after which an interval counts as stiff and the implicit method takes over, if there is one: ten
# times as many as feasible motions need. A hand whose joints' damping acts within 10 us takes 20,000 explicit ones, and 400
# implicit ones.
STIFF_EVALUATIONS = 2_000
# Numbers of intervals in one call, few at first: if a step is too long, all that follow in the call are lost.
_STRETCHES = (1, 4, 16, 64)
# Growth of an error at which the integration is restarted. Rounding times this is far below a certificate's 0.01 deg.
RESTART_GROWTH = 1e4
# Finite differences of a state by the state at the beginning of an interval take this step, in units.
ERROR_STEP = 1e-6

# From the time since the beginning of an interval [s] and the state (n,) to its rate (n,).
Rate = Callable[[float, np.ndarray], np.ndarray]


class _TooManyStepsError(Exception):
    """Integration of an interval needs more evaluations than any feasible motion, or more time than the deadline allows."""


def flow(
    rate: Rate,
    width_s: float,
    state: np.ndarray,
    shares: np.ndarray,
    until: Deadline = NO_DEADLINE,
    most: int | None = None,
    rtol: float = INTEGRATION_RTOL,
    *,
    stiff: bool = False,
) -> np.ndarray | None:
    """Return the states (m, n) at shares (m,) of an interval, from the state at its beginning; None if it fails.

    Integration also fails after `most` evaluations of the rate, by default more than any feasible motion needs, and when the
    deadline `until` passes. `stiff` chooses the implicit method.
    """
    import scipy

    atol = 0.1 * rtol * np.maximum(1.0, np.abs(state))
    # An infeasible motion may diverge. The result then says so, or the implicit method raises an error for infinite numbers.
    with np.errstate(all="ignore"):
        try:
            result = scipy.integrate.solve_ivp(
                _counted(rate, until, most or _MAX_EVALUATIONS),
                (0.0, width_s),
                state,
                method="Radau" if stiff else "DOP853",
                rtol=rtol,
                atol=atol,
                t_eval=shares * width_s,
            )
        except (_TooManyStepsError, ValueError, np.linalg.LinAlgError):
            return None
    reached = result.success and result.y.shape[1] == len(shares) and np.all(np.isfinite(result.y[:, -1]))
    return result.y.T if reached else None


def _counted(rate: Rate, until: Deadline, most: int) -> Rate:
    """Return a right-hand side that raises `_TooManyStepsError` after `most` calls or after the deadline."""
    calls = itertools.count()

    def counted(t: float, y: np.ndarray) -> np.ndarray:
        check()
        call = next(calls)
        if call > most or (call % 16 == 0 and until.passed):  # reading the clock takes as long as a small model
            raise _TooManyStepsError
        return rate(t, y)

    return counted


def strides(
    rate: ca.Function,
    widths_s: np.ndarray,
    inputs: np.ndarray,
    state: np.ndarray,
    until: Deadline = NO_DEADLINE,
    rtol: float = INTEGRATION_RTOL,
) -> np.ndarray:
    """Return the states (m, 2, n) at the middle and end of the first m intervals, up to the first too long step.

    Args:
        rate: (state (n,), input (k,), share of the interval) to the state's rate (n,).
        widths_s: (n_intervals,) [s].
        inputs: (n_intervals, k), constant on each interval.
        state: (n,) at the start.
        until: deadline.
        rtol: relative error tolerance.
    """
    found: list[np.ndarray] = [np.empty((0, 2, len(state)))]
    begin, longest = 0, 4
    while begin < len(widths_s) and not until.passed:
        check()
        length = max(length for length in _STRETCHES if length <= min(longest, len(widths_s) - begin))
        some = slice(begin, begin + length)
        ends, middles, errors = evaluated(_stretch(rate, length), state, inputs[some].T, widths_s[some])
        short = _short(np.column_stack([state, ends[:, :-1]]), ends, errors, 2, rtol)
        good = length if np.all(short) else int(np.argmin(short)) // 2
        found.append(np.stack([middles, ends]).transpose(2, 0, 1)[:good])
        if good < length:
            break
        state, begin, longest = ends[:, -1], begin + length, 4 * longest
    return np.concatenate(found)


def side_by_side(
    rate: ca.Function,
    widths_s: np.ndarray,
    inputs: np.ndarray,
    states: np.ndarray,
    shares: np.ndarray,
    until: Deadline = NO_DEADLINE,
    halvings: int = 3,
) -> np.ndarray | None:
    """Return the states (n_intervals, m, n) at shares of every interval, each from its own initial state; None on failure.

    One step leads from each share to the next, for all intervals in one call. Intervals with too long steps are repeated
    with half of them, `halvings` times, and then by `flow`.

    Args:
        rate: see `strides`.
        widths_s: (n_intervals,) [s].
        inputs: (n_intervals, k), constant on each interval.
        states: (n_intervals, n) at their beginnings.
        shares: (m,) of an interval, increasing, above 0 and up to 1.
        until: deadline.
        halvings: see above.
    """
    n, ends, found = len(widths_s), states.T, []
    good, one, slope = np.ones(n, dtype=bool), _step(rate).map(n), rate.map(n)
    with np.errstate(all="ignore"):  # a motion may diverge within an interval, which `flow` then confirms
        (slopes,) = evaluated(slope, ends, inputs.T, np.zeros(n))
        for at, to in itertools.pairwise(np.append(0.0, shares)):
            check()
            before = ends
            ends, slopes, *errors = evaluated(
                one, ends, slopes, inputs.T, (to - at) * widths_s, np.full(n, at), np.full(n, to - at)
            )
            good &= _short(before, ends, np.vstack(errors), 1, INTEGRATION_RTOL) & np.all(np.isfinite(ends), axis=0)
            found.append(ends.T)
    reached = np.stack(found, axis=1)
    long = np.flatnonzero(~good)
    if halvings and len(long):
        finer = np.column_stack([shares - 0.5 * np.diff(shares, prepend=0.0), shares]).ravel()
        again = side_by_side(rate, widths_s[long], inputs[long], states[long], finer, until, halvings - 1)
        if again is None:
            return None
        reached[long] = again[:, 1::2]
        return reached
    for k in long:
        again = flow(called(rate, inputs[k], widths_s[k]), widths_s[k], states[k], shares, until)
        if again is None:
            return None
        reached[k] = again
    return reached


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ErrorsAlong:
    """The integrated motion beside a planned one, interval by interval.

    `states` (n, 1 + m, n_y) are the integrated states at the intervals' beginnings and at shares of them, to first order;
    `errors` (n, k) the distances from the planned states at the intervals' ends, and `defects` (n, k) what each interval
    adds to them, both in units. `restarts` counts the restarts.
    """

    states: np.ndarray
    errors: np.ndarray
    defects: np.ndarray
    restarts: int


def errors_along(
    rate: ca.Function,
    widths_s: np.ndarray,
    inputs: np.ndarray,
    states: np.ndarray,
    judged: Sequence[int],
    ends: np.ndarray,
    unit: np.ndarray,
    shares: np.ndarray,
    most: float,
    until: Deadline,
) -> ErrorsAlong:
    """Return the errors of a planned motion whose every interval is integrated from the planned state.

    The transition matrices of the intervals are finite differences. They carry errors along the motion to first order.
    If an interval cannot be integrated, all errors are infinite and the states NaN.

    Args:
        rate: see `strides`.
        widths_s: (n,) [s].
        inputs: (n, k_inputs), constant on each interval.
        states: (n, 1 + k, n_y) planned at the beginnings, and beside these by `ERROR_STEP` of each judged state's unit.
        judged: the k entries of a state whose errors count.
        ends: (n, k) planned at the intervals' ends.
        unit: (k,) of the judged states.
        shares: see `side_by_side`.
        most: see `propagated`.
        until: deadline.
    """
    n, count, n_y = states.shape
    widths, given = np.repeat(widths_s, count), np.repeat(inputs, count, axis=0)
    reached = side_by_side(rate, widths, given, states.reshape(-1, n_y), shares, until)
    if reached is None:
        lost = np.full(ends.shape, np.inf)
        unknown = np.full((n, 1 + len(shares), n_y), np.nan)
        return ErrorsAlong(states=unknown, errors=lost, defects=lost, restarts=0)
    reached = np.concatenate([states[:, :, None], reached.reshape(n, count, len(shares), n_y)], axis=2)
    slopes = (reached[:, 1:] - reached[:, :1]) / ERROR_STEP  # by errors in units
    defects = (reached[:, 0, -1][:, judged] - ends) / unit
    begins, errors, restarts = propagated(defects, slopes[:, :, -1][:, :, judged].swapaxes(1, 2) / unit[:, None], most)
    along = reached[:, 0] + np.einsum("nkmy,nk->nmy", slopes, begins)
    return ErrorsAlong(states=along, errors=np.abs(errors), defects=defects, restarts=restarts)


def propagated(defects: np.ndarray, transitions: np.ndarray, most: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the errors (n, k) at the begin and at the end of every interval, and the number of restarts.

    Args:
        defects: (n, k) that the intervals add to an error, in units.
        transitions: (n, k, k), by which they multiply the error before.
        most: the errors are restarted at zero wherever one made before would have grown by more than this factor.
    """
    begins, ends, restarts = np.zeros_like(defects), np.zeros_like(defects), 0
    error, carried = np.zeros(defects.shape[1]), np.eye(defects.shape[1])
    for k, (defect, transition) in enumerate(zip(defects, transitions, strict=True)):
        begins[k], ends[k] = error, transition @ error + defect
        error, carried = ends[k], transition @ carried
        # The spectral norm bounds an error's growth: that of a product is at most the product of the norms. An error that
        # has shrunk below one made now can be forgotten.
        grown = np.linalg.norm(carried, 2)
        if grown > most:
            error, restarts = np.zeros_like(error), restarts + 1
        if not 1 <= grown <= most:
            carried = np.eye(len(error))
    return begins, ends, restarts


def scaled_defects(defects: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Return the sizes of defects (n, k) in shares of which the largest errors of (n, k) are the sum."""
    sizes = np.abs(defects)
    return sizes * np.abs(errors).max(axis=0) / np.maximum(sizes.sum(axis=0), np.finfo(float).tiny)


def called(function: ca.Function, inputs: np.ndarray, width: float) -> Rate:
    """Return a right-hand side on an interval for numpy.

    The function is called thousands of times per motion, so CasADi reads and writes numpy's memory without copies.
    """
    state, flat, at, result = np.zeros(function.size1_in(0)), np.array(inputs), np.zeros(1), np.zeros(function.size1_out(0))
    evaluate = on_arrays(function, (state, flat, at), (result,))

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        state[:], at[0] = y, t / width
        evaluate()
        return np.array(result)

    return rate


@np.errstate(all="ignore")  # a motion may diverge within a step, which is then too long
def _short(before: np.ndarray, ends: np.ndarray, errors: np.ndarray, steps: int, rtol: float) -> np.ndarray:
    """Return a mask (steps * m,) of short enough steps from states (n, m) to (n, m), by their errors (2 n, steps * m)."""
    scale = rtol * (0.1 * np.maximum(1.0, np.abs(before)) + np.maximum(np.abs(before), np.abs(ends)))
    fifth, third = (np.square(e / np.repeat(scale, steps, axis=1)).sum(axis=0) for e in np.split(errors, 2))
    return fifth <= np.sqrt((fifth + 0.01 * third) * len(before))


@functools.lru_cache(maxsize=16)
def _stretch(rate: ca.Function, length: int) -> ca.Function:
    """Return (state, inputs, widths) -> states at the ends and middles of intervals, errors of the steps."""
    one = _over_interval(rate)
    return one if length == 1 else one.mapaccum(length)


@functools.lru_cache(maxsize=16)
def _over_interval(rate: ca.Function) -> ca.Function:
    """Return (state, inputs, width) -> states at an interval's end and middle, errors of its two steps.

    Adaptive methods take one or two on a four-bar's meshes.
    """
    begin, given, width = (ca.MX.sym(name, n) for name, n in (("x", rate.size1_in(0)), ("c", rate.size1_in(1)), ("T", 1)))
    one, x, slope, states, errors = _step(rate), begin, rate(begin, given, 0.0), [], []
    for at in (0.0, 0.5):
        x, slope, *of_step = one(x, slope, given, 0.5 * width, at, 0.5)
        states.append(x)
        errors.append(of_step)
    both = ca.vertcat(*(ca.horzcat(*of) for of in zip(*errors, strict=True)))
    return ca.Function("stride", [begin, given, width], [x, states[0], both])


def _step(rate: ca.Function) -> ca.Function:
    """Return one step of h seconds: (state, its rate, inputs, h, share at its beginning, its share) -> state, rate, errors.

    The errors are the estimates of orders five and three.
    """
    n = rate.size1_in(0)
    begin, slope, given = ca.MX.sym("x", n), ca.MX.sym("k", n), ca.MX.sym("c", rate.size1_in(1))
    h, at, long = ca.MX.sym("h"), ca.MX.sym("at"), ca.MX.sym("long")
    slopes = [slope]

    def combined(weights: Sequence[float]) -> ca.MX:
        used = [j for j, weight in enumerate(weights[: len(slopes)]) if weight]
        return ca.horzcat(*[slopes[j] for j in used]) @ ca.DM(np.asarray(weights)[used])

    for row, share in zip(A[1:], C[1:], strict=True):
        slopes.append(rate(begin + h * combined(row), given, at + float(share) * long))
    end = begin + h * combined(B)
    slopes.append(rate(end, given, at + long))
    fifth, third = (h * combined(weights) for weights in (E5, E3))
    return ca.Function("step", [begin, slope, given, h, at, long], [end, slopes[-1], fifth, third])
