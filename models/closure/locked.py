"""Locked mechanisms: refused with the closures that lock them, each by the freedom that there would be without it."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from linkplan.models.closure.equations import Closure
from linkplan.models.closure.mobility import Mobility
from linkplan.models.closure.rank import numerical_rank, weak_rank
from linkplan.models.errors import LockedError

# Closures are left out by so many at a time to see which lock a mechanism, more than two only where two do not; and so many
# sets of them are named.
_TOGETHER, _ALWAYS, _SETS = 3, 2, 8


def refuse_locked(
    name: str, n_joints: int, closures: Sequence[Closure], jacobian: np.ndarray, mobility: Mobility, tolerance_m: float
) -> None:
    """Refuse a mechanism whose closures leave nothing to move.

    Args:
        name: of the mechanism.
        n_joints: of its tree.
        closures: of the mechanism.
        jacobian: of phi at a closed pose (n_rows, n_joints), in units of what counts as a radian.
        mobility: as judged there.
        tolerance_m: the gap [m] that was allowed.

    Raises:
        LockedError: with the closures without which it would move.
    """
    share = mobility.loop.rank_tolerance
    rank = numerical_rank(jacobian, share)
    if rank < n_joints:
        return
    error = LockedError(
        f"mechanism '{name}' is locked: {n_joints} joints less {rank} independent closure rows leave 0 degrees of"
        f" freedom{_hint(weak_rank(jacobian, share), mobility.locked, tolerance_m)}",
        {},
    )
    raise locked_by(error, closures, jacobian, share)


def locked_by(error: LockedError, closures: Sequence[Closure], jacobian: np.ndarray, share: float) -> LockedError:
    """Return the refusal of a locked mechanism that names the closures which lock it; the Jacobian as of `refuse_locked`."""
    freed = without_which_it_moves(closures, jacobian, share)
    return LockedError(f"{error}{freed_words(freed)}", freed)


def without_which_it_moves(closures: Sequence[Closure], jacobian: np.ndarray, share: float) -> dict[str, int]:
    """Return the degrees of freedom that come with leaving out a closure, or the orientation of a weld, by what is left out.

    Sets that do so only together have their names joined by " and ".
    """
    least = numerical_rank(jacobian, share)
    parts = list(_parts(closures))
    found: dict[frozenset[str], int] = {}
    for size in range(1, _TOGETHER + 1):
        if size > _ALWAYS and found:
            break
        for chosen in itertools.combinations(parts, size):
            names = frozenset(part for part, _ in chosen)
            if any(fewer <= names for fewer in found):
                continue
            left_out = np.unique([row for _, rows in chosen for row in rows])
            more = least - numerical_rank(np.delete(jacobian, left_out, axis=0), share)
            if more:
                found[names] = more
    order = [part for part, _ in parts]
    said = {" and ".join(sorted(names, key=order.index)): more for names, more in found.items()}
    return dict(itertools.islice(said.items(), _SETS))


def _parts(closures: Sequence[Closure]) -> Iterator[tuple[str, list[int]]]:
    """Yield what may be left out, in words, with its rows."""
    rows: dict[int, list[int]] = {}
    for gap in closures:
        rows.setdefault(gap.index, []).extend(range(gap.rows.start, gap.rows.stop))
    names = {gap.index: gap.name for gap in closures}
    for index, own in rows.items():
        yield names[index], own
    for gap in closures:
        if gap.kind == "orientation":
            yield f"weld {gap.name}'s orientation", list(range(gap.rows.start, gap.rows.stop))


def freed_words(freed: dict[str, int]) -> str:
    """Return the words on the closures that lock a mechanism, to follow a sentence."""
    if not freed:
        return ""

    parts = [f"{part} ({more})" for part, more in freed.items()]
    first = next(iter(freed.values()))
    parts[0] = parts[0].replace(f"({first})", f"({first} degree{'s' if first > 1 else ''} of freedom)")
    return f"; it moves without {', '.join(parts)}"


def _hint(weak: int, locked, tolerance_m: float) -> str:
    if not weak:
        return ""
    gap = max((gap for _, gap in locked), default=0.0)
    opens = f" (moved by 0.1 rad the loops open by {gap:.3g} m; closure_tolerance_m = {tolerance_m:g})" if gap else ""
    return (
        f"; {weak} of these rows is nearly dependent on the others (1e-4 of the largest singular value): joint axes or"
        f" points meant to be aligned are slightly off{opens}"
    )
