"""A mechanism's planning problem as a case for refinement."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.errors import AssemblyError
from linkplan.models.tree.friction import frictions_of
from linkplan.planner.certificate.certificate import INTEGRATION_M, RANGE_SLACK, Certificate, certify
from linkplan.planner.closed_chain.formulate import SMOOTHING_WEIGHT
from linkplan.planner.closed_chain.guess import Guess, motion_of
from linkplan.planner.closed_chain.transcribe import trajectory_of, transcribe
from linkplan.planner.keys.kinds import INTEGRATION_DEG
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import ErrorReport, RefinementTarget
from linkplan.planner.refinement.tightening import Tightening, evened, tightenings_of
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Mesh


@dataclass(frozen=True, eq=False, slots=True)
class MechanismCase:
    """A `planner.refinement.case.Case`: solves use `problem` with tightened limits, certificates the `asked` problem."""

    problem: Problem
    asked: Problem
    tightenings: tuple[Tightening, ...] = ()
    n_tightenings: int = 0
    kinks: bool = True  # whether to seek kinks of continuous efforts
    smoothing: float = SMOOTHING_WEIGHT  # see `formulate`
    enclosed: bool = False  # whether limits on power and pin force are imposed at every instant
    target: RefinementTarget = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "target", _target(self.asked, kinks=self.kinks, enclosed=self.enclosed))

    def transcribe(self, start: Guess, mesh: Mesh, durations: np.ndarray, **options: Any) -> Transcribed:
        """Return the program from a guess."""
        kept = {"tightenings": self.tightenings, "smoothing": self.smoothing, "enclosed": self.enclosed}
        return transcribe(self.problem, start, mesh, durations, **kept, **options)

    def motion(self, solution: Solution) -> Trajectory | None:
        """Return a solution's trajectory; None if the solver moved to another assembly branch."""
        try:
            return trajectory_of(solution.transcribed, solution.x, self.asked.limits.effort)
        except AssemblyError:
            return None

    def start_from(self, motion: Trajectory) -> Guess:
        """Return a trajectory as a guess."""
        return motion_of(motion)

    def certify(self, motion: Trajectory) -> Certificate | None:
        """Return a trajectory's certificate; None if it leaves its assembly branch or the deadline passes."""
        try:
            return certify(self.asked, motion)
        except (AssemblyError, OutOfTimeError):
            return None

    def error_report(self, certificate: Certificate) -> ErrorReport:
        """Return the certificate's findings that refinement needs."""
        over = [certificate.speed_overrun, certificate.position_overrun]
        over += [margin.overrun[None] for margin in certificate.margins if margin.of.tightened is not None]
        least = min(certificate.position_margin_rad.min(), certificate.speed_margin_rad_s.min())
        return ErrorReport(
            exact=is_exact(self.asked, certificate),
            mendable=certificate.mendable,
            leaves_positions=bool(np.any(certificate.position_margin_rad < 0)),
            overruns=bool(least < -RANGE_SLACK) or not all(margin.kept for margin in certificate.margins),
            overrun=np.vstack(over).max(axis=0),
            integration_error_deg=certificate.integration_error_deg,
        )

    def tightened(self, certificate: Certificate, motion: Trajectory) -> "MechanismCase":
        """Return the case with limits tightened by the amounts that the motion overran."""
        further = tightenings_of(certificate.margins, certificate.speed_overrun, motion.breaks_s)
        further = evened(further) if self.enclosed else further
        everywhere = self.n_tightenings >= 1  # after the first time overruns are small and move between intervals
        problem = _tightened(self.problem, certificate, speeds=everywhere)
        return replace(self, problem=problem, tightenings=self.tightenings + further, n_tightenings=self.n_tightenings + 1)

    def with_scheme(self, name: str) -> "MechanismCase":
        """Return the case with another transcription."""
        return replace(self, problem=replace(self.problem, mesh=replace(self.problem.mesh, scheme=name)))


def case_of(problem: Problem, *, kinks: bool = True, enclosed: bool = False) -> MechanismCase:
    """Return the case of a problem; with `kinks`, refinement seeks the kinks of continuous efforts.

    Limits on power of several freedoms are imposed at every instant. With one freedom the phase plane's legs keep them; with
    `enclosed`, limits on power and pin force are imposed at every instant there too.
    """
    powers = problem.mesh.effort == "polynomial" and bool(np.any(np.isfinite(problem.limits.power)))
    return MechanismCase(problem, problem, kinks=kinks, enclosed=enclosed or (powers and problem.mechanism.dof > 1))


def _target(problem: Problem, *, kinks: bool, enclosed: bool) -> RefinementTarget:
    """Return the expected structure of a problem's optimum, and the accuracy to reach.

    Efforts jump between their limits, zero and constrained arcs if time or work is minimised. Efforts are continuous with
    kinks at their limits if squared efforts are minimised. In least time they are at their limits wherever no other limit
    binds. The change of the objective is checked where limits on coefficients may cost something that the motion itself does
    not show. Switches are not sought if limits on power are imposed at every instant; jumps may then lie inside intervals.
    """
    objective = problem.objective
    continuous_efforts = objective.efforts("bend")
    bending = kinks and continuous_efforts and not objective.has("tracking")
    switches = not enclosed and (objective.efforts("jump") or bending) and not objective.efforts("smooth")
    lines = any(motor is not None and motor.line is not None for motor in problem.motors)
    bent = continuous_efforts and bool(np.any(np.isfinite(problem.limits.speed[problem.mechanism.independent])))
    tolerance = 1e-7 if switches and (lines or bent) else None
    return RefinementTarget(
        effort_limit=problem.limits.effort,
        switches=switches,
        bang_bang=list(objective.weights) == ["time"],
        continuous_efforts=continuous_efforts,
        strictness=_strictness(problem),
        tolerance_given=problem.mesh.tolerance_deg is not None,
        objective_tolerance=1e-6 if enclosed else tolerance,  # looser, because jumps may lie inside intervals
        kinks_at_limits=True,
        enclosed=enclosed,
        layers=any(frictions_of(problem.mechanism.model)),  # thin layers where dry friction changes its sign
    )


def _strictness(problem: Problem) -> float:
    """Return the ratio of the certificate's integration tolerance to the problem's, which is 1e-6 deg if it gives none."""
    return INTEGRATION_DEG / (problem.mesh.tolerance_deg or 1e-6)


def is_exact(problem: Problem, certificate: Certificate) -> bool:
    """Check a motion's integration error against the problem's tolerance or the default one."""
    strict = _strictness(problem)
    return certificate.integration_error_deg * strict <= INTEGRATION_DEG and (
        certificate.integration_error_m * strict <= INTEGRATION_M
    )


def _tightened(problem: Problem, certificate: Certificate, *, speeds: bool) -> Problem:
    """Return a problem with ranges, effort rates and optionally speeds tightened by 1.1 times the overrun."""
    limits = problem.limits
    changed: dict = {}
    inward = 1.1 * np.maximum(0.0, -certificate.position_margin_rad)[:, None] * np.array([1.0, -1.0])
    changed["position"] = limits.position + inward
    if speeds:
        over = 1.1 * np.maximum(0.0, -certificate.speed_margin_rad_s)[:, None]
        changed["speed"] = limits.speed + over * np.array([1.0, -1.0])
    problem = replace(problem, limits=replace(limits, **changed))
    for margin in certificate.margins:
        if margin.of.tightened is None and not margin.kept and np.isfinite(margin.left):
            problem = margin.of.narrowed(problem, 1.1 * -margin.left)
    return problem
