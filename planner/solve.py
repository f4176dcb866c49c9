"""Solving a program with IPOPT, or with FATROP where that is asked for."""

import contextlib
import io
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from models.errors import ProblemError, one_line
from planner.collocation import Transcribed
from planner.fatrop import FatropSolver
from planner.problem import SOLVERS, SolverSettings
from planner.program import Program
from planner.solver import ACCEPTABLE, INVALID, MAX_ITERATIONS, OUT_OF_TIME, TOLERANCE, Solver
from planner.system import Endpoint

__all__ = ["INVALID", "OUT_OF_TIME", "Solution", "build_solver", "run_solver", "solve"]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Solution:
    """What a solver answered to which program: unknowns, whether a local optimum, its words, the time it took [s]."""

    transcribed: Transcribed
    x: np.ndarray
    objective: float
    converged: bool
    status: str
    iterations: int
    build_s: float
    solve_s: float


def build_solver(
    program: Program, settings: SolverSettings | None = None, *, warm: bool = False, endpoint: Endpoint | None = None
) -> Solver:
    """Return the solver that settings ask for; a warm one begins next to the point that it is given.

    Args:
        program: what to solve.
        settings: by which solver, and how long.
        warm: whether it begins next to an answer.
        endpoint: the program's, where it has one.

    Raises:
        ProblemError: when the solver cannot be set up for the program.
    """
    settings = settings or SolverSettings()
    if settings.name not in SOLVERS:
        raise ProblemError(f"solver.name is one of {', '.join(SOLVERS)}, got '{settings.name}'")
    iterations = MAX_ITERATIONS if settings.max_iterations is None else settings.max_iterations
    try:
        if settings.name == "fatrop":
            return FatropSolver(program, endpoint, max_iterations=iterations, max_time_s=settings.max_time_s, warm=warm)
        return _ipopt(program, iterations, settings.max_time_s, warm=warm)
    except RuntimeError as error:
        raise ProblemError(f"solver '{settings.name}' cannot be set up: {one_line(error)}") from error


def _ipopt(program: Program, iterations: int, max_time_s: float, *, warm: bool) -> ca.Function:
    functions = program.functions
    options = {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.tol": TOLERANCE,
        "ipopt.constr_viol_tol": TOLERANCE,
        # What it calls acceptable where it can do no better must be a motion all the same: by default a row may be off
        # by 0.01.
        "ipopt.acceptable_constr_viol_tol": ACCEPTABLE,
        "ipopt.acceptable_compl_inf_tol": ACCEPTABLE,
        "ipopt.max_iter": iterations,
        "ipopt.max_wall_time": max_time_s,
        # Limits are promises: IPOPT may not relax them by its customary 1e-8.
        "ipopt.bound_relax_factor": 0.0,
        "ipopt.honor_original_bounds": "yes",
        "grad_f": functions["grad_f"],
        "jac_g": functions["jac_g"],
        "hess_lag": functions["hess_lag"],
        # Derivatives are all given; CasADi is not to look for more of them through compiled functions.
        "no_nlp_grad": True,
        # A function that gives NaN ends in a status; what CasADi has to say to it belongs nowhere.
        "show_eval_warnings": False,
        "calc_lam_p": False,
    }
    if warm:
        options |= {"ipopt.mu_init": 1e-4, "ipopt.bound_push": 1e-6, "ipopt.bound_frac": 1e-6}
    return ca.nlpsol("solver", "ipopt", functions["nlp"], options)


def solve(transcribed: Transcribed, settings: SolverSettings | None = None, *, warm: bool = False) -> Solution:
    """Return the solver's answer; never raises for a problem that has none."""
    begin = time.perf_counter()
    solver = build_solver(transcribed.program, settings, warm=warm, endpoint=transcribed.formulation.endpoint)
    return run_solver(solver, transcribed, build_s=time.perf_counter() - begin)


def run_solver(solver: Solver, transcribed: Transcribed, *, build_s: float = 0.0) -> Solution:
    """Return a built solver's answer to a program's numbers, from its starting point."""
    begin = time.perf_counter()
    with (
        _interruptible() as interrupted,
        contextlib.redirect_stderr(io.StringIO()),
    ):  # what CasADi says there, the status says too
        if isinstance(solver, FatropSolver):
            solver.watch(interrupted)
        result = solver(
            x0=transcribed.start,
            p=transcribed.parameters,
            lbx=transcribed.lower,
            ubx=transcribed.upper,
            lbg=transcribed.row_lower,
            ubg=transcribed.row_upper,
        )
    stats = solver.stats()
    return Solution(
        transcribed=transcribed,
        x=np.array(result["x"]).ravel(),
        objective=float(result["f"]) * transcribed.objective_scale,
        converged=bool(stats["success"]),
        status=str(stats["return_status"]),
        iterations=int(stats["iter_count"]),
        build_s=build_s,
        solve_s=time.perf_counter() - begin,
    )


@contextlib.contextmanager
def _interruptible() -> Iterator[list[int]]:
    """Raise KeyboardInterrupt at the end of a solve that Ctrl-C cut short: CasADi only stops the solver for it."""
    interrupted: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield interrupted
        return

    def remember(number: int, frame: object) -> None:
        del frame
        interrupted.append(number)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, remember)
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, before)
    if interrupted:
        raise KeyboardInterrupt
