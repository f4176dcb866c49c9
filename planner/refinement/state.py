"""The state of a refinement: the iterates so far, the better of two iterates, and the result."""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.planner.certificate.certificate import Certificate
from linkplan.planner.refinement.case import (
    Case,
    CertifiedIterate,
    Iterate,
    RefinementTarget,
    error_of,
)
from linkplan.planner.refinement.constrained_arcs import arcs_against_their_limits, limits_bind, off_limit_intervals
from linkplan.planner.refinement.switches import at_bounds
from linkplan.planner.solvers.solve import SOLVER_TOLERANCE, SUCCEEDED

# The motion of a coarser mesh is kept if it is better than that of a finer one by more than this share, which is above the
# error of the mesh. The second share holds if the coarser motion is less exact.
LOST_GAIN, LOST_GAIN_INEXACT = 1e-5, 1e-4
# Relative changes of the objective below this are ignored if an enclosure by coefficients keeps the motion off its limit.
CHANGE_AT_TOUCHED_LIMIT = 1e-7
# If the objective changes on a finer mesh by more than this share, the change is reported. If it changes by less, the mesh
# is fine enough for the smoothing of efforts, and is not halved again for it.
REPORTED_CHANGE = 1e-4
# A plan whose objective changes by more than this share on a finer mesh is "feasible" and not "optimal".
OPTIMAL_CHANGE = 5e-2


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Refined(Iterate):
    """An iterate with its certificate, which may not pass.

    `settled` is True if the objective no longer changes from mesh to mesh, where that is required. `moved` is the
    objective's relative change between the last two meshes on which the motion passed, 0 if there is only one mesh.
    `objective_error` is the objective's relative error estimated from these meshes, infinite if there is only one.
    """

    certificate: Certificate
    settled: bool
    moved: float = 0.0
    objective_error: float = np.inf

    @property
    def arcs_with_wrong_sign(self) -> np.ndarray:
        """The instants (n,) [s] at which the optimum would leave a fixed limit; a local optimum has none."""
        return arcs_against_their_limits(self.solution)


