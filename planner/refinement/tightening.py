"""Constraint tightening: limits that a motion overran between the nodes, tightened there and by that much."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.certificate.margins import Margin

# A little more than the overrun is taken off, so that the next motion keeps the limit and does not creep towards it.
_MORE = 1.1
_FLOOR = 1e-7
# So little of a limit is taken off all along: where one interval alone is to keep more of it than its neighbours, what its
# polynomial errs by at its end grows with that.
_LITTLE = 2e-5
# Bounds are never tightened beyond this share of what lies between them.
_MOST = 0.45
# The limits that are rows of nodes, and so can be overrun between them.
AT_NODES = ("speed", "motor", "power", "closure_force", "singular_margin", "control", "tendon", "site", "tube", "robust")
# Of those, the ones whose rows are the square of what is limited, and those that are tightened in units of their rows.
SQUARED, IN_UNITS = ("closure_force", "tube"), ("site", "tendon")


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
    return np.where(overrun > 0, _MORE * overrun + _FLOOR, 0.0)


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
        if margin.what in AT_NODES and not margin.kept:
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
        replace(one, share=np.full_like(one.share, share)) if share <= _LITTLE else one
        for one, share in zip(tightenings, most, strict=True)
    )


def tightening_over(
    tightenings: tuple[Tightening, ...], rows: list[tuple[str, int]], path: np.ndarray
) -> Callable[[np.ndarray], np.ndarray] | None:
    """Return a function from breaks (n + 1,) [s] to how much (n, n_path) the bounds `path` (n_path, 2) are tightened.

    `rows` say for each path quantity which limit it is; the row of a closure's force is the force squared, that of a tube
    the distance. A site's place and a tendon's length have no size of their own: their share is one of the row's unit.
    """
    if not tightenings:
        return None
    size = np.where(np.isfinite(path), np.where(path == 0, 1.0, np.abs(path)), 0.0)
    size[[what in IN_UNITS for what, _ in rows]] = 1.0
    most = np.where(np.all(np.isfinite(path), axis=1), _MOST * (path[:, 1] - path[:, 0]), np.inf)

    def tightening(breaks_s: np.ndarray) -> np.ndarray:
        middle = (0.5 * (breaks_s[1:] + breaks_s[:-1]) - breaks_s[0]) / (breaks_s[-1] - breaks_s[0])
        amount = np.zeros((len(middle), len(path)))
        for one in tightenings:
            if (one.what, one.item) in rows:
                column = rows.index((one.what, one.item))
                share = one.share[np.clip(np.searchsorted(one.breaks, middle, side="right") - 1, 0, len(one.share) - 1)]
                amount[:, column] += size[column, int(one.upper)] * (2 * share if one.what in SQUARED else share)
        return np.minimum(amount, most)

    return tightening
