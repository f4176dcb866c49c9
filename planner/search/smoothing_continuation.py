"""Continuation in the smoothing of efforts: a tracking motion first with it, then with a thousandth of it, on finer meshes.

The motion nearest in position alone chatters at the ends of its bang arcs (Fuller's phenomenon), and solvers lose it. With a
small weight on the squared effort rate it is found, a little further from the reference; from there the weight is taken out.
"""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.closed_chain.case import MechanismCase
from linkplan.planner.closed_chain.formulate import SMOOTHING_WEIGHT
from linkplan.planner.closed_chain.transcribe import own_objective
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.refine import refine
from linkplan.planner.refinement.refined import Refined
from linkplan.planner.search.continuation import Steps, followed
from linkplan.planner.transcription.mesh import halved

# The share of the smoothing that is left in the end, by which factor it falls at a time, and the least such factor.
_LEFT, _FACTOR, _LEAST, _STEPS = 1e-3, 0.1, 0.3, 8
# The weight is small enough where taking it away gains less than this share of the objective; meshes are fine enough where
# a finer one gains less than that, or at so many intervals.
_GAINED, _SETTLED, _FINEST = 1e-5, 1e-4, 160
# A reference that is followed to this share of the unit of the objective, an rms of 1e-5 of the motion's span, is followed.
_FOLLOWED = 1e-10


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Smoothed:
    """A motion refined with a weight on the effort rate, and its objective without that."""

    case: MechanismCase
    refined: Refined
    objective: float


def unsmoothed(case: MechanismCase, refined: Refined) -> tuple[Refined, float]:
    """Return a tracking motion whose smoothing was taken out, and by what share a finer mesh changed its objective.

    Where no smoothing is in the objective, or the motion does not pass, it is returned as it is, with no change.
    """
    problem: PlanningProblem = case.problem
    if not (problem.objective.is_smoothed and problem.objective.has("tracking") and refined.certificate.passed):
        return refined, 0.0
    unit = refined.solution.transcribed.units.objective

    def solved(at: _Smoothed, smoothing: float, *, finer: bool = False) -> _Smoothed | None:
        mesh, motion = at.refined.solution.transcribed.program.mesh, at.refined.motion
        scheme = at.refined.solution.transcribed.scheme.name
        durations = np.bincount(mesh.segment, np.diff(motion.breaks_s))
        if finer:
            mesh = halved(mesh, np.ones(mesh.n_intervals, dtype=bool))
        now = replace(at.case.with_scheme(scheme), smoothing=smoothing)
        what = f"smoothing of efforts {smoothing / SMOOTHING_WEIGHT:.3g} of the first" + (", finer mesh" if finer else "")
        found = attempt(now, now.start_from(motion), mesh, durations, what, warm=True)
        better = None if found is None else refine(now, found, warm=True)
        if better is None or not better.certificate.passed:
            return None
        objective = own_objective(better.solution.transcribed, better.solution.objective, better.motion)
        return _Smoothed(case=now, refined=better, objective=objective) if objective <= at.objective else None

    def settled(before: _Smoothed, after: _Smoothed, whole: bool) -> bool:
        del whole
        return before.objective - after.objective <= _GAINED * after.objective

    first = own_objective(refined.solution.transcribed, refined.solution.objective, refined.motion)
    begin = _Smoothed(case=case, refined=refined, objective=first)
    if first <= _FOLLOWED * unit:
        return refined, 0.0
    steps = Steps(begin=case.smoothing, end=_LEFT * SMOOTHING_WEIGHT, factor=_FACTOR, least=_LEAST, most=_STEPS)
    at, change = followed(begin, steps, solved, enough=settled).stages[-1], 0.0
    while 2 * at.refined.solution.transcribed.program.mesh.n_intervals <= _FINEST and at.objective > _FOLLOWED * unit:
        finer = solved(at, at.case.smoothing, finer=True)
        if finer is None:
            break
        change, at = (at.objective - finer.objective) / finer.objective, finer
        if change <= _SETTLED:
            break
    return at.refined, change
