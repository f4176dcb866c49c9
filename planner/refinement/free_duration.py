"""Free durations that end at the bounds of their guess: there the objective still falls, and no best motion is found."""

import numpy as np

from linkplan.planner.solvers.solve import Solution

# A duration within this share of where it may end is there.
SHARE_AT_BOUND = 0.01

LONGER, SHORTER = "longer", "shorter"


def bounded_by_guess(solution: Solution, shortest_s: float, longest_s: float) -> str | None:
    """Return `LONGER` or `SHORTER`, as the motion would be, where a bound is in its way that is not the user's; else None.

    A free duration is searched between a fiftieth and a hundred times its guess. A motion with switch times has settled near
    them, and None is returned.

    Args:
        solution: of a program.
        shortest_s: the user's bounds on the duration [s], equal where it is fixed.
        longest_s: infinite where there is none.
    """
    transcribed = solution.transcribed
    place, mesh = transcribed.program.layout.durations(), transcribed.program.mesh
    if shortest_s == longest_s or np.any(np.bincount(mesh.phase) > 1):
        return None
    at, lower, upper = solution.x[place], transcribed.lower[place], transcribed.upper[place]
    free, duration = lower < upper, float(at.sum()) * transcribed.units.time_s  # phases to given instants are not free
    if duration < (1 - SHARE_AT_BOUND) * longest_s and np.any(free & (at >= (1 - SHARE_AT_BOUND) * upper)):
        return LONGER
    if duration > (1 + SHARE_AT_BOUND) * shortest_s and np.any(free & (at <= (1 + SHARE_AT_BOUND) * lower)):
        return SHORTER
    return None
