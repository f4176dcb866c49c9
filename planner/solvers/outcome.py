"""What a solver is to the planner: called with a program's numbers, it answers; and its words for why it stopped."""

from typing import Any, Protocol

# Feasibility and optimality of the scaled program; the certificate then judges the motion itself.
TOLERANCE = 1e-10
# Feasibility with which a solver may stop that cannot come nearer to its tolerance.
ACCEPTABLE = 1e-8
MAX_ITERATIONS = 500
# IPOPT's words.
SUCCEEDED = "Solve_Succeeded"
OUT_OF_TIME = "Maximum_CpuTime_Exceeded"
OUT_OF_ITERATIONS = "Maximum_Iterations_Exceeded"
INVALID = "Invalid_Number_Detected"


# What sentences on time that ran out point to.
OF_TIME = "(solver.max_time_s)"


def why_stopped(status: str, max_time_s: float) -> str | None:
    """Return the words on a solver that stopped before it could say anything of the problem; None where it could."""
    return {
        OUT_OF_TIME: f"the solver ran out of its {max_time_s:g} s {OF_TIME}",
        INVALID: "the dynamics gave a number that is not finite (NaN) along the motion, or the solver could not begin",
    }.get(status)


class Solver(Protocol):
    """A solver built for one program, as `casadi.nlpsol` makes them."""

    def __call__(self, **numbers: Any) -> Any:
        """Return the answer, "x" and "f", from x0, p, lbx, ubx, lbg and ubg."""
        ...

    def stats(self) -> dict[str, Any]:
        """Return what there is to say of the last answer: success, return_status, iter_count."""
        ...
