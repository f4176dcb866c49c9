"""Meshes of normalised time, whose segment boundaries may move, and the layout of a program's unknowns on them.

The unknowns stand interval by interval; then come the last state, the durations and the extra unknowns. Sparse matrices are
triplets, without scipy.sparse, whose import is slow.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

# The default of `phase`, which __post_init__ sets: readers find an array.
_ONE_PHASE: Any = None


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Layout:
    """Indices of each interval's unknowns in the vector of all unknowns."""

    n_s: int
    n_z: int
    n_u: int
    n_nodes: int
    n_intervals: int
    n_segments: int
    n_x: int = 0
    n_effort: int = 0  # Bernstein coefficients of each effort; 0 means the number of nodes
    n_extra: int = 0  # unknowns of the whole program after the last state and the durations
    n_open_ends: int = 0  # ends of an interval without a node
    n_z_open_end: int = 0  # algebraic unknowns at each open end

    @property
    def n_state(self) -> int:
        """The number of states at an interval's end."""
        return 2 * self.n_s + self.n_x

    @property
    def effort_coefficients(self) -> int:
        """The number of Bernstein coefficients of an effort on an interval."""
        return self.n_effort or self.n_nodes

    @property
    def block(self) -> int:
        """The number of unknowns of one interval, with its left state."""
        inner = self.n_nodes * (self.n_s + self.n_x + self.n_z) + self.effort_coefficients * self.n_u
        return self.n_state + inner + self.n_open_ends * self.n_z_open_end

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return self.n_intervals * self.block + self.n_state + self.n_segments + self.n_extra

    def state(self, k: int) -> np.ndarray:
        """Return the indices (n_state,) of state k, 0 to n_intervals."""
        return k * self.block + np.arange(self.n_state)

    def states(self) -> np.ndarray:
        """Return indices (n_intervals + 1, n_state): s, v, x."""
        return self.block * np.arange(self.n_intervals + 1)[:, None] + np.arange(self.n_state)

    def acceleration(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_s)."""
        return self._inner(self.n_state, self.n_nodes, self.n_s)

    def rate(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_x) of the first-order states' rates."""
        return self._inner(self.n_state + self.n_nodes * self.n_s, self.n_nodes, self.n_x)

    def dependent(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_z)."""
        return self._inner(self.n_state + self.n_nodes * (self.n_s + self.n_x), self.n_nodes, self.n_z)

    def effort(self) -> np.ndarray:
        """Return indices (n_intervals, n_coefficients, n_u) of Bernstein coefficients."""
        start = self.n_state + self.n_nodes * (self.n_s + self.n_x + self.n_z)
        return self._inner(start, self.effort_coefficients, self.n_u)

    def open_end_dependent(self) -> np.ndarray:
        """Return indices (n_intervals, n_open_ends, n_z_open_end) of algebraic unknowns at open ends."""
        return self._inner(self.block - self.n_open_ends * self.n_z_open_end, self.n_open_ends, self.n_z_open_end)

    def durations(self) -> np.ndarray:
        """Return the indices (n_segments,) of the segments' durations."""
        return self.size - self.n_extra - self.n_segments + np.arange(self.n_segments)

    def extra(self) -> np.ndarray:
        """Return the indices (n_extra,) of the extra unknowns."""
        return self.size - self.n_extra + np.arange(self.n_extra)

    def _inner(self, start: int, count: int, width: int) -> np.ndarray:
        inner = np.arange(count * width).reshape(count, width)
        return start + self.block * np.arange(self.n_intervals)[:, None, None] + inner


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Triplets:
    """A sparse matrix by its nonzeros: rows, columns and values (n,), at distinct places."""

    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    shape: tuple[int, int]

    def dm(self) -> ca.DM:
        """Return the CasADi matrix."""
        order = np.lexsort((self.rows, self.columns))
        return ca.DM(pattern(self.rows[order], self.columns[order], self.shape), self.values[order])


