"""Meshes: the division of normalised time into intervals and segments, whose boundaries may move."""

from dataclasses import dataclass
from typing import Any

import numpy as np

# The default of `phase`, which __post_init__ sets: readers find an array.
_ONE_PHASE: Any = None


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


def segmented(durations: np.ndarray, n_intervals: int, phase: np.ndarray = _ONE_PHASE) -> Mesh:
    """Return about `n_intervals` intervals, at least three a segment, distributed in proportion to the durations."""
    durations = np.asarray(durations, dtype=float)
    share = np.maximum(3, np.round(n_intervals * durations / durations.sum())).astype(int)
    fraction = np.concatenate([np.full(n, 1.0 / n) for n in share])
    return Mesh(fraction=fraction, segment=np.repeat(np.arange(len(share)), share), phase=phase)


def halved(mesh: Mesh, which: np.ndarray) -> Mesh:
    """Return the mesh with the intervals marked in `which` (n,) halved."""
    pieces = np.where(which, 2, 1)
    fraction = np.repeat(mesh.fraction / pieces, pieces)
    return Mesh(fraction=fraction, segment=np.repeat(mesh.segment, pieces), phase=mesh.phase)
