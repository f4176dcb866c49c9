"""Refinement where limits are kept at every instant: intervals on which efforts jump or bend are halved.

Such limits are rows on Bernstein coefficients, which enclose the motion: an effort that jumps inside an interval keeps them
there too, at a cost of second order in its width. Nothing is to be known of which limit follows on which, as it is where
switch times are unknowns: with several efforts these are many.
"""

import numpy as np

from linkplan.models.interrupts import check
from linkplan.planner.refinement.case import Case, CertificateT, Found, MotionT, attempt
from linkplan.planner.refinement.constrained_arcs import standing_off
from linkplan.planner.refinement.history import Say, Step
from linkplan.planner.refinement.judged import Judged, judged
from linkplan.planner.refinement.marking import degree_of, grown, higher_for, marked_for, uneven_of, widths_of
from linkplan.planner.refinement.refined import Refined, better_of
from linkplan.planner.transcription.mesh import halved

# Rounds after the first solve.
_ROUNDS = 24
# A mesh with a motion that passes is refined up to so many intervals, and to the larger number while finer ones still change
# the objective by more than this share.
_COMFORTABLE, _LARGE, _MOVES = 100, 200, 1e-4
# A mesh that has grown by this factor without passing will not pass by growing on.
_MOST = 120
# The degree is not raised beyond this one: where efforts jump, more nodes are worth less than narrower intervals.
_HIGHEST = 5


def refine_rough(
    case: Case[MotionT, CertificateT], found: Found[MotionT], history: list[Step], say: Say
) -> Refined[MotionT, CertificateT] | None:
    """Return the best motion on meshes that are finer where efforts are rough, or None without a certificate.

    The certificate may not pass: then the motion is the last one tried.
    """
    kept, aims, position_rows, lost = case, case.aims, False, False  # whether position rows led nowhere
    at, best, before, moved, settled = judged(case, found, history), None, np.inf, 0.0, False
    for _ in range(_ROUNDS):
        check()
        objective = at.found.solution.objective
        change = abs(objective - before)
        if np.isfinite(before) and objective:
            moved = change / abs(objective)
        if at.passed:
            best = better_of(best, at, aims)
            settled = _settled(at, aims.objective_tolerance, change)
        if settled or at.findings is None or not (at.passed or at.findings.mendable):
            break
        marked, what = _marked(kept, at, change), "finer mesh"
        comfortable = _LARGE if change > _MOVES * abs(objective) else _COMFORTABLE
        higher = higher_for(kept, at.certificate, marked_for(at, aims.strictness))
        begun = position_rows
        if at.findings.leaves_positions and not (position_rows or lost):
            position_rows, what, marked = True, "state limits imposed at every instant", np.zeros_like(marked)
        elif higher is not None and degree_of(higher) <= _HIGHEST:
            kept, what, marked = kept.with_scheme(higher), f"higher degree, {higher}", np.zeros_like(marked)
        elif at.overruns and (not marked.any() or grown(at.found.mesh, marked) > comfortable):
            kept, marked = kept.tightened(at.certificate, at.found.motion), np.zeros_like(marked)
            what = "constraints tightened between the nodes"
        elif grown(at.found.mesh, marked) > (comfortable if best is not None else _MOST * case.problem.mesh.intervals):
            break
        if marked.any() or higher is not None:
            before = objective
        finer = _finer(kept, at.found, marked, what, history, say, position_rows=position_rows)
        if finer is None and position_rows and not begun:
            # What leaves its limit by the mesh's own error keeps it on a finer one.
            lost, position_rows, marked = True, False, np.ones(at.n_intervals, dtype=bool)
            finer = _finer(kept, at.found, marked, "finer mesh", history, say, position_rows=False)
        if finer is None:
            break
        at = judged(case, finer, history)
    at = best or at
    if at.certificate is None:
        return None
    return Refined(
        motion=at.found.motion, solution=at.found.solution, certificate=at.certificate, settled=settled, moved=moved
    )


def _settled(at: Judged, tolerance: float | None, change: float) -> bool:
    """Return whether neither the integration error nor the objective's change from mesh to mesh asks for a finer one."""
    assert at.findings is not None  # it passed
    return at.findings.exact and (tolerance is None or change <= tolerance * abs(at.found.solution.objective))


def _marked(case: Case[MotionT, CertificateT], at: Judged[MotionT, CertificateT], change: float) -> np.ndarray:
    """Return the intervals (n,) to halve: those that the certificate asks for, then rough ones, then inexact ones."""
    needed = marked_for(at, 1.0)
    if needed.any():
        return needed
    solution, tolerance = at.found.solution, case.aims.objective_tolerance
    if tolerance is not None and change <= tolerance * abs(solution.objective):
        return marked_for(at, case.aims.strictness)
    return uneven_of(at) | standing_off(solution.transcribed, solution.x)


def _finer(
    case: Case[MotionT, CertificateT], coarse: Found[MotionT], marked: np.ndarray, what: str, history: list[Step], say: Say,
    *, position_rows: bool,
) -> Found[MotionT] | None:  # fmt: skip
    """Return what is found with the marked intervals (n,) halved, from next to the coarser mesh's answer if that will do."""
    mesh, start = halved(coarse.mesh, marked), case.start_from(coarse.motion)
    durations = np.bincount(mesh.segment, weights=widths_of(coarse.motion, marked))

    def tried(word: str, *, close: bool) -> Found[MotionT] | None:
        return attempt(case, start, mesh, durations, what + word, history, say, close=close, position_rows=position_rows)

    return tried(", warm start", close=True) or tried("", close=False)
