"""From a first solution to a certified one: switch times as unknowns, finer meshes, higher degrees until it passes."""

from dataclasses import replace
from typing import Any

import numpy as np

from linkplan.models.interrupts import check
from linkplan.planner.refinement.case import Case, CertificateT, Found, MotionT, attempt
from linkplan.planner.refinement.constrained_arcs import FixedArcs, standing_off
from linkplan.planner.refinement.history import Say, Step
from linkplan.planner.refinement.judged import error_of, judged
from linkplan.planner.refinement.marking import (
    degree_of,
    grown,
    higher_for,
    higher_on_arcs,
    marked_for,
    overrunning,
    rough_of,
    uneven_of,
    widths_of,
)
from linkplan.planner.refinement.pontryagin import limits_bind
from linkplan.planner.refinement.refined import Refined, better_of
from linkplan.planner.refinement.rough_intervals import refine_rough
from linkplan.planner.refinement.switch_search import at_bounds, is_bang_bang, settle_switch_times
from linkplan.planner.solvers.outcome import SUCCEEDED
from linkplan.planner.transcription.mesh import halved

# Rounds of refinement after the first solve.
_ROUNDS = 12
# Rounds beyond those, each only where it leaves at most this share of what the one before left: of an error that is asked to
# be small, of a limit overrun between the nodes. A boundary layer a ten-thousandth of the motion long takes eight halvings.
_FURTHER, _LEAVES = 24, 0.5
# Meshes in a row on which the objective is to change by no more than its tolerance: one may do so by chance.
_SETTLED = 2
# From this round on limits are tightened while the mesh still grows; from the later one on even those that it could mend.
_MERGED, _MERGED_ALL = 4, 8
# How often switches are looked for again where limits are overrun next to ends of arcs that a finer mesh shows.
_AGAIN = 2
# A mesh that has grown by this factor without passing will not pass by growing on.
_MOST = 120
# Where no tolerance is asked for, the target is followed as far as a mesh of so many intervals carries it.
_COMFORTABLE = 100
# An unstable motion's degree is not raised beyond this one: the Alp rider (Betts 2010) took 9 s for 40 s of processor time.
_UNSTABLE = 5
# So often switches are read again from a motion that passes.
_POLISHED = 3
# Touched limits are refined until the objective changes by no more than this, relative.
_TOUCHED = 1e-7
# Answers on two meshes that are no further apart are the same motion, relative.
_SAME = 1e-6


