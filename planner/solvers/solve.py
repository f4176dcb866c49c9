"""Solution of a program by IPOPT, and the names of IPOPT's statuses."""

import contextlib
import functools
import io
import mmap
import threading
import time
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np

from linkplan.models.compiled.functions import compiler
from linkplan.models.deadline import NO_DEADLINE, asked, one_thread_at_a_time, solving
from linkplan.models.errors import ProblemError, one_line
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.transcription.collocation import Transcribed, with_compiled_code
from linkplan.planner.transcription.program import Program

# Feasibility and optimality of the scaled program; the certificate checks the motion itself.
SOLVER_TOLERANCE = 1e-10
MAX_ITERATIONS = 500
# Largest number of iterations of a solve that is repeated after a failure.
_ITERATIONS_AGAIN = 100
# IPOPT's statuses.
SUCCEEDED = "Solve_Succeeded"
OUT_OF_TIME = "Maximum_CpuTime_Exceeded"
OUT_OF_ITERATIONS = "Maximum_Iterations_Exceeded"
NO_MOTION = "Infeasible_Problem_Detected"
INVALID = "Invalid_Number_Detected"


# The hint at the end of messages on time limits.
OF_TIME = "(solver.max_time_s)"
# Interpreting this number of nodes times iterations takes as long as compiling: 0.06 ms each against 0.26 s on four-bars.
_COMPILING_COST = 4000
# OpenBLAS allocates this once for each thread, and repeats the request until it is granted, deaf to interrupts.
_OPENBLAS_BUFFER_BYTES = 128 << 20
# The fewest iterations before a solve is restarted with compiled functions.
_MIN_PATIENCE_ITERATIONS = 20


def why_stopped(status: str, max_time_s: float) -> str | None:
    """Return a phrase on a solver that stopped without a result on the problem; None for other statuses."""
    return {
        OUT_OF_TIME: f"the solver ran out of its {max_time_s:g} s {OF_TIME}",
        INVALID: "the dynamics, a cost or a limit is not finite (NaN), or the solver could not start",
    }.get(status)


