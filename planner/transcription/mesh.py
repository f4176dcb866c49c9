"""Meshes: how the unit of time is cut into intervals, and which cuts may move."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Mesh:
    """Intervals grouped in segments whose durations the solver may choose, segments grouped in legs between knots.

    `fraction` (n,) is each interval's share of its segment, `segment` (n,) the segment's index; shares of one segment sum
    to 1. With one segment the mesh is fixed in relative time; with more, the cuts between segments move: switches of a
    least-time motion settle on them. `leg` (n_segments,) says between which of the problem's knots (start, waypoints, goal)
    a segment lies; one leg where it is left out.
    """

    fraction: np.ndarray
    segment: np.ndarray
    leg: np.ndarray | None = None

    def __post_init__(self) -> None:
        fraction, segment = np.array(self.fraction, dtype=float), np.array(self.segment, dtype=int)
        n_segments = int(segment.max()) + 1
        leg = np.zeros(n_segments, dtype=int) if self.leg is None else np.array(self.leg, dtype=int)
        shares = np.bincount(segment, weights=fraction, minlength=n_segments)
        if np.any(fraction <= 0) or np.any(np.diff(segment) < 0) or not np.allclose(shares, 1.0):
            raise ValueError(f"mesh shares must be positive and sum to 1 in each segment, got sums {shares}")
        if leg.shape != (n_segments,) or leg[0] != 0 or np.any((np.diff(leg) != 0) & (np.diff(leg) != 1)):
            raise ValueError(f"mesh legs count up from 0, one for each of {n_segments} segments, got {leg}")
        for name, value in (("fraction", fraction), ("segment", segment), ("leg", leg)):
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
    def n_legs(self) -> int:
        """The number of legs."""
        return int(self.leg[-1]) + 1

    def knots(self) -> np.ndarray:
        """Return the intervals (n_legs + 1,) at whose left end a knot stands; the last knot is past the last interval."""
        of_interval = self.leg[self.segment]
        return np.concatenate([np.searchsorted(of_interval, np.arange(self.n_legs)), [self.n_intervals]])

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


def segmented(durations: np.ndarray, n_intervals: int, at_least: int = 3, leg: np.ndarray | None = None) -> Mesh:
    """Return about `n_intervals` intervals over segments of given durations, shared out by duration."""
    durations = np.asarray(durations, dtype=float)
    share = np.maximum(at_least, np.round(n_intervals * durations / durations.sum())).astype(int)
    fraction = np.concatenate([np.full(n, 1.0 / n) for n in share])
    return Mesh(fraction=fraction, segment=np.repeat(np.arange(len(share)), share), leg=leg)


def halved(mesh: Mesh, which: np.ndarray) -> Mesh:
    """Return the mesh with the intervals marked in `which` (n,) cut in two."""
    pieces = np.where(which, 2, 1)
    fraction = np.repeat(mesh.fraction / pieces, pieces)
    return Mesh(fraction=fraction, segment=np.repeat(mesh.segment, pieces), leg=mesh.leg)
