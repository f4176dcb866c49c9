"""A user's problem as refinement sees it: solved within limits that may be tightened, certified against what was asked."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from linkplan.planner.limits.limit import WhichJoints
from linkplan.planner.ode.certificate import (
    INTEGRATION_SHARE,
    LIMIT_SLACK,
    OBJECTIVE_ERROR_FACTOR,
    OVERRUN_SHARE,
    OdeCertificate,
    certify_ode,
    running_cost,
)
from linkplan.planner.ode.formulation import finite_size, formulate_ode, start_from
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.case import ErrorReport, RefinementTarget
from linkplan.planner.refinement.marking import Tightening, tightened_share
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.collocation import Transcribed, collocate, curves_of
from linkplan.planner.transcription.formulation import Start, Units
from linkplan.planner.transcription.mesh import Mesh
from linkplan.planner.transcription.schemes import scheme

# The objective settles to this share where the user gives no tolerance and that is cheap.
_OBJECTIVE_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class OdeCase:
    """A `planner.refinement.case.Case` of a user's problem; solves are within `problem`, certificates against `asked`."""

    problem: OdeProblem
    asked: OdeProblem
    units: Units
    tightenings: tuple[Tightening, ...] = ()

    @property
    def target(self) -> RefinementTarget:
        """The form of the best motion, of which little is known, and the accuracy that is asked for."""
        asked = self.asked
        return RefinementTarget(
            effort_limit=asked.effort_limit,
            # Efforts can jump if both limits are finite.
            switches=bool(np.any(np.all(np.isfinite(asked.effort_limit), axis=1))),
            bang_bang=False,  # a differential equation's efforts may take a singular arc anywhere
            continuous_efforts=False,  # nothing is known of its costs
            strictness=INTEGRATION_SHARE / asked.tolerance,
            tolerance_given=True,  # the mesh may grow beyond what is comfortable
            objective_tolerance=asked.objective_tolerance or _OBJECTIVE_TOLERANCE,
            objective_tolerance_given=asked.objective_tolerance is not None,
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
        curves = curves_of(solution.transcribed, solution.x, self.asked.effort_limit)
        state = curves.state[..., : self.asked.n_x]  # time may be the last one
        motion = OdeTrajectory(breaks_s=curves.breaks_s, state=state, effort=curves.effort)
        return replace(motion, running=running_cost(self.asked, motion, solution.transcribed.scheme))

    def start_from(self, motion: OdeTrajectory) -> Start:
        """Return a solution as a start."""
        return start_from(motion, self.units)

    def certify(self, motion: OdeTrajectory) -> OdeCertificate:
        """Return a solution's certificate."""
        return certify_ode(self.asked, motion)

    def error_report(self, certificate: OdeCertificate) -> ErrorReport:
        """Return the errors that a certificate reports; another mesh may remove each of them."""
        return ErrorReport(
            # The objective is to be that of the integrated motion, too.
            exact=certificate.integration_error <= self.asked.tolerance
            and certificate.objective_error <= OBJECTIVE_ERROR_FACTOR * self.asked.tolerance
            and certificate.overrun <= OVERRUN_SHARE,
            repairable=not certificate.passed,
            leaves_positions=certificate.leaves_states,
            overruns=bool(min(certificate.path_margin.min(initial=0.0), certificate.state_margin.min()) < -LIMIT_SLACK),
            overrun=(certificate.path_overrun / self._path_size[:, None]).max(axis=0, initial=0.0),
            touching=certificate.touching,
            unstable=certificate.integration_restarts > 0,
            # Above this share, high degrees follow another motion between the nodes, and the next mesh leads elsewhere.
            unseen=certificate.integration_restarts > 0 and certificate.integration_error > 1.0,
            integration_error=certificate.integration_error,
        )

    def tightened(self, certificate: OdeCertificate, motion: OdeTrajectory) -> "OdeCase":
        """Return the case with limits tightened by what the solution overran them."""
        breaks = (motion.breaks_s - motion.breaks_s[0]) / motion.duration_s
        further = [
            Tightening(what="path", item=k, breaks=breaks, share=size * tightened_share(overrun / size))
            for k, (overrun, size) in enumerate(zip(certificate.path_overrun, self._path_size, strict=True))
            if overrun.max() > 0
        ]
        # A bound is tightened by this multiple of its overrun.
        over = 1.1 * np.maximum(0.0, -certificate.state_margin)
        state = self.problem.state_limit + over[:, None] * np.array([1.0, -1.0])
        return replace(self, problem=replace(self.problem, state_limit=state), tightenings=(*self.tightenings, *further))

    def with_scheme(self, name: str) -> "OdeCase":
        """Return the case with another transcription."""
        return replace(self, problem=replace(self.problem, mesh=self.problem.mesh.replace(scheme=name)))

    @property
    def _path_size(self) -> np.ndarray:
        """The sizes (n_path,) of the path limits."""
        size = finite_size(self.asked.path_limit)
        return np.where(size > 0, size, 1.0)
