"""Solving a user's optimal-control problem: the transcription, refinement and certificate that mechanisms get.

problem = OdeProblem(name="double integrator", rate=lambda x, u, p, t: [x[1], u[0]], start=[0, 0], goal=[1, 0],
                     effort_limit=[[-1, 1]], duration_s=(0.1, 10), final_cost=lambda x0, xT, T, p: T)
plan = plan_ode(problem).require()        # plan.objective is 2, with one switch at T / 2
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.errors import InfeasibleError
from planner.collocation import Transcribed, collocate, curves_of
from planner.formulation import Start, Units
from planner.insets import Inset, drawn
from planner.mesh import Mesh, broken, uniform
from planner.ode_certificate import INTEGRATION, SLACK, OdeCertificate, certify_ode
from planner.ode_formulation import completed, formulate_ode, start_from, start_of, straight_guess, units_of
from planner.ode_problem import OdeProblem, StateGuess
from planner.ode_trajectory import OdeTrajectory
from planner.plan import Step
from planner.problem import MeshSettings, SolverSettings
from planner.refinement import Say, attempt, refine, silent, step_of
from planner.schemes import scheme
from planner.solve import INVALID, OUT_OF_TIME, Solution, solve

# Bends of further starts: half waves over the motion, and their size as a share of each state's.
_WAVES = 3
_BEND = 0.5
# A bound drawn in takes a little more than what was overrun.
_MORE = 1.1


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class OdePlan:
    """A solution with its certificate, or none and the reason; `status` is "optimal", "infeasible" or "failed"."""

    problem: OdeProblem
    status: str
    message: str
    objective: float | None = None
    trajectory: OdeTrajectory | None = None
    certificate: OdeCertificate | None = None
    history: tuple[Step, ...] = ()

    def require(self) -> "OdePlan":
        """Return this plan if it is optimal.

        Raises:
            InfeasibleError: carrying the plan, if it is not.
        """
        if self.status != "optimal":
            raise InfeasibleError(self.message, self)
        return self


@dataclass(frozen=True, eq=False, slots=True)
class OdeCase:
    """A `planner.refinement.Case` of a user's problem; solves are within `problem`, certificates against `asked`."""

    problem: OdeProblem
    asked: OdeProblem
    units: Units
    insets: tuple[Inset, ...] = ()

    @property
    def mesh(self) -> MeshSettings:
        """The problem's mesh settings."""
        return self.problem.mesh

    @property
    def solver(self) -> SolverSettings:
        """The problem's solver settings."""
        return self.problem.solver

    @property
    def effort_limit(self) -> np.ndarray:
        """The effort limits (n_u, 2)."""
        return self.asked.effort_limit

    @property
    def least_time(self) -> bool:
        """Whether switches are looked for: wherever an effort has two limits to jump between."""
        return bool(np.any(np.all(np.isfinite(self.asked.effort_limit), axis=1)))

    @property
    def tolerance_given(self) -> bool:
        """Whether the mesh may grow beyond what is comfortable."""
        return True

    @property
    def objective_tolerance(self) -> float | None:
        """The tolerance on the objective's change from mesh to mesh."""
        return self.asked.objective_tolerance

    def transcribe(
        self,
        start: Start,
        mesh: Mesh,
        durations: np.ndarray,
        *,
        position_rows: bool = False,
        pinned: np.ndarray | None = None,
        held: np.ndarray | None = None,
        least_limit: bool = False,
    ) -> Transcribed:
        """Return the program from a start."""
        formulation = formulate_ode(
            self.problem, self.units, state_rows=position_rows, least_limit=least_limit, insets=self.insets
        )
        return collocate(
            formulation,
            scheme(self.mesh.scheme, self.mesh.effort),
            mesh,
            durations,
            start,
            compile_mode=self.solver.compile,
            least_limit=least_limit,
            pinned=pinned,
            held=held,
        )

    def motion(self, solution: Solution, limit: np.ndarray) -> OdeTrajectory:
        """Return a solution's polynomials."""
        curves = curves_of(solution.transcribed, solution.x, limit)
        return OdeTrajectory(breaks_s=curves.breaks_s, state=curves.state, effort=curves.effort, n_x=self.asked.n_x)

    def start_from(self, motion: OdeTrajectory) -> Start:
        """Return a solution as a start."""
        return start_from(motion, self.units)

    def certify(self, motion: OdeTrajectory) -> OdeCertificate:
        """Return a solution's certificate."""
        return certify_ode(self.asked, motion)

    def strictness(self) -> float:
        """Return how many times more exact than a certificate demands the integrated state is to be."""
        return INTEGRATION / self.asked.tolerance

    def exact(self, certificate: OdeCertificate) -> bool:
        """Return whether the integrated state is within the tolerance."""
        return certificate.integration_error <= self.asked.tolerance

    def noted(self, step: Step, certificate: OdeCertificate) -> Step:
        """Return a step with the certificate's integration error."""
        return replace(step, integration_error=certificate.integration_error)

    def leaves_positions(self, certificate: OdeCertificate) -> bool:
        """Return whether a state leaves its limits."""
        return bool(np.any(certificate.state_margin < 0))

    def overruns(self, certificate: OdeCertificate) -> bool:
        """Return whether a path quantity or a state leaves its limits between the nodes."""
        return bool(min(certificate.path_margin.min(initial=0.0), certificate.state_margin.min()) < -SLACK)

    def overrun(self, certificate: OdeCertificate) -> np.ndarray:
        """Return by what share of themselves path limits are overrun between the nodes, at most, on each interval (n,)."""
        size = [max(abs(bound) for bound in limit if np.isfinite(bound)) or 1.0 for limit in self.asked.path_limit]
        n = len(certificate.growth)
        return (certificate.path_overrun / np.array(size).reshape(-1, 1)).max(axis=0, initial=0.0).reshape(n)

    def tightened(self, certificate: OdeCertificate, motion: OdeTrajectory) -> "OdeCase":
        """Return the case with limits drawn in by what the solution overran them."""
        breaks = (motion.breaks_s - motion.breaks_s[0]) / motion.duration_s
        further = []
        for k, (overrun, limit) in enumerate(zip(certificate.path_overrun, self.asked.path_limit, strict=True)):
            if overrun.max() > 0:
                upper = bool(np.isfinite(limit[1]) and (limit[1] or not np.isfinite(limit[0])))
                share = drawn(overrun / (abs(limit[int(upper)]) or 1.0))
                further.append(Inset(what="path", item=k, breaks=breaks, share=share, upper=upper))
        inward = np.array([1.0, -1.0])
        state = self.problem.state_limit + _MORE * np.maximum(0.0, -certificate.state_margin)[:, None] * inward
        return replace(self, problem=replace(self.problem, state_limit=state), insets=(*self.insets, *further))

    def with_scheme(self, name: str) -> "OdeCase":
        """Return the case with another transcription."""
        return replace(self, problem=replace(self.problem, mesh=replace(self.problem.mesh, scheme=name)))


