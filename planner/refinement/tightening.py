"""Constraint tightening: limits that a motion overran between the nodes, tightened there and by that much."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from linkplan.planner.limits.path_limit import Margin, Tightened

# The tightening is this multiple of the overrun and this share of the limit: the next motion keeps the limit at once.
_OVERRUN_FACTOR = 1.1
_MIN_TIGHTENING = 1e-7
# Up to this share a limit is tightened evenly along the motion. A limit that is tighter on one interval than on its
# neighbours increases the error of the polynomial at the ends of that interval.
_EVEN_TIGHTENING = 2e-5


class TightenedRow(NamedTuple):
    """Which limit a row is of, and how it is tightened."""

    what: str
    item: int
    tightened: Tightened


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Tightening:
    """By how much one limit is tightened, as a share (n,) of itself; `breaks` (n + 1,) are shares of the duration."""

    what: str
    item: int
    breaks: np.ndarray
    share: np.ndarray
    upper: bool = True  # of which of the limit's two ends the share is


def tightened_share(overrun: np.ndarray) -> np.ndarray:
    """Return the share of itself (n,) by which a limit is tightened on intervals where it is overrun by so much."""
    return np.where(overrun > 0, _OVERRUN_FACTOR * overrun + _MIN_TIGHTENING, 0.0)


def tightenings_of(margins: tuple[Margin, ...], speed_overrun: np.ndarray, breaks_s: np.ndarray) -> tuple[Tightening, ...]:
    """Return the tightening of each limit after a motion.

    Args:
        margins: what is left of the limits.
        speed_overrun: (n_q, n_intervals) by how much of itself a joint's speed limit is overrun.
        breaks_s: (n + 1,) of the motion [s].
    """
    relative = (breaks_s - breaks_s[0]) / (breaks_s[-1] - breaks_s[0])
    found = [
        Tightening(what="speed", item=joint, breaks=relative, share=tightened_share(overrun))
        for joint, overrun in enumerate(speed_overrun)
        if overrun.max(initial=0.0) > 0
    ]
    for margin in margins:
        if margin.of.tightened is not None and not margin.kept:
            found.append(
                Tightening(
                    what=margin.what,
                    item=margin.item,
                    breaks=relative,
                    share=tightened_share(margin.overrun),
                    upper=margin.upper,
                )
            )
    return tuple(found)


def evened(tightenings: tuple[Tightening, ...]) -> tuple[Tightening, ...]:
    """Return tightenings of which little ones are the same all along the motion."""
    most = [one.share.max(initial=0.0) for one in tightenings]
    return tuple(
        replace(one, share=np.full_like(one.share, share)) if share <= _EVEN_TIGHTENING else one
        for one, share in zip(tightenings, most, strict=True)
    )


def tightening_over(
    tightenings: tuple[Tightening, ...], rows: list[TightenedRow], path: np.ndarray
) -> Callable[[np.ndarray], np.ndarray] | None:
    """Return a function from breaks (n + 1,) [s] to how much (n, n_path) the bounds `path` (n_path, 2) are tightened.

    `rows` say of which limits the first of these quantities are; the others are never tightened.
    """
    if not tightenings:
        return None
    size = np.where(np.isfinite(path), np.where(path == 0, 1.0, np.abs(path)), 0.0)
    size[[column for column, row in enumerate(rows) if row.tightened is Tightened.IN_UNITS]] = 1.0
    factor = [2.0 if row.tightened is Tightened.SQUARED else 1.0 for row in rows]
    columns = {(row.what, row.item): column for column, row in enumerate(rows)}
    # Both bounds together leave a tenth of the distance between them.
    most = np.where(np.all(np.isfinite(path), axis=1), 0.45 * (path[:, 1] - path[:, 0]), np.inf)

    def tightening(breaks_s: np.ndarray) -> np.ndarray:
        middle = (0.5 * (breaks_s[1:] + breaks_s[:-1]) - breaks_s[0]) / (breaks_s[-1] - breaks_s[0])
        amount = np.zeros((len(middle), len(path)))
        for one in tightenings:
            column = columns.get((one.what, one.item))
            if column is not None:
                share = one.share[np.clip(np.searchsorted(one.breaks, middle, side="right") - 1, 0, len(one.share) - 1)]
                amount[:, column] += size[column, int(one.upper)] * factor[column] * share
        return np.minimum(amount, most)

    return tightening
