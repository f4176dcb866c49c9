"""A user's differential equation as a case for refinement: its formulation, units, starts, motions and their errors."""

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from linkplan.planner.limits.limit import LimitedRow, WhichJoints, limited_rows
from linkplan.planner.ode.certificate import (
    INTEGRATION_SHARE,
    OBJECTIVE_ERROR_FACTOR,
    OVERRUN_SHARE,
    PATH,
    OdeCertificate,
    certify_ode,
    running_cost,
)
from linkplan.planner.ode.problem import OdeProblem, StateGuess
from linkplan.planner.problem.limits import free_bounds
from linkplan.planner.refinement.case import ErrorReport, RefinementTarget, error_report
from linkplan.planner.refinement.marking import Tightening, tightening_over, tightenings_of
from linkplan.planner.solvers.solve import Solution
from linkplan.planner.transcription.bernstein import PiecewisePolynomial
from linkplan.planner.transcription.collocation import Curves, Transcribed, collocate, curves_of
from linkplan.planner.transcription.formulation import Formulation, PhaseBoundary, Start, Units
from linkplan.planner.transcription.interval import IntervalRows
from linkplan.planner.transcription.mesh import Mesh
from linkplan.planner.transcription.schemes import scheme
from linkplan.planner.transcription.system import Endpoint, System, node_symbols

