"""Cuts at a motion's switches: read off a solution, and settled by solving again until they stay where they are."""

from typing import Any

import numpy as np

from linkplan.planner.refinement.case import Case, attempt
from linkplan.planner.refinement.constrained_arcs import arc_ends, free_ends, held_paths, own_arcs, path_arcs
from linkplan.planner.refinement.history import Say, Step
from linkplan.planner.refinement.switches import find_cuts, pinned_efforts
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Mesh, segmented

# A solve with cuts at its switches replaces the one before when it is no slower than the error of a mesh without cuts.
NO_WORSE = 1e-4
# A segment's duration within this share of its room to a bound is at it.
_AT_BOUND = 1e-3
# The words on a reading that takes short arcs for bangs though other limits bind.
_SHORT = "cuts at the switches, short arcs too"
# Cuts next to arcs within the limits settle in a few solves: until the objective gains less than this share, relative.
_SETTLINGS = 4
_SETTLED = 1e-9


def settle_switches(
    case: Case,
    motion: Any,
    solution: Solution,
    mesh: Mesh,
    history: list[Step],
    say: Say,
    *,
    position_rows: bool = False,
    arcs: dict[str, Any] | None = None,
):
    """Return a solution with mesh cuts at its switches: motion, solution, mesh, and what is held between the cuts.

    First with efforts and path quantities held at the limits that the arcs showed, which leaves the cuts alone to be found;
    where that is slower than the solution without cuts, the arcs were read wrongly and all is set free again.
    """
    chosen, no_worse = arcs or {}, _SETTLED if position_rows else NO_WORSE
    for _ in range(_SETTLINGS):
        knots = motion.breaks_s[mesh.knots()]
        readings = _readings(case, motion, solution, knots)
        if not readings or len(readings[0][1]) > mesh.n_intervals // 6:
            break
        held = readings[0][2]
        if _known(solution.transcribed, held) and not at_bounds(solution):
            return motion, solution, mesh, held
        better, solved, start = None, False, case.start_from(motion)
        for what, cut, options in [*readings, ("cuts at the switches, efforts free", readings[0][1], {})]:
            if solved and what == _SHORT:
                continue
            finer, durations = cut_mesh(knots, cut, case.mesh.intervals)
            found = attempt(
                case, start, finer, durations, what, history, say, warm=True, position_rows=position_rows, **options
            )
            if found is not None and found[1].objective <= solution.objective + no_worse * abs(solution.objective):
                better = found
                break
            solved = solved or found is not None
        if better is None:
            break
        settled = better[1].objective > solution.objective - _SETTLED * abs(solution.objective)
        (motion, solution), mesh, chosen = better, finer, options
        no_worse = _SETTLED  # from now on both have cuts, and only a better one replaces the other
        if settled or all_held(held):
            break
    return motion, solution, mesh, chosen


def _readings(
    case: Case, motion: Any, solution: Solution, knots: np.ndarray
) -> list[tuple[str, np.ndarray, dict[str, Any]]]:
    """Return what a solution's arcs may be: in words, their ends (n_cuts,) [s] and what is held between them.

    Arcs shorter than an interval are bangs where nothing else binds; elsewhere they are rather ends of arcs along a limit,
    and only meant where nothing comes of those.
    """
    on_path = path_arcs(solution.transcribed, solution.x)
    # Bangs end where arcs along a speed limit begin; other efforts bend there, and along a motor's line all do.
    arcs = own_arcs(solution.transcribed, solution.x, ("motor",) if case.bangs else ("motor", "speed"))
    arcs = np.hstack([on_path, arcs])
    alone, readings = bangs_alone(case, solution.transcribed), []
    for short in (True,) if alone else (False, True) if case.bangs else (False,):
        cuts = find_cuts(motion, case.effort_limit, knots, on_path.any(axis=1), short=short, ramps=case.ramps)
        cuts = np.sort(np.append(cuts, arc_ends(arcs, motion.breaks_s, cuts, knots)))
        if len(cuts) == 0 or (readings and np.array_equal(cuts, readings[0][1])):
            continue
        ends = np.sort(np.concatenate([knots, cuts]))
        pinned = pinned_efforts(motion, case.effort_limit, ends[1:-1])
        held = {"pinned": pinned, "held": held_paths(on_path, motion.breaks_s, ends, pinned)}
        readings.append((_SHORT if readings else "cuts at the switches", cuts, held))
        if held["held"].any():
            inner, loose = free_ends(ends, **held)
            readings.append(("cuts at the switches, ends of arcs free", np.sort(np.append(cuts, inner)), loose))
    return readings


def bangs_alone(case: Case, transcribed: Transcribed) -> bool:
    """Return whether efforts are at their limits throughout: time alone counts, and no limits but theirs and ranges bind."""
    interval = transcribed.program.interval
    return case.bangs and interval.n_path == 0 and {*interval.own_kinds} <= {"continuity", "position"}


def _known(transcribed: Transcribed, held: dict[str, np.ndarray]) -> bool:
    """Return whether a program has held all of this already, and nothing was left free: there is nothing new to cut."""
    before, paths = transcribed.pinned, held["held"]
    if before is None or before.shape != held["pinned"].shape or not all_held(held):
        return False
    same_paths = not paths.any() if transcribed.held is None else np.array_equal(transcribed.held, paths)
    return bool(same_paths and np.array_equal(before, held["pinned"], equal_nan=True))


def at_bounds(solution: Solution) -> bool:
    """Return whether a segment is as long as it was allowed to become, or as short: its cuts have further to go."""
    transcribed, place = solution.transcribed, solution.transcribed.program.layout.durations()
    lower, upper, at = transcribed.lower[place], transcribed.upper[place], solution.x[place]
    near = _AT_BOUND * (upper - lower)
    return bool(np.any((near > 0) & ((at - lower < near) | (upper - at < near))))


def all_held(held: dict[str, np.ndarray]) -> bool:
    """Return whether every segment holds as much as it has efforts: then the cuts alone were to be found."""
    if not held:
        return False
    return bool(np.all(np.isnan(held["pinned"]).sum(axis=1) == np.count_nonzero(held["held"], axis=1)))


def cut_mesh(knots_s: np.ndarray, cuts_s: np.ndarray, n_intervals: int) -> tuple[Mesh, np.ndarray]:
    """Return a mesh with movable cuts (n_cuts,) [s] between knots (n_knots,) [s], and its segments' durations [s]."""
    ends = np.sort(np.concatenate([knots_s, cuts_s]))
    leg = np.searchsorted(knots_s, ends[:-1], side="right") - 1
    durations = np.diff(ends)
    return segmented(durations, n_intervals, leg=leg), durations
