"""What is refined, and one solve of it.

What is planned for stands behind `Case`: a mechanism's problem and a user's differential equation are refined by the
same code.
"""

import functools
import hashlib
from dataclasses import dataclass
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.errors import AssemblyError
from linkplan.planner.problem.settings import MeshSettings, SolverSettings
from linkplan.planner.refinement.constrained_arcs import FixedArcs
from linkplan.planner.refinement.history import Say, Step, step_of
from linkplan.planner.refinement.switches import Motion
from linkplan.planner.solvers.outcome import OUT_OF_TIME
from linkplan.planner.solvers.solve import Solution, solve
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.mesh import Mesh
from linkplan.planner.transcription.system import Endpoint, System


class Certificate(Protocol):
    """What refinement needs of a certificate."""

    @property
    def passed(self) -> bool:
        """Whether everything holds."""
        ...

    @property
    def growth(self) -> np.ndarray:
        """What each interval (n_intervals,) adds to the integration error, in shares of what is allowed in all."""
        ...

    @property
    def residual_share(self) -> np.ndarray:
        """The dynamics residual on each interval (n_intervals,), in shares of what is allowed."""
        ...


MotionT = TypeVar("MotionT", bound=Motion)
CertificateT = TypeVar("CertificateT", bound=Certificate)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Aims:
    """What the best motion looks like as far as that is known beforehand, and how exact it is to be.

    `switches` says whether efforts may jump between their limits, `effort_limit` (n_u, 2): switch times are then looked for;
    `bang_bang` whether they are at their limits wherever no other limit binds: such arcs may be as short as may be;
    `continuous_efforts` whether efforts pass from one limit to the other without a jump, be it in less than an interval.
    `strictness` is how many times more exact than a certificate demands the integrated state is to be, `tolerance_given`
    whether the user asked for that, `objective_tolerance` what the objective may change by from mesh to mesh, relative, None
    where it is not looked at; `kinks_at_limits` that the motion is smooth where no limit binds: the integration error tells
    all there. `enclosed` says that limits which efforts jump between are kept at every instant by rows on coefficients.
    `layers` says that the motion has layers so thin that finer meshes err as much until they are seen.
    """

    effort_limit: np.ndarray
    switches: bool
    bang_bang: bool
    continuous_efforts: bool
    strictness: float
    tolerance_given: bool
    objective_tolerance: float | None
    kinks_at_limits: bool = False
    enclosed: bool = False
    layers: bool = False


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Findings:
    """What a certificate says to refinement.

    `exact`: the integration error is within the tolerance. `mendable`: another mesh may mend why it does not pass.
    `leaves_positions`: states leave their bounds between the nodes; `overruns`: so do they, or another limit is left there.
    `overrun` (n_intervals,): by what share of themselves limits are overrun between the nodes, at most, on each interval.
    `touching` (n_intervals,): whether a limit is touched on part of an interval only, None where that is not looked at.
    `unstable`: an error grows so much along the motion that it is judged interval by interval. `unseen`: so it does, and the
    mesh is too coarse to see what the motion does within intervals: no matter for the degree.
    The integration error is noted in the history: [deg] of a mechanism, else as a share of the states' sizes.
    """

    exact: bool
    mendable: bool
    leaves_positions: bool
    overruns: bool
    overrun: np.ndarray
    touching: np.ndarray | None = None
    unstable: bool = False
    unseen: bool = False
    integration_error_deg: float | None = None
    integration_error: float | None = None


class Settings(Protocol):
    """What refinement needs of a problem."""

    @property
    def mesh(self) -> MeshSettings:
        """The transcription, the first mesh, and how it is refined."""
        ...

    @property
    def solver(self) -> SolverSettings:
        """How programs are solved."""
        ...


class Case(Protocol[MotionT, CertificateT]):
    """A problem as refinement sees it. Motions, starts and certificates are its own."""

    @property
    def problem(self) -> Settings:
        """What is solved: the problem with limits tightened as they are by now."""
        ...

    @property
    def aims(self) -> Aims:
        """What its best motion looks like, and how exact it is to be."""
        ...

    def transcribe(
        self,
        start: Any,
        mesh: Mesh,
        durations: np.ndarray,
        *,
        position_rows: bool = False,
        bang_efforts: np.ndarray | None = None,
        constrained_paths: np.ndarray | None = None,
    ) -> Transcribed:
        """Return the program from a start; the options are those of the clients' `transcribe`."""
        ...

    def motion(self, solution: Solution) -> MotionT | None:
        """Return the motion of a solution; None where it is none."""
        ...

    def start_from(self, motion: MotionT) -> Any:
        """Return a motion as a start."""
        ...

    def certify(self, motion: MotionT) -> CertificateT | None:
        """Return a motion's certificate; None where it has none."""
        ...

    def findings(self, certificate: CertificateT) -> Findings:
        """Return what a certificate says to refinement."""
        ...

    def tightened(self, certificate: CertificateT, motion: MotionT) -> Self:
        """Return the case with limits tightened by what a motion overran them (constraint tightening)."""
        ...

    def with_scheme(self, name: str) -> Self:
        """Return the case with another transcription."""
        ...


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Found(Generic[MotionT]):
    """A motion that a solve led to, and the solution; `fixed` is what refinement holds along its arcs, None for nothing."""

    motion: MotionT
    solution: Solution
    fixed: FixedArcs | None = None

    @property
    def mesh(self) -> Mesh:
        """The mesh of the solve."""
        return self.solution.transcribed.program.mesh