# The smallest unit: a smaller one would enlarge a state that does not matter.
_MIN_UNIT = 1e-8
# The objective is refined to this share if the user gives no tolerance and that is cheap.
_OBJECTIVE_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class OdeCase:
    """A `planner.refinement.case.Case` of a user's problem, whose path limits may be tightened.

    If f, L or c depends on time, `units` have one more state than the problem: time is then the last state of the program.
    """

    problem: OdeProblem
    units: Units
    tightenings: tuple[Tightening, ...] = ()

    @property
    def target(self) -> RefinementTarget:
        """The form of the best motion, of which little is known, and the required accuracy."""
        problem = self.problem
        return RefinementTarget(
            effort_limit=problem.effort_limit,
            switches=bool(np.any(np.all(np.isfinite(problem.effort_limit), axis=1))),  # then efforts can jump
            strictness=INTEGRATION_SHARE / problem.tolerance,
            tolerance_given=True,  # the mesh may become very fine
            objective_tolerance=problem.objective_tolerance or _OBJECTIVE_TOLERANCE,
            objective_tolerance_given=problem.objective_tolerance is not None,
        )

    def transcribe(
        self, start: Start, mesh: Mesh, durations: np.ndarray, *, position_rows: WhichJoints = False, **arcs: Any
    ) -> Transcribed:
        """Return the program from a start; with `position_rows`, rows keep limited states between the nodes."""
        settings, solver = self.problem.mesh, self.problem.solver
        formulation, chosen = self.formulation(state_rows=bool(position_rows)), scheme(settings.scheme, settings.effort)
        how = {"compile_mode": solver.compile, "deadline": solver.deadline}
        return collocate(formulation, chosen, mesh, durations, start, **how, **arcs)

    def formulation(self, *, state_rows: bool = False) -> Formulation:
        """Return the problem's formulation; with `state_rows`, rows keep limited states between the nodes."""
        problem, unit = self.problem, self.units.state[:, None]
        clock, p, path = len(unit) - problem.n_x, problem.parameters, problem.path_limit
        state = np.vstack([problem.state_limit, free_bounds(clock)]) / unit
        start = np.vstack([problem.start, np.zeros((clock, 2))]) / unit
        goal = np.vstack([problem.goal, free_bounds(clock)]) / unit
        limited, rows = limited_rows(state), [LimitedRow(PATH, k) for k in range(len(path))]
        # The nodes carry as many equalities as they can; inequalities that depend on efforts hold at open ends, too.
        jumping = np.unique(problem.functions["path"].sparsity_jac(1, 0).get_triplet()[0]).astype(int)
        open_end_path = tuple(int(i) for i in jumping if path[i, 0] < path[i, 1])
        low, high = (bound / self.units.time_s for bound in problem.duration)
        return Formulation(
            build_system=self._system,
            n_x=len(unit),
            n_u=problem.n_u,
            rows=IntervalRows(state_columns=tuple(limited) if state_rows else (), open_end_path=open_end_path),
            units=self.units,
            state=state,
            effort=problem.effort_limit,
            path=path,
            own={"state": state[limited]},
            boundaries=(PhaseBoundary(state=start, time=(0.0, 0.0)), PhaseBoundary(state=goal, time=(low, high))),
            returns=tuple(problem.returns),
            theta=lambda times: np.broadcast_to(p, (*times.shape, len(p))),
            tightening=tightening_over(self.tightenings, rows, path) if self.tightenings else None,
            endpoint=self._endpoint(),
            endpoint_bounds=problem.ends_limit,
            endpoint_parameters=p,
        )

    def _system(self) -> System:
        functions, n, units = self.problem.functions, self.problem.n_x, self.units
        n_state, T, X = len(units.state), units.time_s, ca.DM(units.state)
        node, p = node_symbols(0, n_state, 0, self.problem.n_u), ca.SX.sym("p", len(self.problem.parameters))
        x = node.x * X
        at = (x[:n], node.u * ca.DM(units.effort), p, x[n] if n_state > n else ca.SX(0))
        rate = ca.vertcat(functions["rate"](*at), ca.SX.ones(n_state - n))  # that of time is one
        path = functions["path"](*at)
        # The program multiplies by an interval's scaled width, and the objective by its unit.
        running = functions["running_cost"](*at) * T / units.objective
        column = ca.densify(ca.vertcat(node.r - rate * T / X, path, running))
        return System(
            n_x=n_state,
            n_u=self.problem.n_u,
            node=ca.Function("node", [node.stacked, p], [column]),
            n_equations=n_state,
            n_path=path.numel(),
            kinds=("dynamics",) * n_state + ("path",) * path.numel(),
        )

    def _endpoint(self) -> Endpoint:
        functions, n, units, X = self.problem.functions, self.problem.n_x, self.units, ca.DM(self.units.state)
        sizes = {"first": len(units.state), "last": len(units.state), "T": 1, "p": len(self.problem.parameters)}
        first, last, T, p = symbols = [ca.SX.sym(name, size) for name, size in sizes.items()]
        at = ((first * X)[:n], (last * X)[:n], T * units.time_s, p)
        column = ca.vertcat(functions["ends"](*at), functions["final_cost"](*at) / units.objective)
        return Endpoint(function=ca.Function("endpoint", symbols, [column]), n_rows=column.numel() - 1)

    def motion(self, solution: Solution) -> Curves:
        """Return a solution's polynomials; if time is a state of the program, it is left out."""
        curves = curves_of(solution.transcribed, solution.x, self.problem.effort_limit)
        motion = replace(curves, state=curves.state[..., : self.problem.n_x])
        return replace(motion, running=running_cost(self.problem, motion, solution.transcribed.scheme))

    def start_from(self, motion: Curves) -> Start:
        """Return a motion as a scaled start on any mesh."""
        units, clock = self.units, len(self.units.state) - self.problem.n_x

        def nodes(at: np.ndarray):
            rates = np.column_stack([motion.rate_at(at), np.ones((len(at), clock))]) / units.state * units.time_s
            return np.zeros((len(at), 0)), rates, np.zeros((len(at), 0)), motion.effort_at(at)

        def states(at: np.ndarray) -> np.ndarray:
            return np.column_stack([motion.state_at(at), *[at] * clock]) / units.state

        return Start(states=states, nodes=nodes)

    def certify(self, motion: Curves) -> OdeCertificate:
        """Return a motion's certificate."""
        return certify_ode(self.problem, motion)

    def error_report(self, certificate: OdeCertificate) -> ErrorReport:
        """Return the errors that a certificate reports; another mesh may remove each of them."""
        tolerance = self.problem.tolerance
        return error_report(
            certificate,
            # The objective is to be that of the integrated motion, too.
            exact=certificate.integration_error <= tolerance
            and certificate.objective_error <= OBJECTIVE_ERROR_FACTOR * tolerance
            and certificate.overrun <= OVERRUN_SHARE,
            repairable=not certificate.passed,
            leaves_positions=any(margin.what == "state" and not margin.kept for margin in certificate.margins),
            touching=certificate.touching,
            integration_error=certificate.integration_error,
        )

    def tightened(self, certificate: OdeCertificate, motion: Curves) -> "OdeCase":
        """Return the case with path limits tightened by a motion's excess over them. Rows satisfy the limits of states."""
        return replace(self, tightenings=self.tightenings + tightenings_of(certificate.margins, motion.breaks_s))


