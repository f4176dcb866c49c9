"""Junctions: switch times at which an effort's limit and a limit on a quantity that contains the effort bind together.

A power u w or a torque-speed line continues an arc at the effort's limit without a jump. Rows at the nodes would impose this
twice, once from either side. With the mesh's error such a program is infeasible, or its junction is misplaced. So one
equation is imposed at the node of the switch (Bryson & Ho 1975, section 3.11: entry points), and the effort's own limit is
relaxed next to it; the violation vanishes as the mesh is refined.
"""

from collections.abc import Iterator

import numpy as np

from linkplan.planner.transcription.formulation import Formulation, Start
from linkplan.planner.transcription.mesh import Mesh


def find_junctions(
    formulation: Formulation,
    mesh: Mesh,
    durations: np.ndarray,
    start: Start,
    bang_efforts: np.ndarray | None,
    constrained_paths: np.ndarray | None,
) -> np.ndarray | None:
    """Return the junctions (n_segments - 1, n_path) of path quantities between segments; None if there are none.

    1: the effort is held before and the quantity after. -1: the reverse. 0: the effort jumps, or neither is held.

    Args:
        formulation: the continuous problem.
        mesh: intervals.
        durations: (n_segments,) [s] of its segments in the start.
        start: the motion that gives the efforts.
        bang_efforts: (n_segments, n_u), NaN where they are free.
        constrained_paths: (n_segments, n_path).
    """
    if bang_efforts is None or constrained_paths is None or mesh.n_segments < 2:
        return None
    ends = np.concatenate([[0.0], np.cumsum(durations)])
    found = np.zeros((mesh.n_segments - 1, constrained_paths.shape[1]), dtype=int)
    for k, way, i in _candidates(formulation, bang_efforts, constrained_paths):
        arc, bang = (k + 1, k) if way > 0 else (k, k + 1)
        inside = ends[k + 1] + way * 0.05 * durations[arc]  # close to the switch, but clearly within the arc
        effort = start.nodes(np.array([inside]))[3].reshape(-1)
        changes = np.isnan(bang_efforts[arc]) & ~np.isnan(bang_efforts[bang])
        if np.any(changes) and np.all(effort[changes] * bang_efforts[bang, changes] > 0):
            found[k, i] = way
    return found if found.any() else None


def _candidates(
    formulation: Formulation, bang_efforts: np.ndarray, constrained_paths: np.ndarray
) -> Iterator[tuple[int, int, int]]:
    """Yield the ends of segments where a quantity that jumps with efforts begins (1) or ends (-1) to be held."""
    for k in range(len(bang_efforts) - 1):
        for i in formulation.rows.open_end_path:
            before, after = (bool(constrained_paths[at, i]) for at in (k, k + 1))
            if before != after:
                yield k, 1 if after else -1, i


def junction_places(junctions: np.ndarray | None, mesh: Mesh) -> Iterator[tuple[int, int, int, int]]:
    """Yield per junction the last interval before it, its segment, its path quantity and its direction."""
    if junctions is None:
        return
    for k, i in zip(*np.nonzero(junctions), strict=True):
        yield int(np.flatnonzero(mesh.segment == k)[-1]), int(k), int(i), int(junctions[k, i])
