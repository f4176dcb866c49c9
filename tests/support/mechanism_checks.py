"""What every built-in mechanism's test asks of its plan and of MuJoCo, and Lagrange's equations apart from the package."""

from collections.abc import Callable
from functools import cache

import numpy as np

from linkplan.controllers.rollout import Rollout
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import track
from tests.support.mechanisms import derivative, simulated


@cache
def mechanism_of(name: str, payload: str | None = None) -> Mechanism:
    """Return a built-in mechanism, loaded once."""
    return load_mechanism(name, payload=payload)


@cache
def plan_of(name: str) -> Plan:
    """Return a built-in problem's plan, made once; the test ends here with the plan's own sentence where there is none."""
    return plan_motion(load_problem(name)).require()


@cache
def tracked(name: str, tracker: str) -> Rollout:
    """Return a tracker's run in MuJoCo on a built-in problem's plan, made once."""
    return track(plan_of(name), tracker)


def acceleration(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the reduced model's acceleration (n_s,)."""
    return np.array(mechanism.dynamics.acceleration(q, v, u)).ravel()


def lagrangian_acceleration(
    inertia: Callable[[np.ndarray], np.ndarray],
    potential: Callable[[np.ndarray], float],
    s: np.ndarray,
    v: np.ndarray,
    effort: np.ndarray,
    step: float = 1e-3,
) -> np.ndarray:
    """Return a = M^-1 (effort - M' v + (v^T dM/ds v) / 2 - dV/ds) of a Lagrangian v^T M(s) v / 2 - V(s), (n,).

    Derivatives are five-point differences, so only the closed forms of M and V enter.
    """
    n = len(s)
    M = inertia(s)
    dM = [derivative(lambda h, k=k: inertia(s + h * np.eye(n)[k]), step) for k in range(n)]
    dV = np.array([derivative(lambda h, k=k: potential(s + h * np.eye(n)[k]), step) for k in range(n)])
    M_rate = sum(v[k] * dM[k] for k in range(n))
    return np.linalg.solve(M, effort - M_rate @ v + 0.5 * np.array([v @ d @ v for d in dM]) - dV)


def rigid_acceleration(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the acceleration (n_s,) of rigid loops from MuJoCo's own M, forces and constraint rows J.

        M q'' = forces + J^T f,   J q'' = -J' q'

    MuJoCo's acceleration itself is softened by each constraint's regularisation, which light links beside heavy ones make
    large. J' q' is a central difference of MuJoCo's rows along the motion.
    """
    model, step = mechanism.model, 1e-5
    rates = np.array(mechanism.dynamics.velocity_map(q)) @ v
    at = simulated(model, q, rates)
    ahead, behind = (simulated(model, q + sign * step * rates, rates).rows for sign in (1, -1))
    turning = (ahead - behind) @ rates / (2 * step)
    channels = [actuator.index for actuator in mechanism.actuators]
    forces = at.passive - at.bias + at.moment[channels].T @ u
    n, rows = len(q), len(at.rows)
    block = np.block([[at.mass_matrix, -at.rows.T], [at.rows, np.zeros((rows, rows))]])
    return np.linalg.lstsq(block, np.concatenate([forces, -turning]), rcond=1e-13)[0][:n][mechanism.independent]
