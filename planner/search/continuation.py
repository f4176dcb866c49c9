"""A motion of least time lengthened step by step to one that another objective prefers.

Left to themselves, solvers lose long motions under weak actuators: a swing amplifies what a coarse mesh leaves over, and a
motion that flies through where the mesh does not look is cheaper than any that exists. A motion of least time is found
reliably and keeps the dynamics; allowed a little more time, the best motion is next to it, and so on from one to the next
(continuation in the duration: Allgower & Georg, Introduction to Numerical Continuation Methods, SIAM 2003).
"""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import Guess, motion_of
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.history import Say, Step
from linkplan.planner.refinement.refine import refine
from linkplan.planner.search.clearance import nears_singular
from linkplan.planner.search.first_mesh import graded_mesh
from linkplan.planner.search.phase_plane import stretched
from linkplan.planner.transcription.mesh import Mesh, uniform

# By how much a motion is lengthened at a time, and the least that is tried where that is too much.
LENGTHENING, _LEAST = 1.15, 1.03
# A step that was lost is tried again on twice as many intervals, up to so many.
_FINEST = 320
# Steps at the most: a hundredfold duration.
_STEPS = 40
# Accuracy of the motions on the way [deg].
_ON_THE_WAY_DEG = 0.01
# A free duration is long enough once lengthening it so saves less than this share of the objective.
SAVED = 1e-3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Lengthened:
    """A motion on the way or at the end: a start, its mesh and transcription, and the longest duration it was allowed [s].

    `enough` says that the last step saved less than `SAVED` of the objective.
    """

    start: Guess
    mesh: Mesh
    scheme: str
    longest_s: float
    enough: bool


def lengthened(
    problem: PlanningProblem, quickest: Guess, n_intervals: int, history: list[Step], say: Say
) -> Lengthened | None:
    """Return the motion that a problem's objective prefers, reached from one of least time; None where it is lost.

    Args:
        problem: of a fixed duration, or of a free one.
        quickest: a motion that keeps the dynamics in less time.
        n_intervals: of the first mesh.
        history: where steps are noted.
        say: called with a line of progress now and then.
    """
    fixed = problem.motion.duration_s is not None
    last = problem.motion.duration_s or problem.motion.max_duration_s or np.inf
    at = Lengthened(
        start=quickest,
        mesh=uniform(n_intervals),
        scheme=problem.mesh.scheme,
        longest_s=quickest.duration_s,
        enough=False,
    )
    ratio, before = LENGTHENING, np.inf
    for _ in range(_STEPS):
        if at.longest_s >= last * (1 - 1e-12):
            return at
        longest = min(at.longest_s * ratio, last)
        found = _step(problem, at, longest, fixed, history, say)
        if found is None:
            if nears_singular(problem, at.start):
                return None  # it goes on there, where no mesh is fine enough
            ratio = float(np.sqrt(ratio))
            if ratio < _LEAST:
                return None
            mesh, _ = graded_mesh(at.start, np.empty(0), min(2 * at.mesh.n_intervals, _FINEST))
            at = replace(at, mesh=mesh)
            continue
        at, objective = found
        if not fixed and longest >= (problem.motion.min_duration_s or 0.0):
            if at.start.duration_s < 0.999 * longest:
                return at
            if ratio == LENGTHENING and before - objective < SAVED * abs(objective):
                return replace(at, enough=True)
        before = objective
    return None


def _step(
    problem: PlanningProblem, at: Lengthened, longest: float, fixed: bool, history: list[Step], say: Say
) -> tuple[Lengthened, float] | None:
    """Return the best motion within a duration from one of a shorter, and its objective."""
    least = problem.motion.min_duration_s
    motion = replace(problem.motion, min_duration_s=least if least is not None and least <= longest else None)
    motion = replace(motion, duration_s=longest) if fixed else replace(motion, max_duration_s=longest)
    mesh = replace(problem.mesh, tolerance_deg=_ON_THE_WAY_DEG, scheme=at.scheme, breaks=None)
    case = case_of(replace(problem, motion=motion, mesh=mesh, guess=None))
    start = stretched(at.start, longest) if fixed else at.start
    durations = np.bincount(at.mesh.segment, weights=at.mesh.fraction) * start.duration_s
    what = f"the least-time motion lengthened to {longest:.4g} s"
    found = attempt(case, start, at.mesh, durations, what, history, say, warm=True)
    refined = None if found is None else refine(case, found, history, say, warm=True)
    if refined is None or not refined.certificate.passed:
        return None
    solution = refined.solution
    done = Lengthened(
        start=motion_of(refined.motion),
        mesh=solution.transcribed.program.mesh,
        scheme=solution.transcribed.scheme.name,
        longest_s=longest,
        enough=False,
    )
    return done, solution.objective
