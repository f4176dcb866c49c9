"""A user's problem as refinement sees it: solved within path limits that may be tightened, certified against its own."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from linkplan.planner.limits.limit import WhichJoints
from linkplan.planner.ode.certificate import (
    INTEGRATION_SHARE,
    OBJECTIVE_ERROR_FACTOR,
    OVERRUN_SHARE,
    OdeCertificate,
    certify_ode,
    running_cost,
)
from linkplan.planner.ode.formulation import formulate_ode, start_from
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.case import ErrorReport, RefinementTarget
from linkplan.planner.refinement.marking import Tightening, tightenings_of
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.collocation import Transcribed, collocate, curves_of
from linkplan.planner.transcription.formulation import Start, Units
from linkplan.planner.transcription.mesh import Mesh
from linkplan.planner.transcription.schemes import scheme

# The objective settles to this share where the user gives no tolerance and that is cheap.
_OBJECTIVE_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class OdeCase:
    """A `planner.refinement.case.Case` of a user's problem, whose path limits may be tightened."""

    problem: OdeProblem
    units: Units
    tightenings: tuple[Tightening, ...] = ()

    @property
    def target(self) -> RefinementTarget:
        """The form of the best motion, of which little is known, and the accuracy that is asked for."""
        problem = self.problem
        return RefinementTarget(
            effort_limit=problem.effort_limit,
            # Efforts can jump if both limits are finite.
            switches=bool(np.any(np.all(np.isfinite(problem.effort_limit), axis=1))),
            bang_bang=False,  # a differential equation's efforts may take a singular arc anywhere
            continuous_efforts=False,  # nothing is known of its costs
            strictness=INTEGRATION_SHARE / problem.tolerance,
            tolerance_given=True,  # the mesh may grow beyond what is comfortable
            objective_tolerance=problem.objective_tolerance or _OBJECTIVE_TOLERANCE,
            objective_tolerance_given=problem.objective_tolerance is not None,
        )

    def transcribe(
        self, start: Start, mesh: Mesh, durations: np.ndarray, *, position_rows: WhichJoints = False, **arcs: Any
    ) -> Transcribed:
        """Return the program from a start."""
        formulation = formulate_ode(self.problem, self.units, state_rows=bool(position_rows), tightenings=self.tightenings)
        settings, solver = self.problem.mesh, self.problem.solver
        chosen = scheme(settings.scheme, settings.effort)
        how = {"compile_mode": solver.compile, "deadline": solver.deadline}
        return collocate(formulation, chosen, mesh, durations, start, **how, **arcs)

    def motion(self, solution: Solution) -> OdeTrajectory:
        """Return a solution's polynomials."""
        curves = curves_of(solution.transcribed, solution.x, self.problem.effort_limit)
        state = curves.state[..., : self.problem.n_x]  # time may be the last one
        motion = OdeTrajectory(breaks_s=curves.breaks_s, state=state, effort=curves.effort)
        return replace(motion, running=running_cost(self.problem, motion, solution.transcribed.scheme))

    def start_from(self, motion: OdeTrajectory) -> Start:
        """Return a solution as a start."""
        return start_from(motion, self.units)

    def certify(self, motion: OdeTrajectory) -> OdeCertificate:
        """Return a solution's certificate."""
        return certify_ode(self.problem, motion)

    def error_report(self, certificate: OdeCertificate) -> ErrorReport:
        """Return the errors that a certificate reports; another mesh may remove each of them."""
        over = [margin.overrun for margin in certificate.margins if margin.of.facts.tightened is not None]
        return ErrorReport(
            # The objective is to be that of the integrated motion, too.
            exact=certificate.integration_error <= self.problem.tolerance
            and certificate.objective_error <= OBJECTIVE_ERROR_FACTOR * self.problem.tolerance
            and certificate.overrun <= OVERRUN_SHARE,
            repairable=not certificate.passed,
            leaves_positions=any(margin.what == "state" and not margin.kept for margin in certificate.margins),
            overruns=not all(margin.kept for margin in certificate.margins),
            overrun=np.max([np.zeros(len(certificate.growth)), *over], axis=0),
            touching=certificate.touching,
            integration_error=certificate.integration_error,
        )

    def tightened(self, certificate: OdeCertificate, motion: OdeTrajectory) -> "OdeCase":
        """Return the case with path limits tightened by what the solution overran them; rows keep those of states."""
        return replace(self, tightenings=self.tightenings + tightenings_of(certificate.margins, motion.breaks_s))

    def with_scheme(self, name: str) -> "OdeCase":
        """Return the case with another transcription."""
        return replace(self, problem=replace(self.problem, mesh=self.problem.mesh.replace(scheme=name)))
