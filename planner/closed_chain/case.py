"""A mechanism's planning problem as refinement sees it."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.errors import AssemblyError
from linkplan.models.tree.friction import frictions_of
from linkplan.planner.certificate.certificate import INTEGRATION_M, RANGE_SLACK, Certificate, certify
from linkplan.planner.closed_chain.formulate import SMOOTHING, formulate
from linkplan.planner.closed_chain.guess import Guess, motion_of
from linkplan.planner.closed_chain.transcribe import choose_scales, trajectory_of, transcribe
from linkplan.planner.keys.kinds import INTEGRATION_DEG
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.case import ErrorReport, RefinementTarget
from linkplan.planner.refinement.constrained_arcs import FixedArcs
from linkplan.planner.refinement.tightening import Tightening, evened, tightenings_of
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Mesh

# What the integrated state is refined towards where no tolerance is asked for [deg].
_TARGET_DEG = 1e-6
# What the objective is to change by from mesh to mesh at the most where that is looked at, relative; with limits on power of
# several freedoms, where jumps stay inside intervals.
_OBJECTIVE, _JUMPS_INSIDE = 1e-7, 1e-6
# Speed limits are tightened where they were overrun so many times, then everywhere: what is left moves about, and is little.
_LOCAL = 1


@dataclass(frozen=True, eq=False, slots=True)
class MechanismCase:
    """A `planner.refinement.case.Case` of a planning problem; certificates are against `asked`, solves within `problem`."""

    problem: PlanningProblem
    asked: PlanningProblem
    tightenings: tuple[Tightening, ...] = ()
    n_tightenings: int = 0
    kinks: bool = True  # whether to look for kinks of efforts that do not jump
    smoothing: float = SMOOTHING  # as of `formulate`
    enclosed: bool = False  # whether limits on power and pin force are kept at every instant
    target: RefinementTarget = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "target", _target(self.asked, kinks=self.kinks, enclosed=self.enclosed))

    def transcribe(self, start: Guess, mesh: Mesh, durations: np.ndarray, **options: Any) -> Transcribed:
        """Return the program from a guess."""
        kept = {"tightenings": self.tightenings, "smoothing": self.smoothing, "enclosed": self.enclosed}
        return transcribe(self.problem, start, mesh, durations, **kept, **options)

    def motion(self, solution: Solution) -> Trajectory | None:
        """Return a solution's trajectory; None where the solver took it to another branch."""
        try:
            return trajectory_of(solution.transcribed, solution.x, self.asked.limits.effort)
        except AssemblyError:
            return None

    def start_from(self, motion: Trajectory) -> Guess:
        """Return a trajectory as a guess."""
        return motion_of(motion)

    def certify(self, motion: Trajectory) -> Certificate | None:
        """Return a trajectory's certificate; None where it leaves the branch, or no time is left."""
        try:
            return certify(self.asked, motion)
        except (AssemblyError, OutOfTimeError):
            return None

    def error_report(self, certificate: Certificate) -> ErrorReport:
        """Return what a certificate says to refinement."""
        over = [certificate.speed_overrun, certificate.position_overrun]
        over += [margin.overrun[None] for margin in certificate.margins if margin.of.tightened is not None]
        least = min(certificate.position_margin.min(), certificate.speed_margin.min())
        return ErrorReport(
            exact=is_exact(self.asked, certificate),
            mendable=certificate.mendable,
            leaves_positions=bool(np.any(certificate.position_margin < 0)),
            overruns=bool(least < -RANGE_SLACK) or not all(margin.kept for margin in certificate.margins),
            overrun=np.vstack(over).max(axis=0),
            integration_error_deg=certificate.integration_error_deg,
        )

    def tightened(self, certificate: Certificate, motion: Trajectory) -> "MechanismCase":
        """Return the case with limits tightened by what the motion overran them."""
        further = tightenings_of(certificate.margins, certificate.speed_overrun, motion.breaks_s)
        further = evened(further) if self.enclosed else further
        everywhere = self.n_tightenings >= _LOCAL
        problem = _tightened(self.problem, certificate, speeds=everywhere)
        return replace(self, problem=problem, tightenings=self.tightenings + further, n_tightenings=self.n_tightenings + 1)

    def with_scheme(self, name: str) -> "MechanismCase":
        """Return the case with another transcription."""
        return replace(self, problem=replace(self.problem, mesh=replace(self.problem.mesh, scheme=name)))