def plan_ode(problem: OdeProblem, say: Say = silent) -> OdePlan:
    """Return the solution of a problem; one without an answer says why in `message`.

    The guesses are tried in turn, the first where none is given being a straight line; with `solver.starts` above 1 as many
    starts are solved, bent from the guesses at random but the same in every run, and the best is refined.
    """
    contradiction = _contradiction(problem)
    if contradiction is not None:
        return OdePlan(problem=problem, status="infeasible", message=contradiction)
    history: list[Step] = []
    given = [completed(problem, guess) for guess in problem.guesses] or [straight_guess(problem)]
    starts = given if problem.solver.starts == 1 else _starts(problem, given)
    found: list[tuple[float, int, Any, OdeCase, Mesh]] = []
    for number, guess in enumerate(starts):
        case = OdeCase(problem, problem, units_of(problem, guess))
        mesh = uniform(problem.mesh.intervals) if problem.mesh.breaks is None else broken(problem.mesh.breaks)
        durations = np.array([guess.duration_s])
        word = f"start {number + 1}" if number or problem.solver.starts > 1 else "first solve"
        solved = attempt(case, start_of(guess, case.units), mesh, durations, word, history, say)
        if solved is not None:
            found.append((solved[1].objective, number, solved, case, mesh))
            if problem.solver.starts == 1:
                break
    failed = None
    for _, _, solved, case, mesh in sorted(found, key=lambda item: item[:2]):
        plan = _refined(problem, case, solved, mesh, history, say)
        if plan.status == "optimal":
            return plan
        failed = failed or plan
    return failed or _explain(problem, given[0], history, say)


