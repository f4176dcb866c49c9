"""Constrained arcs: where a motion enters and leaves path limits, and the segments that are fixed on them.

On a constrained arc a limit on power or on a dependent joint's speed is active, and the effort is within its own limit. A
program with rows only at nodes gains by leaving the limit between the nodes, most of all next to a switch. If the limit is
fixed at every node of a segment, nothing can be gained there, and the switch times converge.

A solver with a fixed effort or path quantity finds the best motion under this condition. The multipliers show whether the
limit or the fixing restricts this motion. The reduced gradient of an effort is the integral of the switching function (Betts
2010, section 4.4). On every interval of a correct arc it has the sign of the limit.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.bernstein import bernstein_matrix
from linkplan.planner.transcription.collocation import Transcribed

# A coefficient within this share of the span of the limits counts as at its limit, and so does a path quantity within this
# share of its limit; the solver is exact to 1e-8.
SHARE_AT_LIMIT = 1e-3
# This share of a segment, at each of its ends, is ignored.
SHARE_BESIDE_SWITCHES = 0.15
# An end of an arc within this number of intervals of a switch time is that switch time.
INTERVALS_TO_SAME_SWITCH = 2.5
# If coefficients are at a limit and the curve's distance from it exceeds this share, the coefficients keep the curve away.
# The second constant is the number of samples per interval.
SHARE_OFF_LIMIT, SAMPLES_OF_INTERVAL = 1e-7, 33
# A multiplier of the wrong sign above this share of the largest one is not due to rounding.
WRONG_SIGN_SHARE = 1e-2
# A multiplier of an inequality below this share of the largest one of an equation is due to the barrier: the limit is
# inactive.
BINDING_SHARE = 1e-7
# The kind of quantities whose rate does not depend directly on efforts, as far as known: fixed, they are constraints of
# second order. Their multiplier is a measure with impulses at the ends of an arc (Hartl, Sethi and Vickson 1995). A
# transcription gives values that alternate from interval to interval, so only the sum over the arc has a sign.
_SECOND_ORDER = "path"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FixedArcs:
    """Efforts and path quantities that are fixed over whole segments.

    `efforts` (n_segments, n_u) at their limits, NaN where they are free; `paths` (n_segments, n_path): path quantities at
    their upper limit (1) or lower one (-1), 0 where they are free.
    """

    efforts: np.ndarray
    paths: np.ndarray

    @property
    def everything(self) -> bool:
        """True if every segment fixes as many quantities as it has efforts, so that only the switch times are unknown."""
        return bool(np.all(np.isnan(self.efforts).sum(axis=1) == np.count_nonzero(self.paths, axis=1)))


def path_arcs(transcribed: Transcribed, x: np.ndarray) -> np.ndarray:
    """Return 1 or -1 (n, n_path) where a path quantity is at its upper or lower limit at all nodes, else 0.

    For limits on jerk it is 0: fixed at all nodes of an interval, they would be one equation more than its jerk has
    coefficients.
    """
    arcs = _all_path_arcs(transcribed, x)
    arcs[:, list(transcribed.formulation.rows.jerk_path)] = 0
    return arcs


def _all_path_arcs(transcribed: Transcribed, x: np.ndarray) -> np.ndarray:
    """Return the arcs of `path_arcs` with those of limits on jerk."""
    program, interval = transcribed.program, transcribed.program.interval
    n, m, n_path = program.mesh.n_intervals, interval.n_nodes, interval.n_path
    limit = transcribed.formulation.path.reshape(-1, 2)
    if n_path == 0:
        return np.zeros((n, 0), dtype=int)
    rows = interval_rows(transcribed, x)
    n_f = interval.n_equations + n_path
    values = rows[:, interval.n_own : interval.n_own + m * n_f].reshape(n, m, n_f)[:, :, interval.n_equations :]
    # Each end of a limit has its own size, because one end may be 900 W and the other a million.
    size = np.where(np.isfinite(limit), np.abs(limit), 0.0)
    slack = SHARE_AT_LIMIT * np.where(size > 0, size, np.abs(values).max(axis=(0, 1))[:, None])
    may = (limit[:, 0] < limit[:, 1]) & np.array([kind != "work" for kind in interval.node_kinds[interval.n_equations :]])
    upper = np.all(values > limit[:, 1] - slack[:, 1], axis=1) & may
    lower = np.all(values < limit[:, 0] + slack[:, 0], axis=1) & may
    return upper.astype(int) - lower.astype(int)


def own_arcs(transcribed: Transcribed, x: np.ndarray, kinds: tuple[str, ...]) -> np.ndarray:
    """Return 1 or -1 (n, n_limits) where all coefficients of an interval are at their upper or lower limit, else 0.

    With the kind "jerk" they include path quantities that depend on the jerk, by their values at all nodes. Their signs
    change where the jerk reverses: the size of a site's jerk is then at its limit before and after.

    Args:
        transcribed: a program.
        x: its unknowns.
        kinds: of an interval's own rows: "speed", "acceleration" and "jerk" of independent joints, "power" of actuators,
            "effort_rate" too, "motor" for lines of torque and speed.
    """
    arcs = [np.zeros((transcribed.program.mesh.n_intervals, 0), dtype=int)]
    for kind, values, (low, high) in _coefficients(transcribed, x):
        if kind in kinds:
            above = np.all(values > high - SHARE_AT_LIMIT * abs(high), axis=1).astype(int)
            below = np.all(values < low + SHARE_AT_LIMIT * abs(low), axis=1).astype(int)
            arcs.append((above - below)[:, None])
    on_jerk = list(transcribed.formulation.rows.jerk_path) if "jerk" in kinds else []
    if on_jerk:
        ends = transcribed.scheme.acceleration_coefficients[[0, -1]]
        changes = np.diff(ends @ x[transcribed.program.layout.acceleration()], axis=1)[:, 0]  # (n, n_s) of accelerations
        reverses = np.append(False, np.sum(changes[1:] * changes[:-1], axis=1) < 0)
        arcs.append(np.cumprod(np.where(reverses, -1, 1))[:, None] * _all_path_arcs(transcribed, x)[:, on_jerk])
    return np.hstack(arcs)


def off_limit_intervals(transcribed: Transcribed, x: np.ndarray) -> np.ndarray:
    """Return True (n,) where a limit on Bernstein coefficients keeps a curve away from the limit.

    Coefficients enclose their polynomial, so a polynomial that touches its limit only at an instant is kept away by an
    eighth of its bend. On half the interval the distance is a quarter of that.
    """
    off = np.zeros(transcribed.program.mesh.n_intervals, dtype=bool)
    for _, coefficients, limit in _coefficients(transcribed, x):
        curve = coefficients @ bernstein_matrix(coefficients.shape[1] - 1, np.linspace(0.0, 1.0, SAMPLES_OF_INTERVAL)).T
        for bound, sign in zip(limit, (-1.0, 1.0), strict=True):
            if np.isfinite(bound) and bound != 0:
                room = SHARE_OFF_LIMIT * abs(bound)
                touching, away = ((sign * (bound - values)).min(axis=1) for values in (coefficients, curve))
                off |= (touching < 0.5 * room) & (away > room)
    return off


def interval_rows(transcribed: Transcribed, x: np.ndarray) -> np.ndarray:
    """Return the intervals' rows (n, n_rows) at unknowns x."""
    program = transcribed.program
    n, n_rows = program.mesh.n_intervals, program.interval.n_rows
    return np.array(program.functions["nlp"](x, transcribed.parameters)[1]).ravel()[: n * n_rows].reshape(n, -1)


