"""Limits that were tightened on coarse meshes, given back on finer ones.

A row at nodes is overrun between them by what the mesh errs by, and tightened by that it costs as much of the objective.
Where that shows, intervals on which the limit as asked is overrun are halved, and the limit is tightened by what is left.
"""

from dataclasses import replace

import numpy as np

from linkplan.models.interrupts import check
from linkplan.planner.refinement.case import Case, CertificateT, MotionT, attempt
from linkplan.planner.refinement.constrained_arcs import FixedArcs
from linkplan.planner.refinement.history import Say, Step
from linkplan.planner.refinement.judged import Judged, judged
from linkplan.planner.refinement.refine import Refined
from linkplan.planner.refinement.released_arcs import arcs_let_go
from linkplan.planner.transcription.mesh import halved

# What tightening may cost, of the objective; so often intervals are halved, on meshes of so many of them at the most.
_COST, _ROUNDS, _FINEST = 1e-6, 12, 240
# Rounds in a row that give nothing back end it: what meshes err by is more.
_IDLE = 2
# Limits are tightened so often on each mesh: by what the first of them leaves as well.
_TWICE = 2
# Intervals on which a limit is overrun by this share of the most are halved.
_SHARE = 0.1


def let_go(
    case: Case[MotionT, CertificateT], refined: Refined[MotionT, CertificateT], history: list[Step], say: Say
) -> Refined[MotionT, CertificateT]:
    """Return a motion that passes with its wrongly held arcs let go and what tightening cost it given back."""
    return given_back(case, arcs_let_go(case, refined, history, say), history, say)


def given_back(
    case: Case[MotionT, CertificateT], refined: Refined[MotionT, CertificateT], history: list[Step], say: Say
) -> Refined[MotionT, CertificateT]:
    """Return a motion that passes, with what tightening cost it given back; the same one where that is nothing.

    Args:
        case: with all limits as they are asked.
        refined: the motion, maybe within tightened limits.
        history: takes a note of every solve.
        say: called with a line of progress.
    """
    if not refined.certificate.passed or refined.solution.transcribed.formulation.tightening is None or case.aims.bang_bang:
        return refined
    asked = case.with_scheme(refined.solution.transcribed.scheme.name)
    mesh, best, motion = refined.solution.transcribed.program.mesh, refined, refined.motion
    durations = np.bincount(mesh.segment, np.diff(motion.breaks_s))

    def solved(now: Case[MotionT, CertificateT], what: str) -> Judged[MotionT, CertificateT] | None:
        transcribed = refined.solution.transcribed
        fixed = None
        if transcribed.bang_efforts is not None and transcribed.constrained_paths is not None:
            fixed = FixedArcs(efforts=transcribed.bang_efforts, paths=transcribed.constrained_paths)
        found = attempt(now, now.start_from(motion), mesh, durations, what, history, say, warm=True, fixed=fixed)
        at = None if found is None else judged(now, found, history)
        return None if at is None or at.certificate is None or (not at.certificate.mendable and not at.passed) else at

    idle = 0  # rounds that gave nothing back
    for _ in range(_ROUNDS):
        check()
        loose = at = solved(asked, "limits as asked")
        if loose is None or best.solution.objective - loose.found.solution.objective <= _COST * abs(best.solution.objective):
            break
        motion, tightened = loose.found.motion, asked
        durations = np.bincount(mesh.segment, np.diff(motion.breaks_s))
        for _ in range(_TWICE):
            if at is None or at.passed or at.certificate is None:
                break
            tightened = tightened.tightened(at.certificate, at.found.motion)
            at = solved(tightened, "limits tightened by what is left")
        idle += 1
        if at is not None and at.passed and at.found.solution.objective < best.solution.objective:
            cost = (at.found.solution.objective - loose.found.solution.objective) / abs(best.solution.objective)
            better = replace(
                refined, motion=at.found.motion, solution=at.found.solution, certificate=at.certificate, moved=max(cost, 0.0)
            )
            if len(better.against) <= len(refined.against):
                best, idle = better, 0
        overrun = np.zeros(mesh.n_intervals) if loose.findings is None else loose.findings.overrun
        over = overrun > _SHARE * overrun.max()
        if loose.passed or idle == _IDLE or not over.any() or mesh.n_intervals + int(over.sum()) > _FINEST:
            break
        mesh = halved(mesh, over)
    return best
