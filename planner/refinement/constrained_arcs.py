"""Constrained arcs: where a motion along path limits enters and leaves them, and which segments are held on them.

On a constrained arc a limit on power or on a dependent joint's speed binds, and the effort is inside its own limit. A
program with rows at nodes alone gains by leaving the limit between the nodes, most of all next to a switch. If the limit is
held at every node of a segment, nothing can be gained there, and the switch times converge.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from linkplan.planner.refinement.switches import SHARE_AT_LIMIT
from linkplan.planner.transcription.bernstein import bernstein_matrix
from linkplan.planner.transcription.collocation import Transcribed

# This share of a segment, at each of its ends, is left out.
SHARE_BESIDE_SWITCHES = 0.15
# An end of an arc within so many intervals of a switch time is that switch time.
INTERVALS_TO_SAME_SWITCH = 2.5
# If coefficients are at a limit and the curve is further from it than this share, the coefficients keep it away. The curve
# is sampled at so many instants of an interval.
SHARE_OFF_LIMIT, SAMPLES_OF_INTERVAL = 1e-7, 33


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FixedArcs:
    """Efforts and path quantities that are held over whole segments.

    `efforts` (n_segments, n_u) at their limits, NaN where they are free; `paths` (n_segments, n_path): path quantities at
    their upper limit (1) or lower one (-1), 0 where they are free.
    """

    efforts: np.ndarray
    paths: np.ndarray

    @property
    def everything(self) -> bool:
        """True if every segment holds as many quantities as it has efforts, so that only the switch times are unknown."""
        return bool(np.all(np.isnan(self.efforts).sum(axis=1) == np.count_nonzero(self.paths, axis=1)))


def path_arcs(transcribed: Transcribed, x: np.ndarray) -> np.ndarray:
    """Return 1 or -1 (n, n_path) where a path quantity is at its upper or lower limit at all nodes, else 0."""
    program, interval = transcribed.program, transcribed.program.interval
    n, m, n_path = program.mesh.n_intervals, interval.n_nodes, interval.n_path
    limit = transcribed.formulation.path.reshape(-1, 2)
    if n_path == 0:
        return np.zeros((n, 0), dtype=int)
    rows = _rows(transcribed, x)
    n_f = interval.n_equations + n_path
    values = rows[:, interval.n_own : interval.n_own + m * n_f].reshape(n, m, n_f)[:, :, interval.n_equations :]
    # Each end of a limit has its own size: 900 W can be the opposite of a million.
    size = np.where(np.isfinite(limit), np.abs(limit), 0.0)
    slack = SHARE_AT_LIMIT * np.where(size > 0, size, np.abs(values).max(axis=(0, 1))[:, None])
    may = (limit[:, 0] < limit[:, 1]) & np.array([kind != "work" for kind in interval.node_kinds[interval.n_equations :]])
    upper = np.all(values > limit[:, 1] - slack[:, 1], axis=1) & may
    lower = np.all(values < limit[:, 0] + slack[:, 0], axis=1) & may
    return upper.astype(int) - lower.astype(int)


def own_arcs(transcribed: Transcribed, x: np.ndarray, kinds: tuple[str, ...]) -> np.ndarray:
    """Return 1 or -1 (n, n_limits) where all coefficients of an interval are at their upper or lower limit, else 0.

    Args:
        transcribed: a program.
        x: its unknowns.
        kinds: of an interval's own rows: "speed" of independent joints, "motor" for lines of torque and speed.
    """
    arcs = [np.zeros((transcribed.program.mesh.n_intervals, 0), dtype=int)]
    for kind, values, (low, high) in _coefficients(transcribed, x):
        if kind in kinds:
            above = np.all(values > high - SHARE_AT_LIMIT * abs(high), axis=1).astype(int)
            below = np.all(values < low + SHARE_AT_LIMIT * abs(low), axis=1).astype(int)
            arcs.append((above - below)[:, None])
    return np.hstack(arcs)


def standing_off(transcribed: Transcribed, x: np.ndarray) -> np.ndarray:
    """Return True (n,) where a limit on Bernstein coefficients keeps a curve away from the limit.

    Coefficients enclose their polynomial: one that touches its limit in an instant may not, by an eighth of its bend. On
    half the interval it is a quarter of that.
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


def _rows(transcribed: Transcribed, x: np.ndarray) -> np.ndarray:
    """Return the intervals' rows (n, n_rows) at unknowns x."""
    program = transcribed.program
    n, n_rows = program.mesh.n_intervals, program.interval.n_rows
    return np.array(program.functions["nlp"](x, transcribed.parameters)[1]).ravel()[: n * n_rows].reshape(n, -1)


def _coefficients(transcribed: Transcribed, x: np.ndarray) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield what intervals limit by Bernstein coefficients: the kind, the coefficients (n, degree + 1), the limit (2,)."""
    interval = transcribed.program.interval
    what = list(zip(interval.own_kinds, interval.own_items, strict=True))
    limited = sorted({(kind, item) for kind, item in what if kind != "continuity"})
    rows = _rows(transcribed, x) if limited else np.empty((0, 0))
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
    """Return 1 or -1 (n_segments, n_path) where a segment holds a path quantity at its upper or lower limit, else 0.

    Args:
        arcs: (n_intervals, n_path) from `path_arcs`.
        breaks_s: (n_intervals + 1,) of that motion [s].
        ends_s: (n_segments + 1,) [s] of the segments to be.
        bang_efforts: (n_segments, n_u) efforts that are held, NaN where they are free: no more paths are held than efforts
            free.
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


def free_ends(ends_s: np.ndarray, fixed: FixedArcs) -> tuple[np.ndarray, FixedArcs]:
    """Return switch times (n,) [s] that split the ends off constrained arcs, and what is held then: no paths on those ends.

    An effort may come to its limit on the way along an arc, in less than an interval, and end it there.
    """
    switch_times, efforts, paths = [], [], []
    for k, (begin, end) in enumerate(itertools.pairwise(ends_s)):
        on_path = fixed.paths[k]
        if on_path.any():
            beside = SHARE_BESIDE_SWITCHES * (end - begin)
            switch_times += [begin + beside, end - beside]
        parts = [0 * on_path, on_path, 0 * on_path] if on_path.any() else [on_path]
        efforts += [fixed.efforts[k]] * len(parts)
        paths += parts
    return np.array(switch_times), FixedArcs(efforts=np.array(efforts), paths=np.array(paths))
