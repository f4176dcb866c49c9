"""Solving a program with IPOPT."""

import contextlib
import io
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from planner.collocation import Transcribed
from planner.problem import SolverSettings
from planner.program import Program

# Feasibility and optimality of the scaled program; the certificate then judges the motion itself.
TOLERANCE = 1e-10
MAX_ITERATIONS = 500
# IPOPT's word for it.
OUT_OF_TIME = "Maximum_WallTime_Exceeded"
INVALID = "Invalid_Number_Detected"


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


def build_solver(program: Program, settings: SolverSettings | None = None, *, warm: bool = False) -> ca.Function:
    """Return IPOPT for a program; a warm one begins next to the point and multipliers that it is given."""
    settings = settings or SolverSettings()
    iterations = MAX_ITERATIONS if settings.max_iterations is None else settings.max_iterations
    functions = program.functions
    options = {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.tol": TOLERANCE,
        "ipopt.constr_viol_tol": TOLERANCE,
        "ipopt.max_iter": iterations,
        "ipopt.max_wall_time": settings.max_time_s,
        # Limits are promises: IPOPT may not relax them by its customary 1e-8.
        "ipopt.bound_relax_factor": 0.0,
        "ipopt.honor_original_bounds": "yes",
        "grad_f": functions["grad_f"],
        "jac_g": functions["jac_g"],
        "hess_lag": functions["hess_lag"],
        # Derivatives are all given; CasADi is not to look for more of them through compiled functions.
        "no_nlp_grad": True,
        "calc_lam_p": False,
    }
    if warm:
        options |= {"ipopt.mu_init": 1e-4, "ipopt.bound_push": 1e-6, "ipopt.bound_frac": 1e-6}
    return ca.nlpsol("solver", "ipopt", functions["nlp"], options)


def solve(transcribed: Transcribed, settings: SolverSettings | None = None, *, warm: bool = False) -> Solution:
    """Return the solver's answer; never raises for a problem that has none."""
    begin = time.perf_counter()
    solver = build_solver(transcribed.program, settings, warm=warm)
    return run_solver(solver, transcribed, build_s=time.perf_counter() - begin)


def run_solver(solver: ca.Function, transcribed: Transcribed, *, build_s: float = 0.0) -> Solution:
    """Return a built solver's answer to a program's numbers, from its starting point."""
    begin = time.perf_counter()
    with _interruptible(), contextlib.redirect_stderr(io.StringIO()):  # what CasADi says there, the status says too
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
def _interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt at the end of a solve that Ctrl-C cut short: CasADi only stops the solver for it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    interrupted: list[int] = []

    def remember(number: int, frame: object) -> None:
        del frame
        interrupted.append(number)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if interrupted:
        raise KeyboardInterrupt
