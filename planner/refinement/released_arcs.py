"""Held arcs that the optimum would rather leave, let go from where their multipliers change sign.

Two efforts that leave their limits within half an interval of each other are read as leaving them at once. Held so, one of
them is at its limit for too long, and Pontryagin's principle says from when on (Betts 2010, section 4.4).
"""

import numpy as np

from linkplan.planner.refinement.case import Case, CertificateT, MotionT, attempt
from linkplan.planner.refinement.constrained_arcs import FixedArcs
from linkplan.planner.refinement.history import Say, Step
from linkplan.planner.refinement.pontryagin import held_wrongly, interval_breaks
from linkplan.planner.refinement.refine import refine
from linkplan.planner.refinement.refined import Refined
from linkplan.planner.refinement.switch_search import mesh_with_switches
from linkplan.planner.solvers.solve import Solution

# So often arcs are let go one after another, each answer no worse than the one before by more than this share, what
# meshes err by.
_TRIES, _NO_WORSE = 3, 1e-5


def arcs_let_go(
    case: Case[MotionT, CertificateT], refined: Refined[MotionT, CertificateT], history: list[Step], say: Say
) -> Refined[MotionT, CertificateT]:
    """Return a motion that passes with its wrongly held arcs let go, the same one where that makes it no better."""
    for _ in range(_TRIES):
        let_go = released(refined.solution) if refined.certificate.passed else None
        if let_go is None:
            break
        ends, fixed = let_go
        finest = case.with_scheme(refined.solution.transcribed.scheme.name)
        boundaries = interval_breaks(refined.solution)[refined.solution.transcribed.program.mesh.boundaries()]
        switch_times = ends[1:-1][~np.isin(ends[1:-1], boundaries)]
        mesh, durations = mesh_with_switches(boundaries, switch_times, case.problem.mesh.intervals)
        found = attempt(
            finest, finest.start_from(refined.motion), mesh, durations, "arcs against their limits let go", history, say,
            warm=True, fixed=fixed,
        )  # fmt: skip
        better = None if found is None else refine(finest, found, history, say, warm=True)
        allowed = refined.solution.objective + _NO_WORSE * abs(refined.solution.objective)
        if better is None or not better.certificate.passed or better.solution.objective > allowed:
            break
        refined = better
    return refined


def released(solution: Solution) -> tuple[np.ndarray, FixedArcs] | None:
    """Return the ends (n_segments + 1,) [s] of segments and what is held on them; None where nothing is held wrongly."""
    transcribed, mesh = solution.transcribed, solution.transcribed.program.mesh
    wrong = np.hstack(held_wrongly(solution))
    if not wrong.any():
        return None
    first = np.concatenate([[True], (np.diff(mesh.segment) != 0) | np.any(wrong[1:] != wrong[:-1], axis=1)])
    n_u, n_path = transcribed.program.layout.n_u, transcribed.program.interval.n_path
    efforts, paths = transcribed.bang_efforts, transcribed.constrained_paths
    efforts = np.full((mesh.n_segments, n_u), np.nan) if efforts is None else efforts
    paths = np.zeros((mesh.n_segments, n_path), dtype=int) if paths is None else paths
    held = np.hstack([efforts, np.where(paths == 0, np.nan, paths)])[mesh.segment][first]
    held[wrong[first]] = np.nan
    fixed = FixedArcs(efforts=held[:, :n_u], paths=np.nan_to_num(held[:, n_u:]).astype(int))
    return interval_breaks(solution)[np.append(first, True)], fixed
