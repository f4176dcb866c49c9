"""Meshes: how the unit of time is cut into intervals, and which cuts may move."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Mesh:
    """Intervals grouped in segments whose durations the solver may choose.

    `fraction` (n,) is each interval's share of its segment, `segment` (n,) the segment's index; shares of one segment sum
    to 1. With one segment the mesh is fixed in relative time; with more, the cuts between segments move: switches of a
    least-time motion settle on them.
    """

    fraction: np.ndarray
    segment: np.ndarray

    def __post_init__(self) -> None:
        fraction, segment = np.array(self.fraction, dtype=float), np.array(self.segment, dtype=int)
        n_segments = int(segment.max()) + 1
        shares = np.bincount(segment, weights=fraction, minlength=n_segments)
        if np.any(fraction <= 0) or np.any(np.diff(segment) < 0) or not np.allclose(shares, 1.0):
            raise ValueError(f"mesh shares must be positive and sum to 1 in each segment, got sums {shares}")
        for name, value in (("fraction", fraction), ("segment", segment)):
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

    def breaks(self, durations: np.ndarray) -> np.ndarray:
        """Return the intervals' ends (n + 1,) for segment durations (n_segments,), from 0."""
        return np.concatenate([[0.0], np.cumsum(self.fraction * np.asarray(durations)[self.segment])])


def uniform(n_intervals: int) -> Mesh:
    """Return `n_intervals` equal intervals in one segment."""
    return Mesh(fraction=np.full(n_intervals, 1.0 / n_intervals), segment=np.zeros(n_intervals, dtype=int))


def segmented(durations: np.ndarray, n_intervals: int, at_least: int = 3) -> Mesh:
    """Return about `n_intervals` intervals over segments of given durations, shared out by duration."""
    durations = np.asarray(durations, dtype=float)
    share = np.maximum(at_least, np.round(n_intervals * durations / durations.sum())).astype(int)
    fraction = np.concatenate([np.full(n, 1.0 / n) for n in share])
    return Mesh(fraction=fraction, segment=np.repeat(np.arange(len(share)), share))


def halved(mesh: Mesh, which: np.ndarray) -> Mesh:
    """Return the mesh with the intervals marked in `which` (n,) cut in two."""
    pieces = np.where(which, 2, 1)
    return Mesh(fraction=np.repeat(mesh.fraction / pieces, pieces), segment=np.repeat(mesh.segment, pieces))
