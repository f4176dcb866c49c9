"""Integration under a plan's efforts, interval by interval, because efforts may jump at an interval's end.

`strides` takes steps of Dormand and Prince's method of order eight (Hairer, Norsett & Wanner, Solving ODEs I, section
II.10), many in one call of a CasADi function, and then checks the method's own error estimate. `implicit` is scipy's method
Radau IIA of order five (ibid. II, section IV.8), for intervals on which damping makes explicit steps too short.
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
# Largest number of evaluations of the dynamics on one interval by implicit steps, of which it takes three thousand. At a
# fold, where the reduced dynamics end, steps become ever smaller.
_MAX_EVALUATIONS = 20_000
# The shares of an interval at which states are returned by default, with one step each where that is exact enough.
HALVES = np.array([0.5, 1.0])
# The most parts of such a step, and the most steps in them: five hundred times as many as motions usually need. An interval
# that needs more counts as stiff. A hand whose joints' damping acts within 10 us takes sixteen hundred explicit steps, and
# 400 evaluations of implicit ones.
_MOST_PARTS, _MOST_STEPS = 2**16, 1000
# Numbers of steps in one call, few at first: if a step is too long, all that follow in the call are lost.
_STRETCHES, _FIRST_STRETCH = (1, 2, 8, 32, 128), 2
# Growth of an error at which the integration is restarted. Rounding times this is far below a certificate's 0.01 deg.
RESTART_GROWTH = 1e4
# Finite differences of a state by the state at the beginning of an interval take this step, in units.
ERROR_STEP = 1e-6

# From the time since the beginning of an interval [s] and the state (n,) to its rate (n,).
Rate = Callable[[float, np.ndarray], np.ndarray]


class _TooManyStepsError(Exception):
    """Integration of an interval needs more evaluations than any feasible motion, or more time than the deadline allows."""


def implicit(
    rate: Rate,
    width_s: float,
    state: np.ndarray,
    shares: np.ndarray,
    until: Deadline = NO_DEADLINE,
    rtol: float = INTEGRATION_RTOL,
) -> np.ndarray | None:
    """Return the states (m, n) at shares (m,) of a stiff interval, from the state at its beginning; None if it fails.

    Integration also fails after more evaluations of the rate than any feasible motion needs, and when the deadline `until`
    passes.
    """
    import scipy

    atol = 0.1 * rtol * np.maximum(1.0, np.abs(state))
    # An infeasible motion may diverge. The result then says so, or the method raises an error for infinite numbers.
    with np.errstate(all="ignore"):
        try:
            result = scipy.integrate.solve_ivp(
                _counted(rate, until),
                (0.0, width_s),
                state,
                method="Radau",
                rtol=rtol,
                atol=atol,
                t_eval=shares * width_s,
            )
        except (_TooManyStepsError, ValueError, np.linalg.LinAlgError):
            return None
    reached = result.success and result.y.shape[1] == len(shares) and np.all(np.isfinite(result.y[:, -1]))
    return result.y.T if reached else None


def _counted(rate: Rate, until: Deadline) -> Rate:
    """Return a right-hand side that raises `_TooManyStepsError` after too many calls or after the deadline."""
    calls = itertools.count()

    def counted(t: float, y: np.ndarray) -> np.ndarray:
        check()
        call = next(calls)
        if call > _MAX_EVALUATIONS or (call % 16 == 0 and until.passed):  # reading the clock takes as long as a small model
            raise _TooManyStepsError
        return rate(t, y)

    return counted


def strides(
    rate: ca.Function,
    widths_s: np.ndarray,
    inputs: np.ndarray,
    state: np.ndarray,
    shares: np.ndarray = HALVES,
    until: Deadline = NO_DEADLINE,
    rtol: float = INTEGRATION_RTOL,
) -> np.ndarray:
    """Return the states (m, n_shares, n) at shares of the first m intervals, up to one that needs too short steps.

    One step leads from each share to the next, or 2, 4, 8, ... steps where it is too long.

    Args:
        rate: (state (n,), input (k,), share of the interval) to the state's rate (n,).
        widths_s: (n_intervals,) [s].
        inputs: (n_intervals, k), constant on each interval.
        state: (n,) at the start.
        shares: (n_shares,) of an interval, increasing, above 0 and up to 1.
        until: deadline.
        rtol: relative error tolerance.
    """
    begins, gaps = np.append(0.0, shares[:-1]), np.diff(shares, prepend=0.0)
    found, steps = list[np.ndarray](), 0  # steps since the last share
    # Places and lengths of steps are counted in parts of the gap between two shares. Here: the place reached, the end, and
    # the largest length of the next step.
    done, last, largest, longest = 0, len(widths_s) * len(shares) * _MOST_PARTS, _MOST_PARTS, _FIRST_STRETCH
    while done < last and steps < _MOST_STEPS and not until.passed:
        check()
        size = min(largest, done & -done or largest)  # the place is a multiple of it
        most = min(longest, (last - done) // size) if size == largest else 1
        places = done + size * np.arange(max(length for length in _STRETCHES if length <= most))
        gap, part = np.divmod(places, _MOST_PARTS)
        k, j = np.divmod(gap, len(shares))
        at, long = begins[j] + part / _MOST_PARTS * gaps[j], size / _MOST_PARTS * gaps[j]
        ends, errors = evaluated(_steps(rate, len(places)), state, inputs[k].T, long * widths_s[k], at, long)
        share = _share_of_error(np.column_stack([state, ends[:, :-1]]), ends, errors, rtol)
        good = len(places) if np.all(share <= 1.0) else int(np.argmin(share <= 1.0))
        for place, end in zip(places[:good], ends.T, strict=False):
            steps += 1
            if (place + size) % _MOST_PARTS == 0:
                found.append(end)
                steps = 0
        done, state = done + good * size, ends[:, good - 1] if good else state
        if good == len(places):
            # Errors are of order eight; where rounding errors dominate, they do not grow with the step.
            doublings = int(
                np.clip(np.log2(0.9 * max(share[-1], 1e-30) ** -0.125), float(len(places) > _FIRST_STRETCH), 3.0)
            )
            largest = min(_MOST_PARTS, size << doublings)
            longest = 4 * longest if largest == size else _FIRST_STRETCH
        elif size > 1:
            largest, longest = size // 2, _FIRST_STRETCH
        else:
            break
    m = len(found) // len(shares)
    return np.array(found[: m * len(shares)]).reshape(m, len(shares), len(state))


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
    with half of them, `halvings` times, and then one by one by `strides`.

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
    good, step = np.ones(n, dtype=bool), _step(rate).map(n)
    with np.errstate(all="ignore"):  # a motion may diverge within an interval, which `strides` then confirms
        for at, to in itertools.pairwise(np.append(0.0, shares)):
            check()
            before = ends
            ends, errors = evaluated(step, ends, inputs.T, (to - at) * widths_s, np.full(n, at), np.full(n, to - at))
            good &= (_share_of_error(before, ends, errors, INTEGRATION_RTOL) <= 1.0) & np.all(np.isfinite(ends), axis=0)
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
        again = strides(rate, widths_s[k : k + 1], inputs[k : k + 1], states[k], shares, until)
        if not len(again):
            return None
        reached[k] = again[0]
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
        states: (n, 1 + k, n_y) planned at the beginnings, and these with each judged state off by `ERROR_STEP` of its unit.
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
    """Return the errors (n, k) at the beginning and at the end of every interval, and the number of restarts.

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
def _share_of_error(before: np.ndarray, ends: np.ndarray, errors: np.ndarray, rtol: float) -> np.ndarray:
    """Return the errors (m,) of steps from states (n, m) to (n, m) as shares of the allowed ones, from `errors` (2 n, m).

    `errors` are the estimates of orders five and three. The share of a step that diverges is infinite.
    """
    scale = rtol * (0.1 * np.maximum(1.0, np.abs(before)) + np.maximum(np.abs(before), np.abs(ends)))
    fifth, third = (np.square(e / scale).sum(axis=0) for e in np.split(errors, 2))
    share = fifth / np.maximum(np.sqrt((fifth + 0.01 * third) * len(before)), np.finfo(float).tiny)
    return np.nan_to_num(share, nan=np.inf, posinf=np.inf)