def better_of(
    before: CertifiedIterate | None, now: CertifiedIterate, target: RefinementTarget, *, lost: float = LOST_GAIN
) -> CertifiedIterate:
    """Return the better of two motions that pass: the later one, on a finer mesh, unless it is worse by a share `lost`."""
    if before is None or (target.tolerance_given and now.report.exact and not before.report.exact):
        return now
    then, objective = before.found.solution.objective, now.found.solution.objective
    truer = not before.report.exact and (now.report.exact or error_of(now) < error_of(before))
    share = max(lost, LOST_GAIN_INEXACT) if truer else lost
    return before if then < objective - share * abs(objective) else now


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class RefinementState:
    """The iterates of a refinement and the record of its actions.

    `asked` has the problem's own limits, to which every certificate refers. `case` has the current scheme and tightened
    limits. `iterate` is the last one, `best` the best that passed. `warm` says that finer meshes start close to the coarser
    solution. `position_rows` says that ranges are imposed at every instant, `rows_lost` that this led to no solution,
    `degree_lost` that a higher degree led to none. `rounds` counts actions, `readings` those that read switches, `read_in`
    is the round of the last reading. `before` is the objective of the iterate that passed before, `change` its relative
    change since, `change_before` the one before that, `settled_meshes` the number of meshes without change. `error_falls`
    says that the last finer mesh erred by less than the one before. `releases` counts releases of arcs. `loosened` is the
    last iterate with the limits as asked after one had passed within tightened limits, `tightenings` counts those since
    then, `loosenings_without_gain` the loosenings since the best one improved. `ended` says that the last action led
    nowhere. `restored` counts meshes on which the best motion was kept, see `ReduceEffortOverrun`.
    """

    asked: Case
    case: Case
    iterate: CertifiedIterate
    warm: bool
    best: CertifiedIterate | None = None
    position_rows: bool = False
    rows_lost: bool = False
    degree_lost: bool = False
    rounds: int = 0
    read_in: int = 0
    readings: int = 0
    before: float = np.inf
    change: float = np.inf
    change_before: float = np.inf
    settled_meshes: int = 0
    error_falls: bool = True
    releases: int = 0
    loosened: CertifiedIterate | None = None
    tightenings: int = 0
    loosenings_without_gain: int = 0
    ended: bool = False
    restored: int = 0

    @property
    def target(self) -> RefinementTarget:
        """The known form of the best motion."""
        return self.asked.target

    @property
    def objective_tolerance(self) -> float | None:
        """The largest relative change of the objective; None if only the integration error matters."""
        smooth = self.target.kinks_at_limits and not self.target.enclosed and not limits_bind(self.iterate.found.solution)
        return None if smooth else self.target.objective_tolerance

    @property
    def settled(self) -> bool:
        """True if the objective no longer changes from mesh to mesh.

        Without a tolerance on it, changes below `REPORTED_CHANGE` count as none. In least time changes are ignored: the
        switches are read first, because they improve the motion more than a finer mesh.
        """
        if self.objective_tolerance is None:
            # The error of efforts of a given shape shows only on a second mesh.
            seen = self.asked.problem.mesh.effort == "polynomial" or np.isfinite(self.change)
            return self.target.bang_bang or (seen and self.moved <= REPORTED_CHANGE)
        return self.settled_meshes >= self.meshes_to_settle

    @property
    def meshes_to_settle(self) -> int:
        """The number of meshes in a row on which the objective must not change, because on one it may do so by chance."""
        return 2 if self.iterate.found.fixed is None and not self.target.enclosed else 1

    @property
    def finished(self) -> bool:
        """True if the iterate passes, is exact, and its objective has settled."""
        if not (self.iterate.passed and self.iterate.report is not None and self.iterate.report.exact and self.settled):
            return False
        return self.change <= CHANGE_AT_TOUCHED_LIMIT or not self.off_limit_intervals.any()

    @property
    def off_limit_intervals(self) -> np.ndarray:
        """The intervals (n,) on which a limit on coefficients keeps a motion of bang arcs away from the limit."""
        solution = self.iterate.found.solution
        if not (self.target.bang_bang or self.target.enclosed):
            return np.zeros(self.iterate.n_intervals, dtype=bool)
        return off_limit_intervals(solution.transcribed, solution.x)

    @property
    def arcs_known(self) -> bool:
        """True if everything is fixed along arcs and no switch time is at a bound."""
        fixed = self.iterate.found.fixed
        return fixed is not None and fixed.everything and not at_bounds(self.iterate.found.solution)

    @property
    def result(self) -> Refined | None:
        """The best motion, or the last one if none passed; None without a certificate."""
        at, best = self.iterate, self.best
        asked = self.objective_tolerance is not None
        if not (at.passed and self.settled and asked and self.loosened is None):
            at = best or at
        if at.certificate is None:
            return None
        return Refined(
            motion=at.found.motion,
            solution=at.found.solution,
            certificate=at.certificate,
            settled=self.settled,
            moved=self.moved,
            objective_error=self.objective_error,
        )

    @property
    def objective_error(self) -> float:
        """The relative error of the objective, from its largest change on the meshes on which it must not change."""
        changes = (self.change, self.change_before)[: self.meshes_to_settle]
        return (
            max([self.moved, *(change for change in changes if np.isfinite(change))]) if np.isfinite(changes[0]) else np.inf
        )

    @property
    def moved(self) -> float:
        """The relative change of the objective from the last mesh to this one, or what tightening costs; 0 if unknown."""
        if self.loosened is not None and self.best is not None:
            best, loose = self.best.found.solution.objective, self.loosened.found.solution.objective
            return max(best - loose, 0.0) / max(abs(best), np.finfo(float).tiny)
        return self.change if np.isfinite(self.change) else 0.0


def observed(state: RefinementState, at: CertifiedIterate, *, tells: bool = True) -> RefinementState:
    """Return the state after a new iterate; `tells` is True if its mesh is finer wherever the objective depends on it."""
    first = state.rounds <= 1  # the error on the first mesh is too inexact for a comparison
    # An error that a finer mesh does not halve does not count as falling: each mesh has another motion.
    new = replace(state, iterate=at, error_falls=first or error_of(at) <= 0.5 * error_of(state.iterate))
    if not at.passed:
        return new
    solution = at.found.solution
    # A negligible objective changes from mesh to mesh by the solver's tolerance on each interval.
    rounding = SOLVER_TOLERANCE * at.n_intervals * solution.transcribed.objective_scale
    objective, size = solution.objective, max(abs(solution.objective), rounding / REPORTED_CHANGE)
    change = abs(objective - state.before)
    tolerance, solved = new.objective_tolerance, solution.status == SUCCEEDED
    settled_meshes = state.settled_meshes
    if solved:
        settled_meshes = settled_meshes + 1 if tells and (tolerance is None or change <= tolerance * size) else 0
    if state.loosened is not None:  # objectives can be compared on meshes with similar errors
        better = state.best is None or objective < state.best.found.solution.objective
        return replace(new, best=at, loosenings_without_gain=0) if better else new
    # Efforts of a given shape depend on the mesh, and the quadrature of positive power errs where a speed changes its sign.
    shaped = state.asked.problem.mesh.effort != "polynomial"
    best = better_of(state.best, at, state.target, lost=OPTIMAL_CHANGE if shaped else LOST_GAIN)
    new = replace(new, best=best, settled_meshes=settled_meshes)
    if not solved and tolerance is not None:  # a solver that stopped early gives no information on the objective
        return new
    alike = shaped and at.n_intervals == state.iterate.n_intervals  # a higher degree does not refine these efforts
    change = change / size if np.isfinite(change) and not alike else state.change
    return replace(new, change=change, change_before=state.change, before=objective)
