"""Repeated planning with one program, which is built once and solved with new numbers from the last solution.

    planner = Replanner()
    for goal in goals:
        plan = planner.plan(problem.replace(goal_deg=goal))

Payload, boundary states, waypoints, limits, durations, references and weights are parameters of a program; they need no new
program. A problem is planned from the beginning if its structure differs (mechanism, kind, objective terms, mesh, which
limits are finite), or if the warm solve gives no optimal plan by the usual checks (certificate, contacts, tolerance).

At the rate of control, a motion follows from the last plan by a few Newton steps, with error bounds.
"""

import contextlib
import threading
import time
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from linkplan.models.deadline import OutOfTimeError, one_thread_at_a_time
from linkplan.planner.closed_chain.case import case_of, finished
from linkplan.planner.closed_chain.transcribe import is_program_of, own_objective, renumbered, trajectory_of
from linkplan.planner.limits.kinds import effort_bounds, structure_of
from linkplan.planner.plan.plan import MotionTable, Plan, sample_motion
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import Say, add_step, recorded, recording, silent, step_of
from linkplan.planner.refinement.switches import bounded_by_guess
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.presolve import plain_contradiction
from linkplan.planner.solvers.newton import Conditions, NewtonStep, Optimum, conditions_of, newton_step
from linkplan.planner.solvers.solve import Solution, Solver, build_solver, run_solver
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.program import Program


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class NextMotion:
    """A nearly optimal motion, a few Newton steps from the last one: not certified, but with bounds on its error.

    `position_bound_rad`, `velocity_bound_rad_s` (n_s,) and `effort_bound` (n_u,) [N.m or N] bound the differences
    from the optimal motion on the same mesh: of positions and velocities at the mesh's nodes, and of the efforts' Bernstein
    coefficients, hence of efforts everywhere. They are infinite if no bound is known. `newton_s` is the processing time [s]
    of the steps.
    """

    problem: Problem
    trajectory: Trajectory
    position_bound_rad: np.ndarray
    velocity_bound_rad_s: np.ndarray
    effort_bound: np.ndarray
    duration_error_s: float
    violation: float
    """The largest violation of a row of the program (dynamics, loops, limits), scaled to order one."""
    newton_s: float
    settled: bool
    """Whether the Newton steps converge, so that the bounds hold; if not, call `plan`."""

    @property
    def duration_s(self) -> float:
        """The duration of the motion [s]."""
        return self.trajectory.duration_s

    @property
    def position_error_deg(self) -> dict[str, float]:
        """A bound, by independent joint, on the error [deg or m] of positions at nodes from the optimum on this mesh."""
        joints = self.problem.mechanism.independent_joints
        return {j.name: float(j.shown(x)) for j, x in zip(joints, self.position_bound_rad, strict=True)}

    @property
    def effort_error(self) -> dict[str, float]:
        """A bound, by actuator, on the error [N.m or N] of the effort at any instant from the optimum on this mesh."""
        actuators = self.problem.mechanism.actuators
        return {a.name: float(x) for a, x in zip(actuators, self.effort_bound, strict=True)}

    def sample(self, time_s: float | np.ndarray | None = None) -> MotionTable:
        """Return the motion at times (n,) or a time [s], like `Plan.sample`; by default at ten instants of every interval.

        Raises:
            LinkplanError: if the loops do not close along the motion, or a time is not finite.
        """
        return sample_motion(self.problem, self.trajectory, time_s)

    def __repr__(self) -> str:
        joint, error = next(iter(self.position_error_deg.items()))
        return f"NextMotion({self.problem.name!r}, {self.duration_s:.6g} s, {joint} within {error:.2g})"


def motion_step(problem: Problem, numbered: Transcribed, found: NewtonStep, newton_s: float) -> NextMotion:
    """Return a Newton step of a problem's program as a motion, with error bounds in SI units."""
    units, n_s, error = numbered.units, numbered.formulation.n_s, found.error_bound
    return NextMotion(
        problem=problem,
        trajectory=trajectory_of(numbered, found.optimum.x),
        position_bound_rad=error * units.state[:n_s],
        velocity_bound_rad_s=error * units.state[n_s : 2 * n_s],
        effort_bound=error * units.effort,
        duration_error_s=error * units.time_s * numbered.program.layout.n_segments,
        violation=found.violation,
        newton_s=newton_s,
        settled=bool(error < 0.1),  # scaled unknowns are of order one
    )