def case_of(problem: OdeProblem, guess: Curves) -> OdeCase:
    """Return the case with its units: the largest values of guess and ends, else of limits, and the cost of the guess."""
    times, duration, limit = guess.breaks_s, guess.duration_s, problem.effort_limit
    x, u = guess.state_at(times), guess.effort_at(times)
    effort = _first_size(np.minimum(np.abs(u.T), np.abs(limit).max(axis=1, keepdims=True)), limit)
    state = _first_size(np.hstack([problem.start, problem.goal, x.T]), np.diff(problem.state_limit, axis=1))
    # The cost of a motion of these sizes: of the guess, with efforts of their unit where it has none.
    u = np.where(np.any(u, axis=0), u, effort)
    cost = duration * np.abs(problem.along("running_cost", x, u, times)).mean()
    cost += abs(problem.at_ends("final_cost", x[0], x[-1], duration)[0])
    timed = any(problem.functions[name].sparsity_jac(3, 0).nnz() for name in ("rate", "running_cost", "path"))
    units = Units(
        time_s=duration,
        state=np.append(state, duration) if timed else state,
        effort=effort,
        objective=float(_first_size(np.array([[cost]]))[0]),
    )
    return OdeCase(problem, units)


def _first_size(*candidates: np.ndarray) -> np.ndarray:
    """Return the largest finite size (n,) in each row of the first candidate (n, m) that is no rounding, else 1."""
    sizes = [np.where(np.isfinite(rows), np.abs(rows), 0.0).max(axis=1, initial=0.0) for rows in candidates]
    return np.select([size > _MIN_UNIT for size in sizes], sizes, 1.0)


def guesses_of(problem: OdeProblem) -> list[Curves]:
    """Return the given guesses, then the straight line between the given values of start and goal.

    Each consists of straight lines through the guess's rows, completed by efforts and a duration where it has none.
    """
    ends = zip(problem.start, problem.goal, strict=True)
    line = np.array([[_middle(row, _middle(other, 0.0)) for row, other in (end, end[::-1])] for end in ends])
    line = np.clip(np.linspace(line[:, 0], line[:, 1], 21), *problem.state_limit.T)
    low, high = problem.duration
    usual_s = 0.5 * (low + high) if high < 100 * low else 1.0
    middles, found = [[_middle(row, 0.0) for row in problem.effort_limit]] * 2, []
    for guess in (*problem.guesses, StateGuess(state=line)):
        both = guess.state, np.array(middles) if guess.effort is None else guess.effort
        shares = np.linspace(0.0, 1.0, max(map(len, both)))
        lines = [PiecewisePolynomial(np.stack([y[:-1], y[1:]]), np.linspace(0.0, 1.0, len(y)))(shares) for y in both]
        state, effort = (np.stack([y[:-1], y[1:]]) for y in lines)
        duration = np.clip(usual_s if guess.duration_s is None else guess.duration_s, low, high)
        found.append(Curves(breaks_s=duration * shares, state=state, effort=effort))
    return found


def _middle(row: np.ndarray, otherwise: float) -> float:
    """Return the middle of [low, high], its finite end if only one is finite, or `otherwise` if none is."""
    finite = row[np.isfinite(row)]
    return float(finite.mean()) if len(finite) else otherwise
