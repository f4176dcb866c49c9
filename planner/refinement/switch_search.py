"""Cuts at a motion's switches: read off a solution, and settled by solving again until they stay where they are."""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.refinement.case import Case, CertificateT, Found, MotionT, attempt
from linkplan.planner.refinement.constrained_arcs import Held, arc_ends, free_ends, held_paths, own_arcs, path_arcs
from linkplan.planner.refinement.history import Say, Step
from linkplan.planner.refinement.switches import find_cuts, pinned_efforts
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Mesh, segmented

# A solve with cuts at its switches replaces the one before when it is no slower than the error of a mesh without cuts.
NO_WORSE = 1e-4
# A segment's duration within this share of its room to a bound is at it.
_AT_BOUND = 1e-3
# Cuts next to arcs within the limits settle in a few solves: until the objective gains less than this share, relative.
_SETTLINGS = 4
_SETTLED = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Reading:
    """What a solution's arcs may be: in words, their ends (n_cuts,) [s], and what is held between them."""

    what: str
    cuts_s: np.ndarray
    held: Held | None
    last_resort: bool = False  # whether it is meant only where no other leads to a solution


def settle_switches(
    case: Case[MotionT, CertificateT],
    found: Found[MotionT],
    history: list[Step],
    say: Say,
    *,
    position_rows: bool = False,
) -> Found[MotionT]:
    """Return a solution with mesh cuts at its switches, or the same one where cuts make it no better.

    First with efforts and path quantities held at the limits that the arcs showed, which leaves the cuts alone to be found;
    where that is slower than the solution without cuts, the arcs were read wrongly and all is set free again.
    """
    no_worse = _SETTLED if position_rows else NO_WORSE
    for _ in range(_SETTLINGS):
        before = found.solution.objective
        knots = found.motion.breaks_s[found.mesh.knots()]
        readings = _readings(case, found, knots)
        if not readings or len(readings[0].cuts_s) > found.mesh.n_intervals // 6:
            break
        held = readings[0].held
        if _known(found.solution.transcribed, held) and not at_bounds(found.solution):
            return replace(found, held=held)
        better, solved, start = None, False, case.start_from(found.motion)
        for reading in [*readings, replace(readings[0], what="cuts at the switches, efforts free", held=None)]:
            if solved and reading.last_resort:
                continue
            finer, durations = cut_mesh(knots, reading.cuts_s, case.problem.mesh.intervals)
            tried = attempt(
                case, start, finer, durations, reading.what, history, say,
                warm=True, position_rows=position_rows, held=reading.held,
            )  # fmt: skip
            if tried is not None and tried.solution.objective <= before + no_worse * abs(before):
                better = tried
                break
            solved = solved or tried is not None
        if better is None:
            break
        settled = better.solution.objective > before - _SETTLED * abs(before)
        found = better
        no_worse = _SETTLED  # from now on both have cuts, and only a better one replaces the other
        if settled or held.everything:
            break
    return found


def _readings(case: Case[MotionT, CertificateT], found: Found[MotionT], knots: np.ndarray) -> list[_Reading]:
    """Return what a solution's arcs may be, the likeliest first.

    Arcs shorter than an interval are bangs where nothing else binds; elsewhere they are rather ends of arcs along a limit,
    and only meant where nothing comes of those.
    """
    motion, transcribed, x, aims = found.motion, found.solution.transcribed, found.solution.x, case.aims
    on_path = path_arcs(transcribed, x)
    # Bangs end where arcs along a speed limit begin; other efforts bend there, and along a motor's line all do.
    arcs = own_arcs(transcribed, x, ("motor",) if aims.bangs else ("motor", "speed"))
    arcs = np.hstack([on_path, arcs])
    alone, readings = bangs_alone(case, transcribed), []
    for short in (True,) if alone else (False, True) if aims.bangs else (False,):
        cuts = find_cuts(motion, aims.effort_limit, knots, on_path.any(axis=1), short=short, ramps=aims.ramps)
        cuts = np.sort(np.append(cuts, arc_ends(arcs, motion.breaks_s, cuts, knots)))
        if len(cuts) == 0 or (readings and np.array_equal(cuts, readings[0].cuts_s)):
            continue
        ends = np.sort(np.concatenate([knots, cuts]))
        pinned = pinned_efforts(motion, aims.effort_limit, ends[1:-1])
        held = Held(efforts=pinned, paths=held_paths(on_path, motion.breaks_s, ends, pinned))
        # The second time arcs are read, short ones are taken for bangs though other limits bind.
        again = bool(readings)
        what = "cuts at the switches, short arcs too" if again else "cuts at the switches"
        readings.append(_Reading(what=what, cuts_s=cuts, held=held, last_resort=again))
        if held.paths.any():
            inner, loose = free_ends(ends, held)
            what = "cuts at the switches, ends of arcs free"
            readings.append(_Reading(what=what, cuts_s=np.sort(np.append(cuts, inner)), held=loose))
    return readings


def bangs_alone(case: Case[MotionT, CertificateT], transcribed: Transcribed) -> bool:
    """Return whether efforts are at their limits throughout: time alone counts, and no limits but theirs and ranges bind."""
    interval = transcribed.program.interval
    return case.aims.bangs and interval.n_path == 0 and {*interval.own_kinds} <= {"continuity", "position"}


def _known(transcribed: Transcribed, held: Held) -> bool:
    """Return whether a program has held all of this already, and nothing was left free: there is nothing new to cut."""
    before = transcribed.pinned
    if before is None or before.shape != held.efforts.shape or not held.everything:
        return False
    same_paths = not held.paths.any() if transcribed.held is None else np.array_equal(transcribed.held, held.paths)
    return bool(same_paths and np.array_equal(before, held.efforts, equal_nan=True))


def at_bounds(solution: Solution) -> bool:
    """Return whether a segment is as long as it was allowed to become, or as short: its cuts have further to go."""
    transcribed, place = solution.transcribed, solution.transcribed.program.layout.durations()
    lower, upper, at = transcribed.lower[place], transcribed.upper[place], solution.x[place]
    near = _AT_BOUND * (upper - lower)
    return bool(np.any((near > 0) & ((at - lower < near) | (upper - at < near))))


def cut_mesh(knots_s: np.ndarray, cuts_s: np.ndarray, n_intervals: int) -> tuple[Mesh, np.ndarray]:
    """Return a mesh with movable cuts (n_cuts,) [s] between knots (n_knots,) [s], and its segments' durations [s]."""
    ends = np.sort(np.concatenate([knots_s, cuts_s]))
    leg = np.searchsorted(knots_s, ends[:-1], side="right") - 1
    durations = np.diff(ends)
    return segmented(durations, n_intervals, leg=leg), durations