def _coefficients(transcribed: Transcribed, x: np.ndarray) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield the quantities limited by Bernstein coefficients: kind, coefficients (n, degree + 1), limit (2,)."""
    interval = transcribed.program.interval
    what = list(zip(interval.own_kinds, interval.own_items, strict=True))
    limited = sorted({(kind, item) for kind, item in what if kind != "continuity"})
    rows = interval_rows(transcribed, x) if limited else np.empty((0, 0))
    for kind, item in limited:
        columns = [row for row, of in enumerate(what) if of == (kind, item)]
        yield kind, rows[:, columns], transcribed.formulation.own[kind][item]


def arc_ends(arcs: np.ndarray, breaks_s: np.ndarray, switch_times_s: np.ndarray, boundaries_s: np.ndarray) -> np.ndarray:
    """Return the instants (n,) [s] at which arcs (n_intervals, n_path) begin or end away from known switches and phases."""
    known = switch_times_s
    widths = np.diff(breaks_s)
    found = []
    for k in range(1, len(arcs)):
        near = INTERVALS_TO_SAME_SWITCH * max(widths[k - 1], widths[k])
        if (
            np.any(arcs[k] != arcs[k - 1])
            and np.abs(known - breaks_s[k]).min(initial=np.inf) > near
            and np.all(np.abs(boundaries_s - breaks_s[k]) > 0.5 * min(widths[k - 1], widths[k]))
        ):
            found.append(float(breaks_s[k]))
            known = np.append(known, breaks_s[k])
    return np.array(found)


def find_constrained_paths(
    arcs: np.ndarray, breaks_s: np.ndarray, ends_s: np.ndarray, bang_efforts: np.ndarray
) -> np.ndarray:
    """Return 1 or -1 (n_segments, n_path) where a segment fixes a path quantity at its upper or lower limit, else 0.

    Args:
        arcs: (n_intervals, n_path) from `path_arcs`.
        breaks_s: (n_intervals + 1,) of that motion [s].
        ends_s: (n_segments + 1,) [s] of the new segments.
        bang_efforts: (n_segments, n_u) efforts that are fixed, NaN where they are free; at most as many paths are fixed as
            efforts are free.
    """
    constrained_paths = np.zeros((len(ends_s) - 1, arcs.shape[1]), dtype=int)
    for k, (begin, end) in enumerate(itertools.pairwise(ends_s)):
        beside = SHARE_BESIDE_SWITCHES * (end - begin)
        inside = (breaks_s[1:] > begin + beside) & (breaks_s[:-1] < end - beside)
        inner = inside & (breaks_s[:-1] >= begin) & (breaks_s[1:] <= end)
        chosen = arcs[inner if inner.any() else inside]
        if len(chosen):
            constrained_paths[k] = np.where(np.all(chosen == chosen[0], axis=0), chosen[0], 0)
        free = int(np.isnan(bang_efforts[k]).sum())
        constrained_paths[k, np.flatnonzero(constrained_paths[k])[free:]] = 0
    return constrained_paths


def arcs_against_their_limits(solution: Solution) -> np.ndarray:
    """Return the instants (n,) [s], middles of intervals, at which the optimum would leave a fixed limit."""
    breaks = interval_breaks(solution)
    wrong = np.hstack(held_wrongly(solution)).any(axis=1)
    return 0.5 * (breaks[1:] + breaks[:-1])[wrong]


def limits_bind(solution: Solution) -> bool:
    """Return True if any limit on an unknown or row is active, or if the solver gave no multipliers."""
    rows, unknowns, transcribed = solution.multipliers, solution.bound_multipliers, solution.transcribed
    if rows is None or unknowns is None:
        return True
    equal = transcribed.row_lower == transcribed.row_upper
    most = BINDING_SHARE * np.abs(rows[equal]).max(initial=np.finfo(float).tiny)
    of_unknowns = np.abs(unknowns[transcribed.lower < transcribed.upper])
    return bool(max(np.abs(rows[~equal]).max(initial=0.0), of_unknowns.max(initial=0.0)) > most)


def interval_breaks(solution: Solution) -> np.ndarray:
    """Return the ends of a solution's intervals (n + 1,) [s]."""
    program, transcribed = solution.transcribed.program, solution.transcribed
    return program.mesh.breaks(solution.x[program.layout.durations()] * transcribed.units.time_s)