class Solver(Protocol):
    """A solver built for one program, as `casadi.nlpsol` makes them."""

    def __call__(self, **numbers: Any) -> Any:
        """Return the result, "x" and "f", for x0, p, lbx, ubx, lbg and ubg."""
        ...

    def stats(self) -> dict[str, Any]:
        """Return statistics of the last call: success, return_status, iter_count."""
        ...


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Solution:
    """A solver's result for a program: unknowns, convergence to a local optimum, status, and time [s].

    `multipliers` (n_rows,) belong to the rows, for f + multipliers g, `bound_multipliers` (n,) to the unknowns; None
    without a result.
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


@one_thread_at_a_time
def build_solver(
    program: Program,
    settings: SolverSettings | None = None,
    *,
    warm: bool = False,
    close: bool = False,
    adaptive: bool = False,
) -> Solver:
    """Return IPOPT for a program; a warm solver begins close to its starting point.

    Args:
        program: the program.
        settings: limits on iterations and time.
        warm: the starting point is close to a solution.
        close: the starting point is a solution on another mesh. With `warm` too, it is accurate to almost the last digit.
        adaptive: the barrier parameter follows the iterates and may also increase.

    Raises:
        ProblemError: when the solver cannot be set up for the program.
        MemoryError: without the memory that its linear algebra needs.
    """
    settings = settings or SolverSettings()
    iterations = MAX_ITERATIONS if settings.max_iterations is None else settings.max_iterations
    try:
        _hold_linear_algebra_buffer()
        return _ipopt(program, iterations, settings, warm=warm, close=close, adaptive=adaptive)
    except RuntimeError as error:
        raise ProblemError(f"IPOPT cannot be set up: {one_line(error)}") from error


@functools.cache
def _hold_linear_algebra_buffer() -> None:
    """Let CasADi's OpenBLAS allocate the buffer that it keeps; without memory for it, MUMPS would wait for ever.

    Raises:
        MemoryError: if there is no memory for the buffer.
    """
    try:
        mmap.mmap(-1, _OPENBLAS_BUFFER_BYTES).close()
    except OSError as error:
        raise MemoryError(f"the solver needs {_OPENBLAS_BUFFER_BYTES >> 20} MB more memory") from error
    ca.solve(ca.DM.eye(2), ca.DM.ones(2), "lapacklu")


def _ipopt(
    program: Program, iterations: int, settings: SolverSettings, *, warm: bool, close: bool, adaptive: bool
) -> Solver:
    functions, left_s = program.functions, settings.deadline.within(settings.max_time_s).left_s
    acceptable = 1e-8
    options = {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.tol": SOLVER_TOLERANCE,
        "ipopt.constr_viol_tol": SOLVER_TOLERANCE,
        # An "acceptable" point must still be a motion. By default its rows may be violated by 0.01.
        "ipopt.acceptable_constr_viol_tol": acceptable,
        "ipopt.acceptable_compl_inf_tol": acceptable,
        "ipopt.max_iter": iterations,
        # Enforced by the callback: IPOPT would count the time of all threads. IPOPT requires a positive limit.
        "ipopt.max_cpu_time": max(1e-3, left_s * threading.active_count()),
        # Limits are hard: IPOPT must not relax them by its default of 1e-8.
        "ipopt.bound_relax_factor": 0.0,
        "ipopt.honor_original_bounds": "yes",
        "grad_f": functions["grad_f"],
        "jac_g": functions["jac_g"],
        "hess_lag": program.hess_lag(),
        # All derivatives are given; CasADi would look for others in compiled functions.
        "no_nlp_grad": True,
        # NaN gives a status, so CasADi's warnings about it are not needed.
        "show_eval_warnings": False,
        "calc_lam_p": False,
    }
    if adaptive:
        options["ipopt.mu_strategy"] = "adaptive"
    if program.n_intervals >= 200 or program.n_s > 1:
        # MUMPS' matching of rows to columns takes a time quadratic in the number of intervals: with 2,000, three quarters of
        # a solve. With several degrees of freedom it costs more than it gains on every mesh; small programs of one degree of
        # freedom use it for better pivots.
        options["ipopt.mumps_permuting_scaling"] = 0
    if program.n_s > 1:
        # With second-order corrections, full steps in and out of a joint's dry friction repeat until the iterations end.
        # Without them, 104 problems of several degrees of freedom take 2 % fewer iterations.
        options["ipopt.max_soc"] = 0
    if min(program.n_s, program.n_u) > 1:
        # Along directions in which the objective hardly bends (joints with slack time), steps at the optimum violate the
        # equations by up to 1e-7 until the iterations end. The last correction permits 1e-8, too.
        options |= {"ipopt.tol": acceptable, "ipopt.constr_viol_tol": acceptable, "ipopt.compl_inf_tol": SOLVER_TOLERANCE}
    if adaptive and close:
        # Near a solution, the filter's safeguard (a barrier that only decreases) takes a hundred iterations instead of
        # forty.
        options["ipopt.adaptive_mu_globalization"] = "never-monotone-mode"
    if not (warm or close):
        return _Ipopt(functions["nlp"], options, settings)
    # Initial barriers without multipliers: close to a solution; at a solution on another mesh, where a larger barrier would
    # lead away; and at a solution that hardly changes. For motions along a limit, the last needs 9 to 40 iterations instead
    # of 33 to more than 500.
    barrier = 1e-6 if close else 1e-4
    near = options | {"ipopt.mu_init": 1e-9 if warm and close else barrier}
    near |= {f"ipopt.{push}": 0.01 * barrier for push in ("bound_push", "bound_frac")}
    pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
    # With multipliers, a barrier of 1e-6 needs four iterations and 1e-4 five; with a smaller one, changes of the active
    # limits take twice as many.
    again = options | {"ipopt.warm_start_init_point": "yes", "ipopt.mu_init": 1e-6}
    again |= {f"ipopt.warm_start_{push}": 1e-9 for push in pushes}
    return _WarmIpopt(functions["nlp"], near, again, settings)


class _StopCallback(ca.Callback):
    """IPOPT's callback after every iteration: it stops the solver on a signal or when the deadline has passed."""

    def __init__(self) -> None:
        ca.Callback.__init__(self)
        self.deadline, self.late = NO_DEADLINE, False
        self.construct("watch", {})

    def get_n_in(self) -> int:
        """Return the number of inputs that CasADi offers."""
        return ca.nlpsol_n_out()

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return an empty pattern, because no input is used."""
        del i
        return ca.Sparsity(0, 0)

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return 1

    def eval(self, arg: list) -> list:
        """Return 1 to stop and 0 to continue."""
        del arg
        self.late = self.deadline.passed
        return [float(self.late or asked() is not None)]


class _Ipopt:
    """IPOPT with its callback, to which CasADi itself keeps no reference."""

    def __init__(self, nlp: ca.Function, options: dict[str, Any], settings: SolverSettings) -> None:
        self._watch, self._settings = _StopCallback(), settings
        self._solver = ca.nlpsol("solver", "ipopt", nlp, options | {"iteration_callback": self._watch})

    def __call__(self, **numbers: Any) -> Any:
        """Return the result, "x", "f" and multipliers."""
        self._watch.deadline, self._watch.late = self._settings.deadline.within(self._settings.max_time_s), False
        return self._solver(**numbers)

    def stats(self) -> dict[str, Any]:
        """Return statistics of the last call."""
        stats = self._solver.stats()
        return stats | {"return_status": OUT_OF_TIME} if self._watch.late else stats


class _WarmIpopt:
    """IPOPT that begins close to its starting point, and from the second call on with the last multipliers."""

    def __init__(self, nlp: ca.Function, near: dict[str, Any], again: dict[str, Any], settings: SolverSettings) -> None:
        self._solver = self._near = _Ipopt(nlp, near, settings)
        self._build = lambda: _Ipopt(nlp, again, settings)
        self._again: _Ipopt | None = None
        self._multipliers: dict[str, ca.DM] = {}

    def __call__(self, **numbers: Any) -> Any:
        """Return the result, "x" and "f"."""
        if self._multipliers and self._again is None:
            self._again = self._build()
        self._solver = self._again if self._multipliers and self._again is not None else self._near
        result = self._solver(**numbers, **self._multipliers)
        good = self._solver.stats()["success"]
        self._multipliers = {"lam_x0": result["lam_x"], "lam_g0": result["lam_g"]} if good else {}
        return result

    def stats(self) -> dict[str, Any]:
        """Return statistics of the last call."""
        return self._solver.stats()


def solve(
    transcribed: Transcribed,
    settings: SolverSettings | None = None,
    *,
    warm: bool = False,
    close: bool = False,
    adaptive: bool = False,
) -> Solution:
    """Return the solver's result, started as in `build_solver`; there is no error for a problem without a solution.

    A long solve with interpreted functions is restarted with compiled ones, which take the same iterations in less time.

    Near a solution the filter may refuse all but tiny steps, depending on rounding errors. A solve that runs out of
    iterations is therefore repeated with a barrier that follows the iterates. With a `close` start it is not, because the
    callers try both barriers.
    """
    settings = settings or SolverSettings()
    first = _patience(transcribed, settings)
    if first is not None:
        few = settings.replace(max_iterations=first)
        solution = _solved(transcribed, few, warm=warm, close=close, adaptive=adaptive)
        if solution.status != OUT_OF_ITERATIONS:
            return solution
        transcribed = with_compiled_code(transcribed, settings.deadline)
    solution = _solved(transcribed, settings, warm=warm, close=close, adaptive=adaptive)
    if solution.status != OUT_OF_ITERATIONS or adaptive or close:
        return solution
    fewer = settings.replace(max_iterations=min(_ITERATIONS_AGAIN, settings.max_iterations or _ITERATIONS_AGAIN))
    again = _solved(transcribed, fewer, warm=warm, close=close, adaptive=True)
    return again if again.converged else solution


def _patience(transcribed: Transcribed, settings: SolverSettings) -> int | None:
    """Return the number of iterations after which compiling is cheaper than interpreting; None if it is impossible."""
    interval = transcribed.program.interval
    if interval.compiled or settings.compile != "auto" or compiler() is None:
        return None
    few = max(_MIN_PATIENCE_ITERATIONS, _COMPILING_COST // (transcribed.program.mesh.n_intervals * interval.n_nodes))
    return few if few < (MAX_ITERATIONS if settings.max_iterations is None else settings.max_iterations) else None


def _solved(
    transcribed: Transcribed, settings: SolverSettings, *, warm: bool, close: bool, adaptive: bool = False
) -> Solution:
    begin = time.perf_counter()
    solver = build_solver(transcribed.program, settings, warm=warm, close=close, adaptive=adaptive)
    return run_solver(solver, transcribed, build_s=time.perf_counter() - begin)


def run_solver(solver: Solver, transcribed: Transcribed, *, build_s: float = 0.0) -> Solution:
    """Return a built solver's result for a program's numbers, from its starting point.

    Raises:
        KeyboardInterrupt: when a signal stopped the solver.
    """
    begin = time.perf_counter()
    with solving(), _without_console_output():
        try:
            result = solver(
                x0=transcribed.start,
                p=transcribed.parameters,
                lbx=transcribed.lower,
                ubx=transcribed.upper,
                lbg=transcribed.row_lower,
                ubg=transcribed.row_upper,
            )
        except RuntimeError:  # for example contradictory bounds, or NaN
            result = None
    if result is None:
        result, stats = {"x": transcribed.start, "f": np.nan}, {"success": False, "return_status": INVALID, "iter_count": 0}
    else:
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


def _without_console_output() -> contextlib.AbstractContextManager:
    """Suppress CasADi's messages on stderr, which the status repeats; only in the main thread, because stderr is shared."""
    if threading.current_thread() is not threading.main_thread():
        return contextlib.nullcontext()
    return contextlib.redirect_stderr(io.StringIO())
