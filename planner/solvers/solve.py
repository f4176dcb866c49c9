"""Solving a program with IPOPT."""

import contextlib
import io
import threading
import time
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from linkplan.models.deadline import NO_DEADLINE
from linkplan.models.errors import ProblemError, one_line
from linkplan.models.interrupts import asked, solving
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.solvers.outcome import (
    ACCEPTABLE,
    INVALID,
    MAX_ITERATIONS,
    OUT_OF_ITERATIONS,
    OUT_OF_TIME,
    TOLERANCE,
    Solver,
)
from linkplan.planner.transcription.collocation import Transcribed, with_compiled_code
from linkplan.planner.transcription.compiled import compiler
from linkplan.planner.transcription.program import Program

__all__ = ["INVALID", "OUT_OF_TIME", "Solution", "build_solver", "run_solver", "solve"]

# From this many intervals on MUMPS does without its matching of rows to columns, whose time grows with the square of their
# number: measured at 2,000 intervals, three quarters of a solve. Smaller programs keep it for its better pivots.
_LARGE = 200
# How near its end a warm solve begins, and how far its point is pushed off bounds that hold it: next to an answer with its
# multipliers, four iterations do where a barrier of 1e-4 took five; nearer yet, limits that come to bind take twice as long.
_WARM_BARRIER, _WARM_PUSH = 1e-6, 1e-9
# The same without multipliers: near an answer, at one but for its mesh, from which a larger barrier leads away, and at one
# that a few intervals more hardly change: along a limit that a motion slides about on, at no cost to speak of, 9 to 40
# iterations do where a barrier of 1e-6 took 33 to more than 500.
_NEAR_BARRIER, _AT_BARRIER, _ON_BARRIER = 1e-4, 1e-6, 1e-9
# Nodes times iterations that take as long interpreted as compiling takes, measured on four-bars: 0.06 ms and 0.5 s. And the
# fewest iterations before a solve is begun again.
_WORTH_COMPILING, _FEWEST = 8000, 20
# IPOPT's own limit on time [s] is positive: with less it stops after an iteration.
_LEAST_TIME_S = 1e-3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Solution:
    """A solver's result for a program: unknowns, whether a local optimum, its status in words, the time it took [s].

    `multipliers` (n_rows,) are the rows', of f + multipliers g, `bound_multipliers` (n,) the unknowns' own; None
    without an answer.
    """

    transcribed: Transcribed
    x: np.ndarray
    objective: float
    converged: bool
    status: str
    iterations: int
    build_s: float
    solve_s: float
    multipliers: np.ndarray | None = None
    bound_multipliers: np.ndarray | None = None


def build_solver(
    program: Program,
    settings: SolverSettings | None = None,
    *,
    warm: bool = False,
    close: bool = False,
) -> Solver:
    """Return IPOPT for a program; a warm one begins next to the point that it is given.

    Args:
        program: what to solve.
        settings: how many iterations, and how long.
        warm: whether it begins next to an answer.
        close: whether that is the answer itself but for another mesh; both, whether it is so nearly to the last digit.

    Raises:
        ProblemError: when the solver cannot be set up for the program.
    """
    settings = settings or SolverSettings()
    iterations = MAX_ITERATIONS if settings.max_iterations is None else settings.max_iterations
    try:
        return _ipopt(program, iterations, settings, warm=warm, close=close)
    except RuntimeError as error:
        raise ProblemError(f"IPOPT cannot be set up: {one_line(error)}") from error


def _ipopt(program: Program, iterations: int, settings: SolverSettings, *, warm: bool, close: bool) -> Solver:
    functions, left_s = program.functions, settings.deadline.within(settings.max_time_s).left_s
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
        # IPOPT counts the time of all threads. The callback counts this one's, after each iteration.
        "ipopt.max_cpu_time": max(_LEAST_TIME_S, left_s * threading.active_count()),
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
    if program.mesh.n_intervals >= _LARGE:
        options["ipopt.mumps_permuting_scaling"] = 0
    if not (warm or close):
        return _Ipopt(functions["nlp"], options, settings)
    barrier = _AT_BARRIER if close else _NEAR_BARRIER
    near = options | {"ipopt.mu_init": _ON_BARRIER if warm and close else barrier}
    near |= {f"ipopt.{push}": 0.01 * barrier for push in ("bound_push", "bound_frac")}
    pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
    again = options | {"ipopt.warm_start_init_point": "yes", "ipopt.mu_init": _WARM_BARRIER}
    again |= {f"ipopt.warm_start_{push}": _WARM_PUSH for push in pushes}
    return _WarmIpopt(functions["nlp"], near, again, settings)


