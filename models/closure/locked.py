"""Locked mechanisms: the error that names the closures which lock a mechanism, and the freedom gained without each."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from linkplan.models.closure.equations import Closure
from linkplan.models.closure.mobility import Mobility
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.closure.rank import numerical_rank, weak_rank
from linkplan.models.errors import LockedError


def refuse_locked(mobility: Mobility, pose: np.ndarray, tolerance_m: float) -> None:
    """Refuse a mechanism with no degree of freedom at a closed pose (n_q,) with a mobility and an allowed gap [m].

    Raises:
        LockedError: if the mechanism is locked; the message names the closures that lock it.
    """
    loop = mobility.loop
    rank, n_joints = loop.rank(pose), len(loop.joints)
    if rank < n_joints:
        return
    error = LockedError(
        f"mechanism '{loop.name}' is locked: {n_joints} joints less {rank} independent closure rows leave 0 degrees of"
        f" freedom{_hint(weak_rank(loop.jacobian(pose), loop.rank_tolerance), mobility.locked, tolerance_m)}"
    )
    raise locked_by(error, loop, pose)


def locked_by(error: LockedError, loop: KinematicLoop, pose: np.ndarray) -> LockedError:
    """Return the error with the closures added that lock the mechanism at a closed pose (n_q,)."""
    freed = freedoms_without(loop.closures, loop.jacobian(pose), loop.rank_tolerance)
    return LockedError(f"{error}{_freed_text(freed)}", freed)


def freedoms_without(
    closures: Sequence[Closure], jacobian: np.ndarray, share: float, *, max_size: int = 3, max_listed: int = 8
) -> dict[str, int]:
    """Return the degrees of freedom gained by leaving out closures, or orientations of welds, by the names left out.

    A key joins names with " and " if only the set frees the mechanism. Sets of `max_size` closures are tried only if no
    smaller set frees it. At most `max_listed` sets are returned.
    """
    least = numerical_rank(jacobian, share)
    parts = list(_parts(closures))
    found: dict[frozenset[str], int] = {}
    for size in range(1, max_size + 1):
        if size == max_size and found:
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
    named = {" and ".join(sorted(names, key=order.index)): more for names, more in found.items()}
    return dict(itertools.islice(named.items(), max_listed))


def _parts(closures: Sequence[Closure]) -> Iterator[tuple[str, list[int]]]:
    """Yield the names of the closures, and of the orientations of welds, with their rows."""
    rows: dict[int, list[int]] = {}
    for gap in closures:
        rows.setdefault(gap.index, []).extend(range(gap.rows.start, gap.rows.stop))
    names = {gap.index: gap.name for gap in closures}
    for index, own in rows.items():
        yield names[index], own
    for gap in closures:
        if gap.kind == "orientation":
            yield f"weld {gap.name}'s orientation", list(range(gap.rows.start, gap.rows.stop))


def _freed_text(freed: dict[str, int]) -> str:
    """Return the clause that lists the closures which lock a mechanism, empty if there are none."""
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