def _refined(problem: OdeProblem, case: OdeCase, solved, mesh: Mesh, history: list[Step], say: Say) -> OdePlan:
    refined = refine(case, solved, mesh, history, say)
    assert refined is not None  # a user's solution always has a certificate
    trajectory, solution, certificate, settled = refined
    status, message = "optimal", f"optimum {solution.objective:.10g} in {trajectory.duration_s:.8g} s"
    if not certificate.passed:
        status = "failed"
        message = f"failed: the solver converged, the certificate does not pass: {'; '.join(certificate.failures)}"
    elif not case.exact(certificate):
        status = "failed"
        message = (
            f"failed: the integrated state ends {certificate.integration_error:.3g} of its size from the solution, more than"
            f" the tolerance {problem.tolerance:g}"
        )
    elif not settled:
        status = "failed"
        message = (
            f"failed: the objective still changes from mesh to mesh by more than objective_tolerance ="
            f" {problem.objective_tolerance:g}, at {solution.objective:.10g}"
        )
    return OdePlan(
        problem=problem,
        status=status,
        message=message,
        objective=solution.objective,
        trajectory=trajectory,
        certificate=certificate,
        history=tuple(history),
    )


def _starts(problem: OdeProblem, given: list[StateGuess]) -> Iterator[StateGuess]:
    """Yield as many starts as the problem asks for: the guesses, then the guesses bent at random."""
    limit = problem.state_limit
    for number in range(problem.solver.starts):
        guess = given[number % len(given)]
        if number < len(given):
            yield guess
            continue
        rng = np.random.default_rng(number)
        size = np.maximum(np.abs(guess.state).max(axis=0), units_of(problem, guess).state[: problem.n_x])
        tau = np.linspace(0.0, 1.0, max(41, len(guess.state)))
        at = np.linspace(0.0, 1.0, len(guess.state))
        state = np.column_stack([np.interp(tau, at, column) for column in guess.state.T])
        waves = np.sin(np.pi * np.outer(tau, 1 + np.arange(_WAVES)))
        bend = waves @ (rng.uniform(-1, 1, (_WAVES, problem.n_x)) / (1 + np.arange(_WAVES))[:, None])
        state = np.clip(state + _BEND * (1 + number // 4) * bend * size, limit[:, 0], limit[:, 1])
        low, high = problem.duration
        duration = float(np.clip(guess.duration_s * 2.0 ** rng.uniform(-1, 1), low, high))
        yield completed(problem, StateGuess(state=state, effort=guess.effort, duration_s=duration))


def _contradiction(problem: OdeProblem) -> str | None:
    """Return the sentence on a limit that no motion can keep, found without solving, or None."""
    for what, rows in (("start", problem.start), ("goal", problem.goal)):
        for name, (low, high), (least, most) in zip(problem.states, rows, problem.state_limit, strict=True):
            if low > most or high < least:
                asked = low if low > most else high
                return f"infeasible: {what} asks for {name} = {asked:g}, beyond its limits {least:g} to {most:g}"
    return None


def _explain(problem: OdeProblem, guess: StateGuess, history: list[Step], say: Say) -> OdePlan:
    """Return the plan of a problem that no start solved, with the least effort where that is the reason."""
    stopped = {
        OUT_OF_TIME: f"the solver ran out of its {problem.solver.max_time_s:g} s (solver.max_time_s)",
        INVALID: "the dynamics gave a number that is not finite (NaN), or the solver could not begin",
    }
    status = history[-1].solver_status if history else "nothing tried"
    reason = f"failed: {stopped.get(status, f'no start led to a solution ({status})')}"
    if status not in stopped and np.all(np.isfinite(problem.effort_limit)):
        say("no solution found; looking for the least effort that admits one")
        case = OdeCase(problem, problem, units_of(problem, guess))
        mesh, durations = uniform(problem.mesh.intervals), np.array([guess.duration_s])
        transcribed = case.transcribe(start_of(guess, case.units), mesh, durations, least_limit=True)
        solution = solve(transcribed, problem.solver)
        history.append(step_of("least effort limit", transcribed, solution))
        factor = float(solution.x[transcribed.program.layout.extra()][0])
        if solution.converged and factor > 1:
            found = f"efforts of {factor:.4g} times their limits are the least with which a motion was found"
            fixed = problem.duration[0] == problem.duration[1]
            # Where time is free a motion may gather way that no start has tried: what was found is no proof then.
            message = f"infeasible: {found}" if fixed else f"failed: no solution was found; {found}, which is no proof"
            status = "infeasible" if fixed else "failed"
            return OdePlan(problem=problem, status=status, message=message, history=tuple(history))
    return OdePlan(problem=problem, status="failed", message=reason, history=tuple(history))