def refine(
    case: Case[MotionT, CertificateT], found: Found[MotionT], history: list[Step], say: Say, *, warm: bool = False
) -> Refined[MotionT, CertificateT] | None:
    """Return the best motion towards the tolerance, or None without a certificate.

    The certificate may not pass: then the motion is the last one tried. Warm, finer meshes are solved from next to the
    coarser one's answer: less exact, but a motion that is unstable is not lost on the way.
    """
    aims, kept, position_rows = case.aims, case, False
    if aims.enclosed:
        return refine_rough(case, found, history, say)
    finest = _MOST * case.problem.mesh.intervals
    comfortable = finest if aims.tolerance_given else _COMFORTABLE
    if not (found.fixed is not None and found.fixed.everything and not at_bounds(found.solution)):
        found = replace(found, fixed=None)
    if aims.switches and found.fixed is None:
        found = settle_switch_times(case, found, history, say)
    at = judged(case, found, history)
    passed, before = None, np.inf  # the last that passed, to go back to where a finer one does not; the objective before
    best, moved = None, 0.0  # the best of all that passed, and by what share the last two differ
    settled, again, polished, read = True, 0, 0, 0  # and the round in which switches were last read
    calm, tells, lost = 0, False, False  # settled so often; whether this mesh tells; whether rows led nowhere
    left, leaves = np.inf, True  # what was left of the integration error and the objective's change; whether it falls
    erred, falls = np.inf, True  # the integration error before; whether it falls
    overran = np.inf  # by what limits were overrun between the nodes before
    for turn in range(_FURTHER):
        check()
        if at.findings is not None and not at.passed and not at.findings.mendable:
            break
        motion, solution, fixed = at.found.motion, at.found.solution, at.found.fixed
        off = standing_off(solution.transcribed, solution.x) if aims.bang_bang else np.zeros(at.n_intervals, dtype=bool)
        if at.passed:
            passed, best = at, better_of(best, at, aims)
            change = abs(solution.objective - before)
            if np.isfinite(before) and solution.objective:
                moved = change / abs(solution.objective)
            smooth = aims.kinks_at_limits and not limits_bind(solution)
            tolerance = None if smooth else aims.objective_tolerance
            still = tolerance is None or change <= tolerance * abs(solution.objective)
            if solution.status == SUCCEEDED:  # a solver that stopped short says nothing of the objective
                calm = calm + 1 if still and tells else 0
            settled = tolerance is None or calm >= (_SETTLED if fixed is None else 1)
            if at.findings.exact and settled and (not off.any() or change <= _TOUCHED * abs(solution.objective)):
                known = fixed is not None and fixed.everything and not at_bounds(solution)
                if polished == _POLISHED or known or not is_bang_bang(case, solution.transcribed):
                    break
                # Efforts were left free, or switch times have further to go: switches are read again, from a motion that is
                # right.
                polished += 1
                better = settle_switch_times(kept, at.found, history, say, position_rows=position_rows)
                if better.solution is solution:
                    break
                at = judged(case, better, history)
                continue
            if solution.status == SUCCEEDED or tolerance is None:
                before = solution.objective
        begun = position_rows
        position_rows = not lost and (position_rows or at.findings is None or at.findings.leaves_positions)
        marked, over = marked_for(at, aims.strictness) | off, overrunning(at)
        overruns = np.inf if at.findings is None else at.findings.overrun.max(initial=0.0)
        overran, closes_in = overruns, at.overruns and overruns <= _LEAVES * overran
        loose = aims.switches and not (fixed is not None and fixed.everything)
        if over.any() and loose and turn and turn % 2 == 0 and again < _AGAIN:
            again += 1
            better = settle_switch_times(kept, at.found, history, say, position_rows=position_rows)
            if better.solution is not solution:
                # Held throughout, a motion has next to nothing to gain between the nodes: a finer mesh is worth its rounds.
                read = turn if better.fixed is not None and better.fixed.everything else read
                at = judged(case, better, history)
                continue
        uneven = np.zeros(at.n_intervals, dtype=bool)
        if not settled and at.passed and (fixed is None or not (marked | over).any()):
            # With arcs held between switch times, limits begin and cease to bind there and not inside intervals.
            uneven = uneven_of(at) if fixed is None else rough_of(motion)
        marked = marked | uneven
        seen = at.findings is None or not at.findings.unseen
        unstable = warm and at.findings is not None and at.findings.unstable
        close = unstable and seen  # by now each mesh's answer is next to the one before
        read = read if seen else turn  # rounds in which a mesh saw nothing were none on limits
        higher = higher_on_arcs(kept, at, over) if seen else None
        if over.any() and loose:
            marked = over  # an arc that is shorter than an interval must be seen before it can have boundaries of its own
        elif seen:
            higher = higher or higher_for(kept, at.certificate, marked)
        if unstable and higher is not None and degree_of(higher) > _UNSTABLE:
            higher = None
        # Held throughout, limits overrun between the nodes by what the mesh errs by: tightened by that, the motion is late.
        held = fixed is not None and fixed.everything and fixed.paths.any()
        if grown(at.found.mesh, marked | over) <= (finest if held else comfortable):
            marked = marked | over
        what = "finer mesh"
        if position_rows and not begun and at.certificate is not None:
            what, marked = "state limits imposed at every instant", np.zeros(at.n_intervals, dtype=bool)
        elif higher is not None:
            kept, what, marked = kept.with_scheme(higher), f"higher degree, {higher}", np.zeros(at.n_intervals, dtype=bool)
        elif not marked.any() and at.overruns:
            # Only a limit is left, between the nodes: ask the solver for a little less than it.
            kept, what = kept.tightened(at.certificate, motion), "constraints tightened between the nodes"
        elif not marked.any():
            marked[:] = True
        elif turn - read >= (_MERGED_ALL if over.any() else _MERGED) and at.overruns:
            kept, what = kept.tightened(at.certificate, motion), "finer mesh, constraints tightened between the nodes"
        tells = not np.any(uneven & ~marked)
        n_finer = grown(at.found.mesh, marked)
        if turn >= _ROUNDS and not (closes_in or (aims.tolerance_given and leaves)):
            break
        # What errs on each finer mesh by as much as before is another motion on each.
        wandering = marked.any() and at.findings is not None and not at.findings.exact and not falls and not over.any()
        wandering = wandering and not aims.layers
        if n_finer > finest or ((passed is not None or wandering) and not aims.tolerance_given and n_finer > _COMFORTABLE):
            if loose and at.passed and polished < _POLISHED and is_bang_bang(case, solution.transcribed):
                # Its switches lie inside intervals, which no finer mesh will part: they are read from a motion that passes.
                polished += 1
                better = settle_switch_times(kept, at.found, history, say, position_rows=position_rows)
                if better.solution is not solution:
                    at = judged(case, better, history)
                    continue
            break
        finer = _finer(
            kept, at.found, marked, what, history, say, warm=warm, close=close, again=passed is not None,
            position_rows=position_rows,
        )  # fmt: skip
        if finer is None and position_rows and not begun:
            # What leaves its limit by the mesh's own error keeps it on a finer one.
            lost, position_rows, marked = True, False, np.ones(at.n_intervals, dtype=bool)
            finer = _finer(
                kept, at.found, marked, "finer mesh", history, say, warm=warm, close=close, again=passed is not None,
                position_rows=False,
            )  # fmt: skip
        if finer is None:
            break
        if position_rows and not begun and aims.switches:
            finer = settle_switch_times(kept, replace(finer, fixed=None), history, say, position_rows=True)
        at = judged(case, finer, history)
        now = max(at.findings.integration_error or 0.0, abs(at.found.solution.objective - before)) if at.findings else np.inf
        left, leaves = now, now <= _LEAVES * left
        errs = error_of(at)
        erred, falls = errs, errs <= _LEAVES * erred
    if not (at.passed and settled and aims.objective_tolerance is not None):
        at = better_of(best, at, aims) if at.passed else best or at
    if at.certificate is None:
        return None
    return Refined(
        motion=at.found.motion, solution=at.found.solution, certificate=at.certificate, settled=settled, moved=moved
    )