def attempt(
    case: Case[MotionT, Any],
    start: Any,
    mesh: Mesh,
    durations: np.ndarray,
    what: str,
    history: list[Step],
    say: Say,
    *,
    warm: bool = False,
    close: bool = False,
    position_rows: bool = False,
    bang_efforts: np.ndarray | None = None,
    fixed: FixedArcs | None = None,
) -> Found[MotionT] | None:
    """Return what one solve leads to, noted in the history; None where it found no motion, or no time is left for it.

    Args:
        case: what is solved.
        start: the motion to begin from, as its client has them.
        mesh: intervals.
        durations: (n_segments,) [s] of the mesh's segments in the start.
        what: the words on this solve in history and progress.
        history: takes a note of it.
        say: called with a line of progress.
        warm: as of `linkplan.planner.solvers.solve.build_solver`.
        close: likewise.
        position_rows: whether ranges are kept between the nodes by constraint rows.
        bang_efforts: (n_segments, n_u) efforts held over whole segments, NaN where they are free.
        fixed: what refinement holds along arcs; in place of `bang_efforts`.
    """
    settings = case.problem
    if settings.solver.deadline.passed:
        return None
    say(_attempted(what, settings.mesh.scheme, mesh, history))
    efforts, paths = (bang_efforts, None) if fixed is None else (fixed.efforts, fixed.paths)
    try:
        transcribed = case.transcribe(
            start, mesh, durations, position_rows=position_rows, bang_efforts=efforts, constrained_paths=paths
        )
    except (AssemblyError, OutOfTimeError):  # a start whose loops open between the instants at which it was looked at
        return None
    asked = _asked(transcribed, settings.solver, warm, close)
    known = next((step for step in history if step.asked == asked), None)
    answer = None if known is None else known.answer
    if known is not None and answer is None:
        return None  # a repair that changes nothing here
    if answer is not None:
        solution = Solution(**{**answer, "transcribed": transcribed, "build_s": 0.0, "solve_s": 0.0})
    else:
        solution = solve(transcribed, settings.solver, warm=warm, close=close)
    history.append(step_of(what, transcribed, solution, asked if solution.status != OUT_OF_TIME else ""))
    if not solution.converged:
        return None
    motion = case.motion(solution)
    return None if motion is None else Found(motion=motion, solution=solution, fixed=fixed)


def _asked(transcribed: Transcribed, settings: SolverSettings, warm: bool, close: bool) -> str:
    """Return a hash of a program with its numbers, and of how it is solved."""
    formulation, mesh, linear = transcribed.formulation, transcribed.program.mesh, transcribed.program.linear
    digest = hashlib.sha256(_expressions(formulation.build_system(), formulation.endpoint))
    how = (settings.max_iterations, warm, close, transcribed.scheme.name, transcribed.least_limit)
    digest.update(repr((how, transcribed.scheme.effort_at.shape, formulation.rows)).encode())
    bounds = (transcribed.lower, transcribed.upper, transcribed.row_lower, transcribed.row_upper)
    rows = (linear.rows, linear.columns, linear.values)
    for numbers in (mesh.fraction, mesh.segment, *rows, transcribed.parameters, *bounds, transcribed.start):
        digest.update(numbers.tobytes() + b"|")
    return digest.hexdigest()


@functools.lru_cache(maxsize=16)
def _expressions(system: System, endpoint: Endpoint | None) -> bytes:
    """Return a hash of a system's expressions, and of its endpoint's."""
    functions = [system.node] if endpoint is None else [system.node, endpoint.function]
    return hashlib.sha256("|".join(function.serialize() for function in functions).encode()).digest()


def _attempted(what: str, scheme: str, mesh: Mesh, history: list[Step]) -> str:
    """Return the line on a solve that begins, and on what the one before it came to."""
    segments = f"{mesh.n_segments} segments" if mesh.n_segments > 1 else "1 segment"
    last = history[-1] if history else None
    came = "" if last is None else f"; last objective {last.objective:.6g}" if last.converged else "; last one not solved"
    return f"{what}: {scheme}, {mesh.n_intervals} intervals, {segments}{came}"
