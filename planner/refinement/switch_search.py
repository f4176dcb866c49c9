"""Switch times of a motion: read off a solution, then unknowns of further solves until they no longer move.

A duration that ends at a bound of its guess has not converged: the objective still falls there.
"""

from dataclasses import replace

import numpy as np

from linkplan.planner.refinement.case import Case, Iterate, attempt
from linkplan.planner.refinement.constrained_arcs import (
    FixedArcs,
    arc_ends,
    arcs_against_their_limits,
    find_constrained_paths,
    own_arcs,
    path_arcs,
)
from linkplan.planner.refinement.switches import find_bang_efforts, find_switch_times
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Mesh, segmented

# A solve with switch times replaces the last iterate if its objective is at most this share worse: the error of a mesh
# without switch times.
MESH_ERROR_SHARE = 1e-4
# A segment's duration is at its bound if its logarithm is within this share of the range.
SHARE_AT_BOUND = 1e-3
# Switch times next to arcs inside the limits settle until the objective gains less than this share.
SETTLED_GAIN = 1e-9
# A duration this close to its bound (relative) counts as at the bound.
SHARE_AT_GUESS_BOUND = 0.01

LONGER, SHORTER = "longer", "shorter"


def settle_switch_times(
    case: Case,
    found: Iterate,
    *,
    position_rows: bool = False,
) -> Iterate:
    """Return a solution with switch times at its switches, or the same one where switch times make it no better.

    Efforts and path quantities are first held at the limits that the arcs showed, so that only the switch times are unknown.
    If that is worse than the solution without switch times, the arcs were read wrongly, and nothing is held.
    """
    no_worse = SETTLED_GAIN if position_rows else MESH_ERROR_SHARE
    for _ in range(4):  # next to arcs inside the limits switch times settle in so many solves
        before = found.solution.objective
        boundaries = found.motion.breaks_s[found.mesh.boundaries()]
        switch_times, fixed = _arcs_of(case, found, boundaries)
        if not 0 < len(switch_times) <= found.mesh.n_intervals // 6:
            break
        if _known(found.solution.transcribed, fixed) and not at_bounds(found.solution):
            return replace(found, fixed=fixed)
        better, start = None, case.start_from(found.motion)
        finer, durations = mesh_with_switches(boundaries, switch_times, case.problem.mesh.intervals)
        for held, what in ((fixed, "switch times as unknowns"), (None, "switch times as unknowns, efforts free")):
            tried = attempt(case, start, finer, durations, what, warm=True, position_rows=position_rows, fixed=held)
            # If everything is held, nothing can be gained between the nodes: the rest of the difference is the error of the
            # mesh.
            whole = held is not None and held.everything and bool(held.paths.any())
            allowed = MESH_ERROR_SHARE if whole else no_worse
            if tried is not None and len(arcs_against_their_limits(tried.solution)):
                continue  # the arcs were read wrongly
            if tried is not None and tried.solution.objective <= before + allowed * abs(before):
                better = tried
                break
        if better is None:
            break
        settled = better.solution.objective > before - SETTLED_GAIN * abs(before) and not at_bounds(better.solution)
        found = better
        no_worse = SETTLED_GAIN  # from now on both have switch times, and only a better one replaces the other
        if settled or fixed.everything:
            break
    return found


def _arcs_of(case: Case, found: Iterate, boundaries: np.ndarray) -> tuple[np.ndarray, FixedArcs]:
    """Return the ends (n,) [s] of a solution's arcs between phase boundaries [s], and what is held along them.

    Arcs shorter than an interval are bang arcs where nothing else binds; elsewhere they are rather ends of arcs along a
    limit.
    """
    motion, transcribed, x, target = found.motion, found.solution.transcribed, found.solution.x, case.target
    on_path = path_arcs(transcribed, x)
    # Bang arcs end where arcs along a speed limit begin; other efforts bend there, and along a motor's line all do.
    kinds = ("motor", "acceleration", "jerk")
    arcs = own_arcs(transcribed, x, kinds if target.bang_bang else (*kinds, "speed"))
    switch_times = find_switch_times(
        motion,
        target.effort_limit,
        boundaries,
        np.any(on_path, axis=1),
        short=is_bang_bang(case, transcribed),
        continuous_efforts=target.continuous_efforts,
    )
    further = arc_ends(np.hstack([on_path, arcs]), motion.breaks_s, switch_times, boundaries)
    switch_times = np.sort(np.append(switch_times, further))
    ends = np.sort(np.concatenate([boundaries, switch_times]))
    bang_efforts = find_bang_efforts(motion, target.effort_limit, ends[1:-1])
    paths = find_constrained_paths(on_path, motion.breaks_s, ends, bang_efforts)
    return switch_times, FixedArcs(efforts=bang_efforts, paths=paths)


def is_bang_bang(case: Case, transcribed: Transcribed) -> bool:
    """Return True if all efforts are at their limits: time is the objective, and only effort limits and ranges bind."""
    interval = transcribed.program.interval
    return case.target.bang_bang and interval.n_path == 0 and {*interval.own_kinds} <= {"continuity", "position"}


def _known(transcribed: Transcribed, fixed: FixedArcs) -> bool:
    """Return True if a program already holds all of these arcs and leaves nothing free."""
    before = transcribed.bang_efforts
    if before is None or before.shape != fixed.efforts.shape or not fixed.everything:
        return False
    same_paths = (
        not fixed.paths.any()
        if transcribed.constrained_paths is None
        else np.array_equal(transcribed.constrained_paths, fixed.paths)
    )
    return bool(same_paths and np.array_equal(before, fixed.efforts, equal_nan=True))


def at_bounds(solution: Solution) -> bool:
    """Return True if the duration of a segment is at its bound, so that its ends would move further.

    By factors: a bang may be a millionth of what it might become, and yet far from the least that it might.
    """
    transcribed, place = solution.transcribed, solution.transcribed.program.layout.durations()
    free = transcribed.lower[place] < transcribed.upper[place]
    lower, upper, at = (values[place][free] for values in (transcribed.lower, transcribed.upper, solution.x))
    near = SHARE_AT_BOUND * np.log(upper / lower)
    return bool(np.any((np.log(at / lower) < near) | (np.log(upper / at) < near)))


def mesh_with_switches(
    boundaries_s: np.ndarray, switch_times_s: np.ndarray, n_intervals: int, *, least: int = 3
) -> tuple[Mesh, np.ndarray]:
    """Return a mesh with switch times (n_switches,) [s] between phase boundaries [s], and its segments' durations [s].

    It has about `n_intervals`, and at least so many in each segment.
    """
    ends = np.sort(np.concatenate([boundaries_s, switch_times_s]))
    phase = np.searchsorted(boundaries_s, ends[:-1], side="right") - 1
    durations = np.diff(ends)
    return segmented(durations, n_intervals, phase=phase, least=least), durations


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
    if duration < (1 - SHARE_AT_GUESS_BOUND) * longest_s and np.any(free & (at >= (1 - SHARE_AT_GUESS_BOUND) * upper)):
        return LONGER
    if duration > (1 + SHARE_AT_GUESS_BOUND) * shortest_s and np.any(free & (at <= (1 + SHARE_AT_GUESS_BOUND) * lower)):
        return SHORTER
    return None