def held_wrongly(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Return True where the optimum would leave a fixed effort (n, n_u) or path quantity (n, n_path) of an interval."""
    transcribed, multipliers = solution.transcribed, solution.multipliers
    program, mesh = transcribed.program, transcribed.program.mesh
    efforts = np.zeros((mesh.n_intervals, program.layout.n_u), dtype=bool)
    paths = np.zeros((mesh.n_intervals, program.interval.n_path), dtype=bool)
    # An effort with a limited rate is a state: its multiplier acts on the whole arc and has no sign at each instant.
    if multipliers is not None and transcribed.bang_efforts is not None and "effort_rate" not in program.interval.own_kinds:
        _, gradient = program.functions["grad_f"](solution.x, transcribed.parameters)
        _, jacobian = program.functions["jac_g"](solution.x, transcribed.parameters)
        reduced = np.array(gradient).ravel() + np.array(jacobian.T @ multipliers).ravel()
        held, limit = transcribed.bang_efforts, transcribed.formulation.effort
        side = np.where(held == limit[:, 1], -1.0, np.where(held == limit[:, 0], 1.0, 0.0))[mesh.segment]
        efforts = _wrong(side * reduced[program.layout.effort()].sum(axis=1))
    if multipliers is not None and transcribed.constrained_paths is not None:
        of_paths, interval = path_multipliers(transcribed, multipliers), program.interval
        second = np.array(interval.node_kinds[interval.n_equations :]) == _SECOND_ORDER
        of_arcs = np.zeros((mesh.n_segments, of_paths.shape[1]))
        np.add.at(of_arcs, mesh.segment, of_paths)
        pushes = np.where(second, of_arcs[mesh.segment], of_paths)
        paths = _wrong(transcribed.constrained_paths[mesh.segment] * pushes)
    return efforts, paths


def _wrong(pushes: np.ndarray) -> np.ndarray:
    """Return True (n, k) where a push onto a limit is negative, away from it, compared with the largest push."""
    return pushes < -WRONG_SIGN_SHARE * np.abs(pushes).max(initial=np.finfo(float).tiny)


def path_multipliers(transcribed: Transcribed, multipliers: np.ndarray) -> np.ndarray:
    """Return the sums over an interval's nodes (n_intervals, n_path) of the path quantities' multipliers."""
    n, interval = transcribed.program.mesh.n_intervals, transcribed.program.interval
    rows = multipliers[: n * interval.n_rows].reshape(n, -1)
    of_nodes = rows[:, interval.n_own :][:, : interval.n_nodes * (interval.n_equations + interval.n_path)]
    return of_nodes.reshape(n, interval.n_nodes, -1)[:, :, interval.n_equations :].sum(axis=1)


def released(solution: Solution) -> tuple[np.ndarray, FixedArcs] | None:
    """Return the ends (n_segments + 1,) [s] of segments and the quantities to fix on them; None if no sign is wrong."""
    transcribed, mesh = solution.transcribed, solution.transcribed.program.mesh
    wrong = np.hstack(held_wrongly(solution))
    if not wrong.any():
        return None
    first = np.concatenate([[True], (np.diff(mesh.segment) != 0) | np.any(wrong[1:] != wrong[:-1], axis=1)])
    n_u, n_path = transcribed.program.layout.n_u, transcribed.program.interval.n_path
    efforts, paths = transcribed.bang_efforts, transcribed.constrained_paths
    efforts = np.full((mesh.n_segments, n_u), np.nan) if efforts is None else efforts
    paths = np.zeros((mesh.n_segments, n_path), dtype=int) if paths is None else paths
    held = np.hstack([efforts, np.where(paths == 0, np.nan, paths)])[mesh.segment][first]
    held[wrong[first]] = np.nan
    fixed = FixedArcs(efforts=held[:, :n_u], paths=np.nan_to_num(held[:, n_u:]).astype(int))
    return interval_breaks(solution)[np.append(first, True)], fixed
