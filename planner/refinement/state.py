"""The state of a refinement: what was found so far, and what the decision on the next action needs of it."""

from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from linkplan.planner.refinement.case import Case, CertificateT, MotionT, RefinementTarget
from linkplan.planner.refinement.certified_iterate import CertifiedIterate, error_of
from linkplan.planner.refinement.constrained_arcs import standing_off
from linkplan.planner.refinement.pontryagin import limits_bind
from linkplan.planner.refinement.refined import Refined, better_of
from linkplan.planner.refinement.switch_search import at_bounds
from linkplan.planner.solvers.outcome import SUCCEEDED

# The objective must keep still on this many meshes in a row; on one mesh it can do so by chance.
MESHES_WITHOUT_CHANGE = 2
# An error that a finer mesh leaves at more than this share does not fall: each mesh has another motion.
FALLING_ERROR = 0.5
# The relative change of the objective that counts as none where an enclosure by coefficients keeps the motion off its limit.
CHANGE_AT_TOUCHED_LIMIT = 1e-7


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class RefinementState(Generic[MotionT, CertificateT]):
    """The iterates of a refinement and the record of its actions.

    `asked` has the limits as they are asked: every certificate is against them. `case` has the scheme and the tightened
    limits by now. `at` is the last iterate, `best` the best that passed. `warm` says that finer meshes are solved from
    next to the coarser one's answer. `position_rows` says that ranges are imposed at every instant, `rows_lost` that
    this led to no solution, `degree_lost` that a higher degree led to none. `rounds` counts actions, `readings` those
    that read switches, `read_in` is the round of the last reading. `before` is the objective of the iterate that passed
    before, `change` its relative change since, `change_before` the one before that, `calm` the number of meshes without
    change. `falls` says that the last finer mesh erred by less than the one before. `releases` counts releases of arcs.
    `loose` is the last iterate with the limits as asked after one had passed within tightened limits, `tightenings`
    counts those since then, `idle` the loosenings since the best one improved. `ended` says that the last action led
    nowhere. `restored` counts meshes on which the best motion was kept, see `Restore`.
    """

    asked: Case[MotionT, CertificateT]
    case: Case[MotionT, CertificateT]
    at: CertifiedIterate[MotionT, CertificateT]
    warm: bool
    best: CertifiedIterate[MotionT, CertificateT] | None = None
    position_rows: bool = False
    rows_lost: bool = False
    degree_lost: bool = False
    rounds: int = 0
    read_in: int = 0
    readings: int = 0
    before: float = np.inf
    change: float = np.inf
    change_before: float = np.inf
    calm: int = 0
    falls: bool = True
    releases: int = 0
    loose: CertifiedIterate[MotionT, CertificateT] | None = None
    tightenings: int = 0
    idle: int = 0
    ended: bool = False
    restored: int = 0

    @property
    def target(self) -> RefinementTarget:
        """The known form of the best motion."""
        return self.asked.target

    @property
    def objective_tolerance(self) -> float | None:
        """The largest relative change of the objective; None if the integration error alone counts."""
        smooth = self.target.kinks_at_limits and not self.target.enclosed and not limits_bind(self.at.found.solution)
        return None if smooth else self.target.objective_tolerance

    @property
    def settled(self) -> bool:
        """True if the objective keeps still from mesh to mesh, or need not."""
        return self.objective_tolerance is None or self.calm >= self.meshes_to_settle

    @property
    def meshes_to_settle(self) -> int:
        """The number of meshes in a row on which the objective must keep still."""
        return MESHES_WITHOUT_CHANGE if self.at.found.fixed is None and not self.target.enclosed else 1

    @property
    def finished(self) -> bool:
        """True if the iterate passes, is exact, and its objective has settled."""
        if not (self.at.passed and self.at.report is not None and self.at.report.exact and self.settled):
            return False
        return self.change <= CHANGE_AT_TOUCHED_LIMIT or not self.kept_off.any()

    @property
    def kept_off(self) -> np.ndarray:
        """The intervals (n,) on which a limit on coefficients keeps a motion of bang arcs away from itself."""
        solution = self.at.found.solution
        if not (self.target.bang_bang or self.target.enclosed):
            return np.zeros(self.at.n_intervals, dtype=bool)
        return standing_off(solution.transcribed, solution.x)

    @property
    def arcs_known(self) -> bool:
        """True if everything is held along arcs and no switch time is at a bound."""
        fixed = self.at.found.fixed
        return fixed is not None and fixed.everything and not at_bounds(self.at.found.solution)

    @property
    def result(self) -> Refined[MotionT, CertificateT] | None:
        """The best motion, or the last one if none passed; None without a certificate."""
        at, best = self.at, self.best
        asked = self.objective_tolerance is not None and self.target.objective_tolerance_given
        if not (at.passed and self.settled and asked and self.loose is None):
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
        """The relative error of the objective by its largest change on the meshes on which it must keep still."""
        changes = (self.change, self.change_before)[: self.meshes_to_settle]
        return (
            max([self.moved, *(change for change in changes if np.isfinite(change))]) if np.isfinite(changes[0]) else np.inf
        )

    @property
    def moved(self) -> float:
        """The relative change of the objective from the last mesh to this one, or what tightening costs; 0 if unknown."""
        if self.loose is not None and self.best is not None:
            best, loose = self.best.found.solution.objective, self.loose.found.solution.objective
            return max(best - loose, 0.0) / max(abs(best), np.finfo(float).tiny)
        return self.change if np.isfinite(self.change) else 0.0


def observed(
    state: RefinementState[MotionT, CertificateT], at: CertifiedIterate[MotionT, CertificateT], *, tells: bool = True
) -> RefinementState[MotionT, CertificateT]:
    """Return the state after a new iterate; `tells` says that its mesh is finer wherever the objective depends on it."""
    first = state.rounds <= 1  # the error on the first mesh is too coarse to compare with
    new = replace(state, at=at, falls=first or error_of(at) <= FALLING_ERROR * error_of(state.at))
    if not at.passed:
        return new
    solution = at.found.solution
    objective, size = solution.objective, abs(solution.objective)
    change = abs(objective - state.before)
    tolerance = new.objective_tolerance
    calm = state.calm
    if solution.status == SUCCEEDED:  # a solver that stopped short says nothing of the objective
        calm = calm + 1 if tells and (tolerance is None or change <= tolerance * size) else 0
    if state.loose is not None:  # on meshes that err alike the objectives can be compared
        better = state.best is None or objective < state.best.found.solution.objective
        return replace(new, best=at, idle=0) if better else new
    return replace(
        new,
        best=better_of(state.best, at, state.target),
        calm=calm,
        change=change / size if size and np.isfinite(change) else state.change,
        change_before=state.change,
        before=objective if solution.status == SUCCEEDED or tolerance is None else state.before,
    )