class Replanner:
    """A planner that keeps its last program; `plan` has the results of `plan_motion`, but is often faster.

    Threads that share a planner wait for each other, because its solver is not reentrant. `plan` waits for the plans of all
    other threads as well (CasADi); `step` does not. A copy is a new planner without programs and solvers.
    """

    def __init__(self, say: Say = silent) -> None:
        self._say = say
        self._lock = threading.RLock()
        self._key: tuple | None = None
        self._held_at: np.ndarray | None = None  # the effort limits in the last program's bang arcs
        self._last: Transcribed | None = None
        self._solver: Solver | None = None
        self._program: Program | None = None
        self._conditions: Conditions | None = None
        self._optimum: Optimum | None = None  # of the last program at its `start`; None until computed

    def __reduce__(self) -> tuple:
        return Replanner, ()

    def plan(self, problem: Problem) -> Plan:
        """Return the plan of a problem.

        Raises:
            ProblemError: when start, goal or reference contradict the mechanism.
        """
        with self._lock:
            begun, plan = problem.varied(solver=problem.solver.begun()), None
            with contextlib.suppress(OutOfTimeError), recording():
                again = self.solve_again(begun)
                plan = None if again is None else self._certified(begun, again)
            if plan is None:
                plan = plan_motion(begun, self._say)
                if plan.passed and plan.solved is not None:
                    self._keep(problem, plan.solved)
            return replace(plan, problem=problem)

    def solve_again(self, problem: Problem) -> Solution | None:
        """Return a warm solve of the kept program with a problem's numbers; None if it does not apply or converge.

        The motion is not certified; `plan` does that.
        """
        with self._lock:
            kept = self._fitting(problem)
            if kept is None:
                return None
            solver, last = kept
            solution = run_solver(solver, renumbered(last, problem, last.start))
        return solution if solution.converged and not _is_blocked_by_bounds(problem, solution) else None

    def step(self, problem: Problem) -> NextMotion | None:
        """Return the motion after three Newton steps, with one factorisation, from the last plan, and its error bounds.

        This is for replanning at the rate of control (real-time iteration). It takes a quarter of a plan's time, the same in
        every call except the first, and makes no certificate. The next step begins at this motion; if no error bound is
        known (`settled` is False), it begins where this step began.

        Returns:
            The motion; None if the last plan's program does not fit the problem, which then needs `plan`.

        Raises:
            ProblemError: when start or goal contradict the mechanism.
        """
        with self._lock:
            kept = self._fitting(problem)
            if kept is None:
                return None
            solver, last = kept
            if self._optimum is None:  # once after each plan from the beginning
                last = self._keep_optimum(run_solver(solver, last))
            if self._optimum is None:
                return None
            problem.start_pose()  # raises if a pose is out of reach
            numbered = renumbered(last, problem, last.start)
            begin = time.perf_counter()
            # Three steps are the fewest that give an error bound.
            found = newton_step(self._conditions_of(last), last, self._optimum, numbered, most=3)
            step = motion_step(problem, numbered, found, time.perf_counter() - begin)
            if step.settled:
                self._last, self._optimum = replace(numbered, start=found.optimum.x), found.optimum
            return step

    def _fitting(self, problem: Problem) -> tuple[Solver, Transcribed] | None:
        """Return the kept solver and program if they have the structure of a problem."""
        if self._last is None or self._solver is None or structure(problem) != self._key:
            return None
        # Bang arcs contain the old limits.
        fits = self._held_at is None or np.array_equal(effort_bounds(problem), self._held_at)
        return (self._solver, self._last) if fits else None

    def _conditions_of(self, last: Transcribed) -> Conditions:
        if self._conditions is None:
            self._conditions = conditions_of(last.program)
        return self._conditions

    def _keep_optimum(self, solution: Solution) -> Transcribed:
        """Keep a solution as the next starting point, and return it."""
        last = self._last = replace(solution.transcribed, start=solution.x)
        rows, bounds = solution.multipliers, solution.bound_multipliers
        self._optimum = None
        if solution.converged and rows is not None and bounds is not None:
            self._optimum = Optimum(x=solution.x, rows=rows, bounds=bounds)
        return last

    @one_thread_at_a_time
    def _certified(self, problem: Problem, solution: Solution) -> Plan | None:
        """Return the plan of a warm solution, or None if the problem must be planned from the beginning."""
        problem.start_pose()  # raises if a pose is out of reach
        if plain_contradiction(problem) is not None:
            return None
        case = case_of(problem)
        while True:
            trajectory = case.motion(solution)
            certificate = None if trajectory is None else case.certify(trajectory)
            if trajectory is None or certificate is None:
                return None
            step = step_of("constraints tightened" if recorded() else "solved again", solution.transcribed, solution)
            add_step(structs.replace(step, integration_error_deg=certificate.integration_error_deg))
            if not case.error_report(certificate).overruns or case.n_tightenings == 2:
                break  # a motion that still overruns its limits is planned from the beginning
            # Tightening starts again from zero, because the kept program's tightening belongs to another motion.
            case = case.tightened(certificate, trajectory)
            assert self._solver is not None  # of the first solution
            assert self._last is not None
            solution = run_solver(self._solver, renumbered(self._last, case.problem, solution.x, case.tightenings))
            if not solution.converged or _is_blocked_by_bounds(problem, solution):
                return None
        objective = own_objective(solution.transcribed, solution.objective, trajectory)
        plan = finished(problem, trajectory, certificate, objective, None)
        if not plan.passed:
            return None
        self._keep_optimum(solution)
        return replace(plan, solved_again=True)

    def _keep(self, problem: Problem, solved: Transcribed) -> None:
        if not is_program_of(solved, problem):
            return  # for example because its motion is away from another limit
        self._last, self._key, self._optimum = solved, structure(problem), None
        self._held_at = None if solved.bang_efforts is None else effort_bounds(problem)
        if solved.program is not self._program:
            self._program, self._conditions = solved.program, None
            self._solver = build_solver(solved.program, problem.solver, warm=True)


