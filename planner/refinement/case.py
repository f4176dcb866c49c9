"""The interface of a refined problem, `Case`, one solve of it, and its iterates with their certificates."""

from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import numpy as np

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.errors import AssemblyError
from linkplan.planner.certificate.certificate import Certificate
from linkplan.planner.limits.limit import WhichJoints
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.constrained_arcs import FixedArcs
from linkplan.planner.refinement.history import add_step, amend_last_step, progress, recorded, step_of
from linkplan.planner.solvers.newton import nearest_feasible
from linkplan.planner.solvers.solve import OUT_OF_ITERATIONS, OUT_OF_TIME, Solution, solve
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Mesh


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class RefinementTarget:
    """The known form of the best motion, and the required accuracy.

    Attributes:
        effort_limit: (n_u, 2).
        switches: efforts can jump between their limits, so switch times are searched for.
        bang_bang: efforts are at their limits wherever no other limit binds; arcs can be very short.
        continuous_efforts: efforts pass from one limit to the other without a jump, possibly within one interval.
        strictness: the certificate's tolerance of the integrated state, divided by the tolerance of the refinement.
        tolerance_given: the user set this tolerance.
        objective_tolerance: the largest relative change of the objective from mesh to mesh; None if it is not checked.
        kinks_at_limits: the motion is smooth where no limit binds, so the integration error alone measures the mesh.
        enclosed: enclosable limits hold at every instant, by rows on Bernstein coefficients.
        has_boundary_layers: the motion has thin layers; the error falls only once the mesh resolves them.
    """

    effort_limit: np.ndarray
    switches: bool
    strictness: float
    tolerance_given: bool
    objective_tolerance: float | None
    bang_bang: bool = False
    continuous_efforts: bool = False
    kinks_at_limits: bool = False
    enclosed: bool = False
    has_boundary_layers: bool = False


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ErrorReport:
    """The errors of an iterate, read from its certificate.

    Attributes:
        passed: no limit is violated, except that of an effort by inverse dynamics.
        exact: the integration error is within the tolerance.
        repairable: a finer mesh can remove the reason why the certificate does not pass.
        leaves_positions: a joint leaves its range between the nodes.
        overruns: a joint's range or another limit is overrun between the nodes.
        overrun: (n_intervals,) the largest overrun of any limit on each interval, as a share of the limit.
        growth: (n_intervals,) the contribution of each interval to the integration error, as a share of the allowed error.
        residual_share: (n_intervals,) the dynamics residual, as a share of the allowed residual.
        effort_overrun: (n_intervals,) the overrun of needed efforts, as a share of what a proof allows.
        integration_error_deg: [deg].
    """

    passed: bool
    exact: bool
    repairable: bool
    leaves_positions: bool
    overruns: bool
    overrun: np.ndarray
    growth: np.ndarray
    residual_share: np.ndarray
    effort_overrun: np.ndarray
    integration_error_deg: float


class Case(Protocol):
    """A problem that can be refined; `planner.closed_chain` has the only one, and its own type of starts."""

    @property
    def problem(self) -> Problem:
        """The problem that is solved, with the limits tightened so far."""
        ...

    @property
    def target(self) -> RefinementTarget:
        """The known form of its best motion, and the required accuracy."""
        ...

    def transcribe(
        self,
        start: Any,
        mesh: Mesh,
        durations: np.ndarray,
        *,
        position_rows: WhichJoints = False,
        bang_efforts: np.ndarray | None = None,
        constrained_paths: np.ndarray | None = None,
    ) -> Transcribed:
        """Return the program that begins at a start; the options are those of the cases' own `transcribe`."""
        ...

    def motion(self, solution: Solution) -> Trajectory | None:
        """Return the motion of a solution, or None if it leaves the branch of the mechanism."""
        ...

    def start_from(self, motion: Trajectory) -> Any:
        """Return a motion as a start."""
        ...

    def certify(self, motion: Trajectory) -> Certificate | None:
        """Return a motion's certificate; None where it has none."""
        ...

    def error_report(self, certificate: Certificate) -> ErrorReport:
        """Return the errors that a certificate shows."""
        ...

    def tightened(self, certificate: Certificate, motion: Trajectory) -> Self:
        """Return the case with limits tightened by what a motion overran them (constraint tightening)."""
        ...