class _Watch(ca.Callback):
    """What IPOPT asks after every iteration: one where a signal asks this process to end, or the deadline has passed."""

    def __init__(self) -> None:
        ca.Callback.__init__(self)
        self.deadline, self.late = NO_DEADLINE, False
        self.construct("watch", {})

    def get_n_in(self) -> int:
        """Return how many things CasADi has to tell of an iteration."""
        return ca.nlpsol_n_out()

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return that nothing of them is wanted."""
        del i
        return ca.Sparsity(0, 0)

    def get_n_out(self) -> int:
        """Return how many answers there are."""
        return 1

    def eval(self, arg: list) -> list:
        """Return whether to stop."""
        del arg
        self.late = self.deadline.passed
        return [float(self.late or asked() is not None)]


class _Ipopt:
    """IPOPT with the callback that stops it, which CasADi itself does not keep alive."""

    def __init__(self, nlp: ca.Function, options: dict[str, Any], settings: SolverSettings) -> None:
        self._watch, self._settings = _Watch(), settings
        self._solver = ca.nlpsol("solver", "ipopt", nlp, options | {"iteration_callback": self._watch})

    def __call__(self, **numbers: Any) -> Any:
        """Return the answer, "x", "f" and multipliers."""
        self._watch.deadline, self._watch.late = self._settings.deadline.within(self._settings.max_time_s), False
        return self._solver(**numbers)

    def stats(self) -> dict[str, Any]:
        """Return what there is to say of the last answer."""
        stats = self._solver.stats()
        return stats | {"return_status": OUT_OF_TIME} if self._watch.late else stats


class _WarmIpopt:
    """IPOPT that begins next to the point that it is given, and from its second answer on from the last multipliers."""

    def __init__(self, nlp: ca.Function, near: dict[str, Any], again: dict[str, Any], settings: SolverSettings) -> None:
        self._solver = self._near = _Ipopt(nlp, near, settings)
        self._build = lambda: _Ipopt(nlp, again, settings)
        self._again: _Ipopt | None = None
        self._multipliers: dict[str, ca.DM] = {}

    def __call__(self, **numbers: Any) -> Any:
        """Return the answer, "x" and "f"."""
        if self._multipliers and self._again is None:
            self._again = self._build()
        self._solver = self._again if self._multipliers and self._again is not None else self._near
        result = self._solver(**numbers, **self._multipliers)
        good = self._solver.stats()["success"]
        self._multipliers = {"lam_x0": result["lam_x"], "lam_g0": result["lam_g"]} if good else {}
        return result

    def stats(self) -> dict[str, Any]:
        """Return what there is to say of the last answer."""
        return self._solver.stats()


def solve(
    transcribed: Transcribed, settings: SolverSettings | None = None, *, warm: bool = False, close: bool = False
) -> Solution:
    """Return the solver's answer, begun as in `build_solver`; never raises for a problem that has none.

    One that takes long on interpreted functions is given up for compiled ones, which lead it the same way, only sooner.
    """
    settings = settings or SolverSettings()
    first = _patience(transcribed, settings)
    if first is not None:
        solution = _solved(transcribed, replace(settings, max_iterations=first), warm=warm, close=close)
        if solution.status != OUT_OF_ITERATIONS:
            return solution
        transcribed = with_compiled_code(transcribed, settings.deadline)
    return _solved(transcribed, settings, warm=warm, close=close)


def _patience(transcribed: Transcribed, settings: SolverSettings) -> int | None:
    """Return the iterations after which compiling costs less than to go on interpreted; None where that is no question."""
    interval = transcribed.program.interval
    if interval.compiled or settings.compile != "auto" or compiler() is None:
        return None
    few = max(_FEWEST, _WORTH_COMPILING // (transcribed.program.mesh.n_intervals * interval.n_nodes))
    return few if few < (MAX_ITERATIONS if settings.max_iterations is None else settings.max_iterations) else None


def _solved(transcribed: Transcribed, settings: SolverSettings, *, warm: bool, close: bool) -> Solution:
    begin = time.perf_counter()
    solver = build_solver(transcribed.program, settings, warm=warm, close=close)
    return run_solver(solver, transcribed, build_s=time.perf_counter() - begin)


def run_solver(solver: Solver, transcribed: Transcribed, *, build_s: float = 0.0) -> Solution:
    """Return a built solver's answer to a program's numbers, from its starting point.

    Raises:
        KeyboardInterrupt: when a signal stopped the solver.
    """
    begin = time.perf_counter()
    with solving(), _unheard():
        try:
            result = solver(
                x0=transcribed.start,
                p=transcribed.parameters,
                lbx=transcribed.lower,
                ubx=transcribed.upper,
                lbg=transcribed.row_lower,
                ubg=transcribed.row_upper,
            )
        except RuntimeError:  # bounds that contradict each other, or are not numbers
            result = None
    if result is None:
        return Solution(
            transcribed=transcribed,
            x=np.array(transcribed.start),
            objective=np.nan,
            converged=False,
            status=INVALID,
            iterations=0,
            build_s=build_s,
            solve_s=time.perf_counter() - begin,
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
        multipliers=np.array(result["lam_g"]).ravel() if "lam_g" in result else None,
        bound_multipliers=np.array(result["lam_x"]).ravel() if "lam_x" in result else None,
    )


def _unheard() -> contextlib.AbstractContextManager:
    """Keep from the terminal what CasADi says there, which the status says too; threads would take it from each other."""
    if threading.current_thread() is not threading.main_thread():
        return contextlib.nullcontext()
    return contextlib.redirect_stderr(io.StringIO())
