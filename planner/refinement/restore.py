"""The last action of a refinement: the motion on a finer mesh that is nearest to one whose objective is good enough."""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.errors import AssemblyError
from linkplan.planner.refinement.case import Iterate
from linkplan.planner.refinement.certified_iterate import certify_iterate
from linkplan.planner.refinement.history import progress, record, step_of
from linkplan.planner.refinement.marking import widths_of
from linkplan.planner.refinement.state import RefinementState
from linkplan.planner.solvers.restoration import nearest_feasible
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import halved


@dataclass(frozen=True, eq=False, slots=True)
class Restore:
    """Halve the marked intervals (n,) of the best motion, and change it as little as the finer mesh asks for."""

    marked: np.ndarray

    def apply(self, state: RefinementState) -> RefinementState:
        """Return the state with the motion as its best one, if it passes and needs less beyond its effort limits."""
        best, what = state.best, "the same motion on a finer mesh"
        coarse, counted = best.found, replace(state, restored=state.restored + 1, ended=True)
        if state.asked.problem.solver.deadline.passed:
            return counted
        case = state.case.with_scheme(coarse.solution.transcribed.scheme.name)
        mesh = halved(coarse.mesh, self.marked)
        durations = np.bincount(mesh.segment, weights=widths_of(coarse.motion, self.marked))
        progress(f"{what}: {mesh.n_intervals} intervals")
        before = coarse.solution.transcribed
        try:
            transcribed = case.transcribe(
                case.start_from(coarse.motion),
                mesh,
                durations,
                position_rows=state.position_rows,
                bang_efforts=before.bang_efforts,
                constrained_paths=before.constrained_paths,
            )
        except (AssemblyError, OutOfTimeError):
            return counted
        solution = nearest_feasible(transcribed, _with_efforts(transcribed, coarse))
        record(step_of(what, transcribed, solution))
        motion = case.motion(solution) if solution.converged else None
        if motion is None:
            return counted
        at = certify_iterate(state.asked, Iterate(motion=motion, solution=solution, fixed=coarse.fixed))
        better = at.passed and at.certificate.effort_overrun.max() < best.certificate.effort_overrun.max()
        return replace(counted, at=at, best=at, ended=False) if better else counted


def _with_efforts(transcribed: Transcribed, coarse: Iterate) -> np.ndarray:
    """Return the program's start with the efforts (n_intervals, n_coefficients, n_u) of a motion, up to their limits."""
    x, layout, scheme = np.array(transcribed.start), transcribed.program.layout, transcribed.scheme
    breaks = transcribed.program.mesh.breaks(x[layout.durations()] * transcribed.units.time_s)
    nodes = np.clip(scheme.nodes, 1e-9, 1.0 - 1e-9)
    effort = coarse.motion.effort_at((breaks[:-1, None] + np.diff(breaks)[:, None] * nodes).ravel())
    effort = effort.reshape(layout.n_intervals, len(nodes), -1)
    x[layout.effort()] = np.einsum("ij,kju->kiu", np.linalg.pinv(scheme.effort_at), effort) / transcribed.units.effort
    return x
