"""The switch times of a motion, read from the coefficients of its efforts."""

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np

# A coefficient within this share of the span of the limits counts as at its limit, and so does a path quantity within this
# share of its limit; the solver is exact to 1e-8.
SHARE_AT_LIMIT = 1e-3
# Up to this many intervals between two arcs at limits are one smeared switch; more are an arc of their own.
SMEARED_INTERVALS = 3
# A switch time within this share of half an interval of a phase boundary is that boundary: if arcs can be short (True), or
# not.
SHARE_BESIDE_OTHERS = {True: 1e-3, False: 0.1}


class PiecewiseMotion(Protocol):
    """The part of a motion that refinement reads."""

    @property
    def breaks_s(self) -> np.ndarray:
        """The intervals' ends (n + 1,) [s]."""
        ...

    @property
    def effort(self) -> np.ndarray:
        """The efforts' Bernstein coefficients (degree + 1, n, n_u)."""
        ...

    def effort_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return efforts (n, n_u) at times (n,)."""
        ...


def find_switch_times(
    trajectory: PiecewiseMotion,
    limit: np.ndarray,
    boundaries_s: np.ndarray | None = None,
    on_path: np.ndarray | None = None,
    *,
    short: bool = False,
    continuous_efforts: bool = False,
) -> np.ndarray:
    """Return the times (n,) [s] at which efforts jump between their limits or leave them, increasing.

    Args:
        trajectory: a solution on a fixed mesh.
        limit: (n_u, 2) of the efforts.
        boundaries_s: instants [s] at which the mesh is cut already; its ends by default.
        on_path: intervals (n,) that follow a path limit: never a smeared switch, however few.
        short: whether arcs at limits may be shorter than an interval. Where there are limits other than those of effort,
            what leaves its limit so shortly follows one of them.
        continuous_efforts: whether efforts have no jumps: what lies between two limits is then an arc, however short.

    A switch inside an interval shows as one smeared interval; its time follows from the impulse, which the smeared
    interval keeps: u_before (t - t_0) + u_after (t_1 - t) = int u dt. So do the two of an arc that is shorter than that.
    """
    breaks = trajectory.breaks_s
    boundaries = breaks[[0, -1]] if boundaries_s is None else boundaries_s
    known_boundaries = np.searchsorted(breaks, boundaries[1:-1] - 1e-12 * breaks[-1]) if short else np.empty(0, dtype=int)
    at_boundaries = {0, len(breaks) - 1, *known_boundaries.tolist()}
    found: list[list[float]] = []
    for j, (low, high) in enumerate(limit):
        if not (np.isfinite(low) and np.isfinite(high) and high > low):
            continue
        coefficients = trajectory.effort[:, :, j]
        slack = SHARE_AT_LIMIT * (high - low)
        arc = np.where(coefficients.min(axis=0) > high - slack, 1, np.where(coefficients.max(axis=0) < low + slack, -1, 0))
        # Not np.union1d, which loads numpy.ma: a tenth of the time of a command that plans one motion.
        edges = np.array(sorted({*(np.flatnonzero(np.diff(arc)) + 1).tolist(), *known_boundaries.tolist()}), dtype=int)
        starts, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(arc)]])
        for a, b in zip(starts, ends, strict=True):
            piece = _Piece(
                breaks=breaks[a : b + 1],
                coefficients=coefficients[:, a:b],
                at_limit=int(arc[a]),
                before=0 if a in at_boundaries else int(arc[a - 1]),
                after=0 if b in at_boundaries else int(arc[b]),
                on_path=on_path is not None and bool(on_path[a:b].any()),
            )
            found += piece.switches(float(low), float(high), short=short, continuous_efforts=continuous_efforts)
    return _spread(found, breaks, boundaries, SHARE_BESIDE_OTHERS[short])


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Piece:
    """Successive intervals (n,) on which one effort is at one limit all along, or at none.

    `at_limit`, and `before` and `after` of the pieces beside it, is 1 at the upper limit, -1 at the lower, 0 at none or
    where the mesh is cut. `on_path` says that an interval of it follows a path limit.
    """

    breaks: np.ndarray  # (n + 1,) [s]
    coefficients: np.ndarray  # (degree + 1, n)
    at_limit: int
    before: int
    after: int
    on_path: bool

    def switches(self, low: float, high: float, *, short: bool, continuous_efforts: bool) -> list[list[float]]:
        """Return groups of switch times [s] that the piece shows; the two of a pulse are one group."""
        breaks, before, after, n = self.breaks, self.before, self.after, len(self.breaks) - 1
        if self.at_limit:
            return [[float(breaks[0])]] if before else []
        if self.on_path and n <= 2:
            return [[float(time)] for time, neighbour in ((breaks[0], before), (breaks[-1], after)) if neighbour]
        if self.on_path or n > SMEARED_INTERVALS:
            return self._ends_of_arc(low, high)
        if before * after > 0 and short:
            return [_pulse_in(breaks, self.coefficients, (low, high) if before < 0 else (high, low))]
        if before * after < 0 and continuous_efforts:
            return [[float(breaks[0]), float(breaks[-1])]]
        if before * after < 0 or (short and before + after):
            # Next to a phase boundary or an end the arc on the other side is shorter than an interval: at the other limit.
            u_before, u_after = (high, low) if before > 0 or after < 0 else (low, high)
            return [[_switch_time_in(breaks, self.coefficients, u_before, u_after)]]
        return []

    def _ends_of_arc(self, low: float, high: float) -> list[list[float]]:
        """Return the ends of an arc within the limits: its first and last interval may hold a rest of the arcs beside it."""
        found, n = [], len(self.breaks) - 1
        for k, inner, neighbour in ((0, 1, self.before), (n - 1, n - 2, self.after)):
            if neighbour:
                at_limit, within = (high if neighbour > 0 else low), self.coefficients[:, inner].mean()
                u_before, u_after = (at_limit, within) if k == 0 else (within, at_limit)
                found.append([_switch_time_in(self.breaks[k : k + 2], self.coefficients[:, k : k + 1], u_before, u_after)])
        return found


def _switch_time_in(breaks: np.ndarray, coefficients: np.ndarray, u_before: float, u_after: float) -> float:
    """Return the time in smeared intervals at which a jump between two efforts gives the impulse that they hold."""
    impulse = float(np.sum(coefficients.mean(axis=0) * np.diff(breaks)))
    jump = u_before - u_after
    if jump == 0:
        return float(breaks[0])
    return float(np.clip((impulse + u_before * breaks[0] - u_after * breaks[-1]) / jump, breaks[0], breaks[-1]))


def _pulse_in(breaks: np.ndarray, coefficients: np.ndarray, limits: tuple[float, float]) -> list[float]:
    """Return when smeared intervals leave the first limit for the other and come back, by their impulse and its middle."""
    widths, missing = np.diff(breaks), limits[0] - coefficients.mean(axis=0)
    lengths = missing * widths / (limits[0] - limits[1])
    length = float(lengths.sum())
    middle = float(lengths @ (breaks[1:] + breaks[:-1]) / (2 * length))
    middle = float(np.clip(middle, breaks[0] + length / 2, breaks[-1] - length / 2))
    return [middle - length / 2, middle + length / 2]


def find_bang_efforts(trajectory: PiecewiseMotion, limit: np.ndarray, switch_times: np.ndarray) -> np.ndarray:
    """Return the efforts (n_switches + 1, n_u) of bang arcs between switch times: a limit, or NaN where they vary.

    Looked at away from the switch times, next to which the fixed mesh smears the switch.
    """
    ends = np.concatenate([trajectory.breaks_s[:1], switch_times, trajectory.breaks_s[-1:]])
    bang_efforts = np.full((len(ends) - 1, trajectory.effort.shape[2]), np.nan)
    for k, (begin, end) in enumerate(itertools.pairwise(ends)):
        effort = trajectory.effort_at(begin + np.linspace(0.15, 0.85, 50) * (end - begin))
        for j, (low, high) in enumerate(limit):
            slack = SHARE_AT_LIMIT * (high - low) if np.isfinite(high - low) else 0.0
            for bound in (low, high):
                if slack and np.all(np.abs(effort[:, j] - bound) < slack):
                    bang_efforts[k, j] = bound
    return bang_efforts


def _spread(switch_times: list[list[float]], breaks: np.ndarray, boundaries: np.ndarray, share: float) -> np.ndarray:
    """Return switch times in order, a pulse's together, but for those next to others or to a phase boundary."""
    apart = 0.5 * float(np.diff(breaks).min())
    kept: list[float] = []
    for together in sorted(switch_times):
        beside = min(float(np.abs(switch_time - boundaries).min()) for switch_time in together)
        if beside > share * apart and (not kept or together[0] - kept[-1] > apart):
            kept += together
    return np.array(kept)
