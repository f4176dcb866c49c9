"""What the optimal-control problems of the tests are made of: right-hand sides, costs, open limits, and a plan."""

import numpy as np

from linkplan.planner.ode.plan import OdePlan, plan_ode
from linkplan.planner.ode.problem import OdeProblem

INF, NAN = np.inf, np.nan
# Limits of one effort and of one state that are none.
FREE_EFFORT = [[-INF, INF]]
FREE_STATE = [-INF, INF]


def duration(x0, xT, T, p):  # noqa: ARG001
    """Return the final cost of least time."""
    return T


def squared_effort(x, u, p, t):  # noqa: ARG001
    """Return the running cost of least effort."""
    return u[0] ** 2


def double_integrator(x, u, p, t):  # noqa: ARG001
    """Return x'' = u as a system of first order."""
    return [x[1], u[0]]


def least_time_reach(**changes) -> OdeProblem:
    """Return the least-time problem of a double integrator over a distance of 1; its optimum is 2 s."""
    fields = {"name": "double integrator", "rate": double_integrator, "start": [0, 0], "goal": [1, 0]}
    limits = {"effort_limit": [[-1, 1]], "duration_s": (0.1, 20.0), "final_cost": duration}
    return OdeProblem(**fields | limits | changes)


def solved(problem: OdeProblem | None = None, **fields) -> OdePlan:
    """Return the plan of a problem, or of one with these fields, after making sure that it is one."""
    problem = problem or OdeProblem(**{"name": "a test's"} | fields)
    plan = plan_ode(problem)
    assert plan.status == "optimal", f"{problem.name}: {plan.message}"
    return plan


# x'' = -x + u as x' = A x + B u.
OSCILLATOR = np.array([[0.0, 1.0], [-1.0, 0.0]])


def oscillator(x, u, p, t):  # noqa: ARG001
    """Return the rates of the oscillator."""
    return [x[1], -x[0] + u[0]]


def bryson_denham(limit: float, tolerance: float | None) -> OdeProblem:
    """Return Bryson and Denham's problem, whose optimum is 4 / (9 l) for a limit l below 1/6."""
    return OdeProblem(
        name="Bryson-Denham",
        rate=double_integrator,
        start=[0, 1],
        goal=[0, -1],
        effort_limit=FREE_EFFORT,
        state_limit=[[-INF, limit], FREE_STATE],
        duration_s=1.0,
        running_cost=lambda x, u, p, t: u[0] ** 2 / 2,  # noqa: ARG005
        objective_tolerance=tolerance,
    )


def robbins(tolerance: float | None) -> OdeProblem:
    """Return Robbins' problem (Betts 2010): y''' = u, y >= 0, int 3 y + u^2 / 2, with ever smaller bumps between touches."""
    return OdeProblem(
        name="Robbins",
        rate=lambda x, u, p, t: [x[1], x[2], u[0]],  # noqa: ARG005
        running_cost=lambda x, u, p, t: 3 * x[0] + u[0] ** 2 / 2,  # noqa: ARG005
        start=[1, -2, 0],
        goal=[0, 0, 0],
        effort_limit=FREE_EFFORT,
        state_limit=[[0, INF], FREE_STATE, FREE_STATE],
        duration_s=10,
        objective_tolerance=tolerance,
    )