def _is_blocked_by_bounds(problem: Problem, solution: Solution) -> bool:
    """Check if bounds from the last motion prevent the optimum of the new one.

    A duration may be at its bound from the guess, or a switch time may have moved as far as it can; the segments then do not
    fit the new motion.
    """
    motion, transcribed = problem.motion, solution.transcribed
    shortest, longest = motion.min_duration_s or 0.0, motion.max_duration_s or np.inf
    if motion.duration_s is None and bounded_by_guess(solution, shortest, longest) is not None:
        return True
    place = transcribed.program.layout.durations()
    if len(place) == 1:
        return False
    low, high, at = transcribed.lower[place], transcribed.upper[place], solution.x[place]
    return bool(np.any((np.minimum(at - low, high - at) < 1e-6 * at) & (high > low)))


def structure(problem: Problem) -> tuple:
    """Return the structure of a problem's program: problems with equal structures differ in numbers only."""
    motion = problem.motion
    given = tuple(x is None for x in (motion.start, motion.goal, motion.duration_s, motion.max_duration_s))
    given += (None if motion.turns is None else tuple(motion.turns.tolist()),)
    via = tuple(
        (
            *(np.isnan(w.position).tobytes(), np.isnan(w.speed).tobytes(), w.time_s is None),
            *((index, axis) for index, axis, _ in w.open_coordinates),
        )
        for w in motion.waypoints
    )
    ends = (tuple((type(task), task.index) for task in motion.goal_at), motion.goal_rows)
    extra = tuple(one.expression for one in problem.objective.extra)
    mesh = (problem.mesh.scheme, problem.mesh.intervals, problem.mesh.effort, repr(problem.mesh.breaks))
    terms = tuple(problem.objective.weights)
    if problem.objective.has("peak_effort"):  # whose rows have the limits as coefficients
        terms += (effort_bounds(problem).tobytes(), *problem.objective.weights.values())
    of = (
        problem.mechanism.fingerprint(parameters_apart=True),
        motion.kind,
        problem.free_at_end.tobytes(),
        terms,
        problem.reference is None,
    )
    limits = structure_of(problem)
    return (*of, limits, extra, ends, given, motion.min_duration_s is None, via, mesh)