def no_rows(size: int) -> Triplets:
    """Return the matrix (0, size)."""
    none = np.zeros(0, dtype=int)
    return Triplets(rows=none, columns=none, values=np.zeros(0), shape=(0, size))


def pattern(rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> ca.Sparsity:
    """Return the sparsity pattern of nonzeros sorted by column, then by row."""
    begins = np.searchsorted(columns, np.arange(shape[1] + 1))
    return ca.Sparsity(shape[0], shape[1], begins.tolist(), rows.tolist())


def scatter(target: np.ndarray, size: int) -> ca.DM:
    """Return the matrix (size, n) that adds value i to entry target[i]."""
    n = len(target)
    return ca.DM(ca.Sparsity(size, n, list(range(n + 1)), np.asarray(target).tolist()), np.ones(n))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Mesh:
    """Intervals grouped in segments whose durations the solver may choose, segments grouped in phases.

    `fraction` (n,) is each interval's share of its segment; the shares of a segment sum to 1. `segment` (n,) is the
    segment's index. In a mesh of one segment the intervals are fixed in relative time. With more segments, the instants
    between them move, as the switch times of a least-time motion. `phase` (n_segments,) is the index of the problem's phase
    (between start, waypoints and goal) of each segment; by default there is one phase.
    """

    fraction: np.ndarray
    segment: np.ndarray
    phase: np.ndarray = _ONE_PHASE

    def __post_init__(self) -> None:
        fraction, segment = np.array(self.fraction, dtype=float), np.array(self.segment, dtype=int)
        n_segments = int(segment.max()) + 1
        phase = np.zeros(n_segments, dtype=int) if self.phase is None else np.array(self.phase, dtype=int)
        shares = np.bincount(segment, weights=fraction, minlength=n_segments)
        if np.any(fraction <= 0) or np.any(np.diff(segment) < 0) or not np.allclose(shares, 1.0):
            raise ValueError(f"mesh shares must be positive and sum to 1 in each segment, got sums {shares}")
        if phase.shape != (n_segments,) or phase[0] != 0 or np.any((np.diff(phase) != 0) & (np.diff(phase) != 1)):
            raise ValueError(f"mesh legs count up from 0, one for each of {n_segments} segments, got {phase}")
        for name, value in (("fraction", fraction), ("segment", segment), ("phase", phase)):
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @property
    def n_intervals(self) -> int:
        """The number of intervals."""
        return len(self.fraction)

    @property
    def n_segments(self) -> int:
        """The number of segments."""
        return int(self.segment[-1]) + 1

    @property
    def n_phases(self) -> int:
        """The number of phases."""
        return int(self.phase[-1]) + 1

    def boundaries(self) -> np.ndarray:
        """Return the first interval of each phase, then the number of intervals: (n_phases + 1,)."""
        of_interval = self.phase[self.segment]
        return np.concatenate([np.searchsorted(of_interval, np.arange(self.n_phases)), [self.n_intervals]])

    def breaks(self, durations: np.ndarray) -> np.ndarray:
        """Return the intervals' ends (n + 1,) for segment durations (n_segments,), from 0."""
        return np.concatenate([[0.0], np.cumsum(self.fraction * np.asarray(durations)[self.segment])])


def uniform(n_intervals: int) -> Mesh:
    """Return `n_intervals` equal intervals in one segment."""
    return Mesh(fraction=np.full(n_intervals, 1.0 / n_intervals), segment=np.zeros(n_intervals, dtype=int))


def broken(breaks: np.ndarray) -> Mesh:
    """Return the mesh of one segment with increasing breaks (n + 1,), from 0 to 1."""
    widths = np.diff(np.asarray(breaks, dtype=float))
    return Mesh(fraction=widths / widths.sum(), segment=np.zeros(len(widths), dtype=int))


def with_breaks(mesh: Mesh, durations: np.ndarray, times: np.ndarray) -> Mesh:
    """Return a mesh whose intervals end at further times (n,) [s], in place of those of its ends next to them.

    Segments keep their ends and their durations (n_segments,) [s].
    """
    ends = np.concatenate([[0.0], np.cumsum(durations)])
    return _of_segments(_breaks_at(mesh, durations, times), ends, mesh.phase)


def with_ends(mesh: Mesh, durations: np.ndarray, times: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """Return a mesh whose segments end at further times (n,) [s], too, and the durations of its segments [s].

    The ends of intervals that are next to these times are removed.
    """
    old = np.concatenate([[0.0], np.cumsum(durations)])
    ends = np.sort(np.concatenate([old, times]))
    phase = mesh.phase[np.searchsorted(old[1:-1], 0.5 * (ends[1:] + ends[:-1]))]
    return _of_segments(_breaks_at(mesh, durations, times), ends, phase), np.diff(ends)


def _breaks_at(mesh: Mesh, durations: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the increasing ends [s] of a mesh's intervals with further ones, in place of those next to them."""
    breaks, ends = mesh.breaks(durations), np.concatenate([[0.0], np.cumsum(durations)])
    width = np.diff(breaks)
    inner = breaks[np.abs(breaks[:, None] - ends).min(axis=1) > 1e-9 * width.min()]
    added = times[np.abs(times[:, None] - ends).min(axis=1, initial=np.inf) > 1e-2 * width.min()]
    beside = 0.3 * width[np.clip(np.searchsorted(breaks, added) - 1, 0, len(width) - 1)]
    inner = inner[np.all(np.abs(inner[:, None] - added) > beside, axis=1)]
    return np.sort(np.concatenate([ends, inner, added]))


def _of_segments(breaks: np.ndarray, ends: np.ndarray, phase: np.ndarray) -> Mesh:
    """Return the mesh with these ends of intervals [s] and, among them, of segments [s]."""
    segment = np.searchsorted(ends[1:-1], 0.5 * (breaks[1:] + breaks[:-1]))
    fraction = np.diff(breaks) / np.diff(ends)[segment]
    return Mesh(fraction=fraction / np.bincount(segment, weights=fraction)[segment], segment=segment, phase=phase)


def segmented(durations: np.ndarray, n_intervals: int, phase: np.ndarray = _ONE_PHASE, *, least: int = 3) -> Mesh:
    """Return about `n_intervals` intervals, at least so many a segment, distributed in proportion to the durations."""
    durations = np.asarray(durations, dtype=float)
    share = np.maximum(least, np.round(n_intervals * durations / durations.sum())).astype(int)
    fraction = np.concatenate([np.full(n, 1.0 / n) for n in share])
    return Mesh(fraction=fraction, segment=np.repeat(np.arange(len(share)), share), phase=phase)


def halved(mesh: Mesh, which: np.ndarray) -> Mesh:
    """Return the mesh with the intervals marked in `which` (n,) halved."""
    return divided(mesh, np.where(which, 2, 1))


def without_empty(mesh: Mesh, durations: np.ndarray, least_s: float) -> tuple[Mesh, np.ndarray]:
    """Return a mesh without segments shorter than `least_s` [s], but one of each phase, and the others' durations [s]."""
    longest = np.array([durations[mesh.phase == phase].max() for phase in mesh.phase])
    stays = (durations >= least_s) | (durations == longest)
    of_these = stays[mesh.segment]
    segment = (np.cumsum(stays) - 1)[mesh.segment[of_these]]
    return Mesh(fraction=mesh.fraction[of_these], segment=segment, phase=mesh.phase[stays]), durations[stays]


def divided(mesh: Mesh, pieces: np.ndarray) -> Mesh:
    """Return the mesh with each interval divided into so many pieces (n,)."""
    fraction = np.repeat(mesh.fraction / pieces, pieces)
    return Mesh(fraction=fraction, segment=np.repeat(mesh.segment, pieces), phase=mesh.phase)
