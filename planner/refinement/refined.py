"""The result of a refinement, and the better of two iterates."""

from dataclasses import dataclass
from typing import Generic

import numpy as np

from linkplan.planner.refinement.case import CertificateT, MotionT, RefinementTarget
from linkplan.planner.refinement.certified_iterate import CertifiedIterateT, error_of
from linkplan.planner.refinement.pontryagin import arcs_against_their_limits
from linkplan.planner.solvers.outcome import SOLVER_TOLERANCE
from linkplan.planner.solvers.solve import Solution

# The motion of a coarser mesh is kept if it is better than that of a finer one by more than this share, which is above the
# error of the mesh. The second share holds if the coarser motion is less exact.
LOST_GAIN, LOST_GAIN_INEXACT = 1e-5, 1e-4


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Refined(Generic[MotionT, CertificateT]):
    """A motion with its solution and certificate, which may not pass.

    `settled` is True if the objective keeps still from mesh to mesh, where that is required. `moved` is its relative change
    between the last two meshes on which the motion passed, 0 if there is only one. `objective_error` is the objective's
    relative error as those meshes show it, infinite if there is only one.
    """

    motion: MotionT
    solution: Solution
    certificate: CertificateT
    settled: bool
    moved: float = 0.0
    objective_error: float = np.inf

    @property
    def against(self) -> np.ndarray:
        """The instants (n,) [s] at which the optimum would leave a held limit; a local optimum has none."""
        return arcs_against_their_limits(self.solution)


def better_of(before: CertifiedIterateT | None, now: CertifiedIterateT, target: RefinementTarget) -> CertifiedIterateT:
    """Return the better of two motions that pass: the later, on a finer mesh, unless that lost what the other had.

    The solver leaves its tolerance at every limit that binds, which are more on a finer mesh. An objective that nobody asked
    to settle is not given up for that on a mesh that is no more exact.
    """
    if before is None or (target.tolerance_given and now.report.exact and not before.report.exact):
        return now
    then, objective = before.found.solution.objective, now.found.solution.objective
    left = SOLVER_TOLERANCE * now.n_intervals * abs(objective)
    no_more_exact = before.report.exact and error_of(before) <= error_of(now)
    if not target.objective_tolerance_given and no_more_exact and 0 <= objective - then <= left:
        return before
    truer = not before.report.exact and (now.report.exact or error_of(now) < error_of(before))
    share = LOST_GAIN_INEXACT if truer else LOST_GAIN
    return before if then < objective - share * abs(objective) else now
