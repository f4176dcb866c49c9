"""The planner's interface to a solver, and the names of IPOPT's statuses."""

from typing import Any, Protocol

# Feasibility and optimality of the scaled program; the certificate checks the motion itself.
SOLVER_TOLERANCE = 1e-10
MAX_ITERATIONS = 500
# IPOPT's statuses.
SUCCEEDED = "Solve_Succeeded"
OUT_OF_TIME = "Maximum_CpuTime_Exceeded"
OUT_OF_ITERATIONS = "Maximum_Iterations_Exceeded"
INVALID = "Invalid_Number_Detected"


# The hint at the end of messages on time limits.
OF_TIME = "(solver.max_time_s)"


def why_stopped(status: str, max_time_s: float) -> str | None:
    """Return a phrase on a solver that stopped without a result on the problem; None for other statuses."""
    return {
        OUT_OF_TIME: f"the solver ran out of its {max_time_s:g} s {OF_TIME}",
        INVALID: "the dynamics gave a number that is not finite (NaN) along the motion, or the solver could not begin",
    }.get(status)


class Solver(Protocol):
    """A solver built for one program, as `casadi.nlpsol` makes them."""

    def __call__(self, **numbers: Any) -> Any:
        """Return the result, "x" and "f", for x0, p, lbx, ubx, lbg and ubg."""
        ...

    def stats(self) -> dict[str, Any]:
        """Return statistics of the last call: success, return_status, iter_count."""
        ...