@functools.lru_cache(maxsize=16)
def _steps(rate: ca.Function, length: int) -> ca.Function:
    """Return successive steps: (state, and the other inputs of `_step` for each of them) -> states, errors."""
    return _step(rate) if length == 1 else _step(rate).mapaccum(length)


@functools.lru_cache(maxsize=16)
def _step(rate: ca.Function) -> ca.Function:
    """Return one step of h seconds: (state, inputs, h, share at its beginning, its share) -> state, errors.

    The errors (2 n,) are the estimates of orders five and three.
    """
    n = rate.size1_in(0)
    begin, given = ca.MX.sym("x", n), ca.MX.sym("c", rate.size1_in(1))
    h, at, long = ca.MX.sym("h"), ca.MX.sym("at"), ca.MX.sym("long")
    slopes: list[ca.MX] = []

    def combined(weights: Sequence[float]) -> ca.MX:
        used = [j for j, weight in enumerate(weights[: len(slopes)]) if weight]
        return ca.horzcat(*[slopes[j] for j in used]) @ ca.DM(np.asarray(weights)[used])

    for row, share in zip(A, C, strict=True):
        state = begin + h * combined(row) if slopes else begin
        slopes.append(rate(state, given, at + float(share) * long))
    end = begin + h * combined(B)
    slopes.append(rate(end, given, at + long))
    return ca.Function("step", [begin, given, h, at, long], [end, ca.vertcat(*(h * combined(of) for of in (E5, E3)))])