def with_scheme(case: Any, name: str) -> Any:
    """Return a `Case` with another transcription."""
    return replace(case, problem=case.problem.varied(mesh=case.problem.mesh.replace(scheme=name)))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Iterate:
    """The motion and solution of one solve; `fixed` are the efforts and path quantities fixed along its arcs, or None."""

    motion: Trajectory
    solution: Solution
    fixed: FixedArcs | None = None

    @property
    def mesh(self) -> Mesh:
        """The mesh of the solve."""
        return self.solution.transcribed.program.mesh

    @property
    def durations(self) -> np.ndarray:
        """The durations (n_segments,) [s] of the mesh's segments."""
        return np.bincount(self.mesh.segment, np.diff(self.motion.breaks_s))


def attempt(
    case: Case,
    start: Any,
    mesh: Mesh,
    durations: np.ndarray,
    what: str,
    *,
    warm: bool = False,
    close: bool = False,
    adaptive: bool = False,
    position_rows: WhichJoints = False,
    bang_efforts: np.ndarray | None = None,
    fixed: FixedArcs | None = None,
) -> Iterate | None:
    """Solve once, note it in the history, and return the iterate; None if there is no motion or no time is left.

    If a solve from a `close` start runs out of iterations or time, the result is the motion nearest to its last iterate.
    This iterate violates the equations, but its objective has often settled.

    Args:
        case: the problem.
        start: the motion to begin from, of the case's own type.
        mesh: intervals.
        durations: (n_segments,) [s] of the mesh's segments in the start.
        what: the name of this solve in history and progress.
        warm: as of `linkplan.planner.solvers.solve.build_solver`.
        close: likewise.
        adaptive: likewise.
        position_rows: whether rows enforce ranges between the nodes, or the independent coordinates with such rows.
        bang_efforts: (n_segments, n_u) efforts fixed over whole segments, NaN where they are free.
        fixed: quantities that the refinement fixes along arcs; replaces `bang_efforts`.
    """
    settings = case.problem
    if settings.solver.deadline.passed:
        return None
    progress(_attempted(what, settings.mesh.scheme, mesh))
    efforts, paths = (bang_efforts, None) if fixed is None else (fixed.efforts, fixed.paths)
    try:
        transcribed = case.transcribe(
            start, mesh, durations, position_rows=position_rows, bang_efforts=efforts, constrained_paths=paths
        )
    except (AssemblyError, OutOfTimeError):  # the loops of the start open between its samples
        return None
    solution = solve(transcribed, settings.solver, warm=warm, close=close, adaptive=adaptive)
    if close and solution.status in (OUT_OF_ITERATIONS, OUT_OF_TIME):
        near = nearest_feasible(transcribed, solution.x, settings.solver.certificate_deadline)
        solution = replace(near, iterations=solution.iterations + near.iterations)
    add_step(step_of(what, transcribed, solution))
    if not solution.converged:
        return None
    motion = case.motion(solution)
    return None if motion is None else Iterate(motion=motion, solution=solution, fixed=fixed)


def _attempted(what: str, scheme: str, mesh: Mesh) -> str:
    """Return the progress line of a new solve, with the objective of the previous one."""
    segments = f"{mesh.n_segments} segments" if mesh.n_segments > 1 else "1 segment"
    steps = recorded()
    last = steps[-1] if steps else None
    came = "" if last is None else f"; last objective {last.objective:.6g}" if last.converged else "; last one not solved"
    return f"{what}: {scheme}, {mesh.n_intervals} intervals, {segments}{came}"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class CertifiedIterate:
    """An iterate, its certificate, and the errors that the certificate shows; None without a certificate."""

    found: Iterate
    certificate: Certificate | None
    report: ErrorReport | None

    @property
    def passed(self) -> bool:
        """True if its certificate passes, or needs only less effort between the nodes."""
        return self.report is not None and self.report.passed

    @property
    def overruns(self) -> bool:
        """True if a limit is overrun between the nodes."""
        return self.report is not None and self.report.overruns

    @property
    def n_intervals(self) -> int:
        """The number of intervals of its mesh."""
        return self.found.mesh.n_intervals


def certify_iterate(case: Case, found: Iterate) -> CertifiedIterate:
    """Certify an iterate and note its integration error in the history."""
    certificate = case.certify(found.motion)
    report = None if certificate is None else case.error_report(certificate)
    if report is not None:
        amend_last_step(integration_error_deg=report.integration_error_deg)
    return CertifiedIterate(found=found, certificate=certificate, report=report)


def share_gained(before: float, after: float, least: float = 0.0) -> float:
    """Return the decrease of an objective, of either sign, as a share of the later one's size, or of `least` if larger."""
    return (before - after) / max(abs(after), least, np.finfo(float).tiny)


def error_of(at: CertifiedIterate) -> float:
    """Return the integration error [deg]; infinite without a certificate."""
    return np.inf if at.report is None else at.report.integration_error_deg
