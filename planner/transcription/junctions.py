"""Junctions: where an effort at its limit goes over, without a jump, into an arc along a limit that is its own product.

A power u w or a torque-speed line meets the effort's limit where both are reached together. Rows at nodes say so twice,
from either side, and leave no room for what a mesh errs by: such a program is infeasible, or its junction is in the wrong
place. One equation at the node where the arcs meet says it once (Bryson & Ho 1975, section 3.11: entry points); the
effort's own limit gets a little room beside it, which vanishes with the mesh.
"""

from collections.abc import Iterator

import numpy as np

from linkplan.planner.transcription.formulation import Formulation, Start
from linkplan.planner.transcription.mesh import Mesh

# Where in an arc its effort is looked at, and the room its limit is given beside a junction, as a share of its span.
_INSIDE, ROOM = 0.05, 1.0


def find_junctions(
    formulation: Formulation,
    mesh: Mesh,
    durations: np.ndarray,
    start: Start,
    bang_efforts: np.ndarray | None,
    constrained_paths: np.ndarray | None,
) -> np.ndarray | None:
    """Return which path quantities (n_segments - 1, n_path) meet a held effort where segments meet.

    1 where the effort is held before and the quantity after, -1 the other way round, 0 where efforts jump or nothing is.
    None without any.

    Args:
        formulation: the continuous problem.
        mesh: intervals.
        durations: (n_segments,) [s] of its segments in the start.
        start: the motion whose efforts are looked at.
        bang_efforts: (n_segments, n_u), NaN where they are free.
        constrained_paths: (n_segments, n_path).
    """
    if bang_efforts is None or constrained_paths is None or mesh.n_segments < 2:
        return None
    ends = np.concatenate([[0.0], np.cumsum(durations)])
    found = np.zeros((mesh.n_segments - 1, constrained_paths.shape[1]), dtype=int)
    for k, way, i in _candidates(formulation, bang_efforts, constrained_paths):
        arc, bang = (k + 1, k) if way > 0 else (k, k + 1)
        inside = ends[k + 1] + way * _INSIDE * durations[arc]
        effort = start.nodes(np.array([inside]))[3].reshape(-1)
        changes = np.isnan(bang_efforts[arc]) & ~np.isnan(bang_efforts[bang])
        if np.any(changes) and np.all(effort[changes] * bang_efforts[bang, changes] > 0):
            found[k, i] = way
    return found if found.any() else None


def _candidates(
    formulation: Formulation, bang_efforts: np.ndarray, constrained_paths: np.ndarray
) -> Iterator[tuple[int, int, int]]:
    """Yield the ends of segments at which a quantity that jumps with efforts begins (1) or ceases (-1) to be held."""
    for k in range(len(bang_efforts) - 1):
        for i in formulation.rows.open_end_path:
            before, after = (bool(constrained_paths[at, i]) for at in (k, k + 1))
            if before != after:
                yield k, 1 if after else -1, i


def places(junctions: np.ndarray | None, mesh: Mesh) -> Iterator[tuple[int, int, int, int]]:
    """Yield each junction's last interval before it, its segment, path quantity and way."""
    if junctions is None:
        return
    for k, i in zip(*np.nonzero(junctions), strict=True):
        yield int(np.flatnonzero(mesh.segment == k)[-1]), int(k), int(i), int(junctions[k, i])
