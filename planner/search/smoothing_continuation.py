"""Continuation in the smoothing of efforts: a tracking motion first with it, then with a thousandth of it, on finer meshes.

The motion nearest in position alone chatters at the ends of its bang arcs (Fuller's phenomenon), and solvers lose it. A
small weight on the squared effort rate makes the problem regular, at a small tracking error. Then the weight is removed in
steps.
"""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.closed_chain.case import MechanismCase
from linkplan.planner.closed_chain.formulate import SMOOTHING_WEIGHT
from linkplan.planner.closed_chain.transcribe import own_objective
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.refine import refine
from linkplan.planner.refinement.refined import Refined
from linkplan.planner.search.continuation import Steps, followed
from linkplan.planner.transcription.mesh import halved

# The share of the smoothing at the end, the factor of each step, and the largest number of steps.
_FINAL_SHARE, _STEP_FACTOR, _MAX_STEPS = 1e-3, 0.1, 8
# The smoothing is small enough if a step gains less than the first share of the objective. The mesh is fine enough if a
# finer one gains less than the second share, or at the last number of intervals.
_MIN_GAIN_OF_STEP, _MIN_GAIN_OF_MESH, _MAX_INTERVALS = 1e-5, 1e-4, 160
# An objective below this share of its unit counts as exact tracking: an rms error of 1e-5 of the motion's range.
_EXACT_TRACKING_SHARE = 1e-10


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Smoothed:
    """A motion refined with a weight on the effort rate, and its objective without that."""

    case: MechanismCase
    refined: Refined
    objective: float


def unsmoothed(case: MechanismCase, refined: Refined) -> tuple[Refined, float]:
    """Return a tracking motion whose smoothing was taken out, and by what share a finer mesh changed its objective.

    A motion without smoothing in its objective, or one that does not pass, is returned unchanged.
    """
    problem: Problem = case.problem
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
        return before.objective - after.objective <= _MIN_GAIN_OF_STEP * after.objective

    first = own_objective(refined.solution.transcribed, refined.solution.objective, refined.motion)
    begin = _Smoothed(case=case, refined=refined, objective=first)
    if first <= _EXACT_TRACKING_SHARE * unit:
        return refined, 0.0
    steps = Steps(
        begin=case.smoothing, end=_FINAL_SHARE * SMOOTHING_WEIGHT, factor=_STEP_FACTOR, halvings=0, most=_MAX_STEPS
    )
    at, change = followed(begin, steps, solved, enough=settled).stages[-1], 0.0
    while (
        2 * at.refined.solution.transcribed.program.mesh.n_intervals <= _MAX_INTERVALS
        and at.objective > _EXACT_TRACKING_SHARE * unit
    ):
        finer = solved(at, at.case.smoothing, finer=True)
        if finer is None:
            break
        change, at = (at.objective - finer.objective) / finer.objective, finer
        if change <= _MIN_GAIN_OF_MESH:
            break
    return at.refined, change