def _finer(
    case: Case[MotionT, CertificateT], coarse: Found[MotionT], marked: np.ndarray, what: str, history: list[Step], say: Say,
    *, warm: bool, close: bool, again: bool, position_rows: bool,
) -> Found[MotionT] | None:  # fmt: skip
    """Return what is found with the marked intervals (n,) halved, or None.

    Where one passed before, it is looked for `again` where it is lost, in the end with nothing fixed; a bang-bang one is
    looked for right at the coarser one's, and from afar too where that gives another.
    """
    mesh, start, bang_bang = halved(coarse.mesh, marked), case.start_from(coarse.motion), case.aims.bang_bang
    durations = np.bincount(mesh.segment, weights=widths_of(coarse.motion, marked))

    def tried(word: str, fixed: FixedArcs | None, **how: bool) -> Found[MotionT] | None:
        return attempt(
            case, start, mesh, durations, what + word, history, say, position_rows=position_rows, fixed=fixed, **how
        )

    ways = [("", {"warm": warm, "close": close}), (", warm start", {"close": True})][: 2 if again else 1]
    found: list[Found[MotionT]] = []
    for word, how in reversed(ways) if bang_bang else ways:
        finer = tried(word, coarse.fixed, **how)
        if finer is not None:
            found.append(finer)
            if finer.solution.status == SUCCEEDED and not (bang_bang and not _alike(finer, coarse)):
                break
    # A solver that stopped short where it began has lost nothing: on singular arcs it comes no nearer to its tolerance.
    lost = all(finer.solution.status != SUCCEEDED and not _alike(finer, coarse) for finer in found)
    if again and coarse.fixed is not None and lost:
        loose = tried(", efforts and paths free", None, close=True)
        if loose is not None:
            return loose
    return min(found, key=lambda finer: (finer.solution.status != SUCCEEDED, finer.solution.objective), default=None)


def _alike(finer: Found[Any], coarse: Found[Any]) -> bool:
    """Return whether objectives on two meshes are those of the same motion."""
    return abs(finer.solution.objective - coarse.solution.objective) <= _SAME * abs(coarse.solution.objective)