def case_of(problem: PlanningProblem, *, kinks: bool = True, enclosed: bool = False) -> MechanismCase:
    """Return the case of a problem; `kinks` says whether kinks of efforts that do not jump are looked for.

    Limits on power of several freedoms are kept at every instant. Of one freedom the phase plane knows which limit follows
    on which, and their arcs are held; `enclosed` says that they, and limits on pin force, are kept at every instant too.
    """
    powers = problem.mesh.effort == "polynomial" and bool(np.any(np.isfinite(problem.limits.power)))
    return MechanismCase(problem, problem, kinks=kinks, enclosed=enclosed or (powers and problem.mechanism.dof > 1))


def held_arcs_of(problem: PlanningProblem, guess: Guess) -> FixedArcs:
    """Return what a guess along limits on power and pin force holds along its arcs."""
    system = formulate(problem, choose_scales(problem, guess)).build_system()
    kinds = np.array(system.kinds[system.n_equations :])
    paths = np.zeros((len(guess.power_arcs), len(kinds)), dtype=int)
    paths[:, kinds == "power"] = guess.power_arcs[:, np.isfinite(problem.limits.power).any(axis=1)]
    if guess.force_arcs is not None:
        paths[:, kinds == "closure_force"] = guess.force_arcs
    return FixedArcs(efforts=guess.bang_efforts, paths=paths)


def _target(problem: PlanningProblem, *, kinks: bool, enclosed: bool) -> RefinementTarget:
    """Return what the best motion of a problem looks like, and how exact it is to be.

    Efforts jump between limits, none and arcs where time or work count; where their squares do, they bend where they reach a
    limit and have no jumps; where time alone counts they are at their limits wherever no other limit binds. The objective's
    change is looked at where limits on coefficients cost what a motion does not show. With limits on power kept at every
    instant switches are not looked for: jumps may stand inside intervals.
    """
    objective = problem.objective
    continuous_efforts = objective.efforts("bend")
    bending = kinks and continuous_efforts and not objective.has("tracking")
    switches = not enclosed and (objective.efforts("jump") or bending) and not objective.efforts("smooth")
    lines = any(motor is not None and motor.has_line for motor in problem.motors)
    bent = continuous_efforts and bool(np.any(np.isfinite(problem.limits.speed[problem.mechanism.independent])))
    tolerance = _OBJECTIVE if switches and (lines or bent) else None
    return RefinementTarget(
        effort_limit=problem.limits.effort,
        switches=switches,
        bang_bang=list(objective.weights) == ["time"],
        continuous_efforts=continuous_efforts,
        strictness=_strictness(problem),
        tolerance_given=problem.mesh.tolerance_deg is not None,
        objective_tolerance=_JUMPS_INSIDE if enclosed else tolerance,
        kinks_at_limits=True,
        enclosed=enclosed,
        layers=any(frictions_of(problem.mechanism.model)),  # where dry friction turns over
    )


def _strictness(problem: PlanningProblem) -> float:
    """Return how many times more exact than a certificate demands the integrated state is to be."""
    return INTEGRATION_DEG / (problem.mesh.tolerance_deg or _TARGET_DEG)


def is_exact(problem: PlanningProblem, certificate: Certificate) -> bool:
    """Return whether a motion's integrated state is within what is asked, or refined towards where nothing is."""
    strict = _strictness(problem)
    return certificate.integration_error_deg * strict <= INTEGRATION_DEG and (
        certificate.integration_error_m * strict <= INTEGRATION_M
    )


def _tightened(problem: PlanningProblem, certificate: Certificate, *, speeds: bool) -> PlanningProblem:
    """Return a problem with ranges, effort rates and maybe speeds tightened by what a motion overran, and a tenth more."""
    limits = problem.limits
    changed: dict = {}
    inward = 1.1 * np.maximum(0.0, -certificate.position_margin)[:, None] * np.array([1.0, -1.0])
    changed["position"] = limits.position + inward
    if speeds:
        over = 1.1 * np.maximum(0.0, -certificate.speed_margin)[:, None]
        changed["speed"] = limits.speed + over * np.array([1.0, -1.0])
    problem = replace(problem, limits=replace(limits, **changed))
    for margin in certificate.margins:
        if margin.of.tightened is None and not margin.kept and np.isfinite(margin.left):
            problem = margin.of.narrowed(problem, 1.1 * -margin.left)
    return problem
