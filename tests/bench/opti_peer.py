"""What a careful user writes by hand without linkplan: the knee with the shank in `casadi.Opti`, as a yardstick.

Separated Hermite-Simpson (Kelly, SIAM Review 59, 2017, sec. 4) on the closed-form four-bar, typed in, with IPOPT. Torques
are bounded at nodes and midpoints, which is all that such a program does: between them the quadratic goes where it likes.

Used well: a program that is solved once is not expanded (`expand` halves a solve or better, and takes 2 s to build), one
that is solved again is, and begins from the last answer with its multipliers, without Opti's own checks around it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from linkplan.planner.solvers.solve import SOLVER_TOLERANCE

L1, L2, L3, L4 = 0.057, 0.0741, 0.0855, 0.057
GRAVITY = 9.81
LIMIT = 100.0
DENSITY = 1000.0


def _sphere(radius: float) -> tuple[float, float]:
    mass = DENSITY * 4 / 3 * np.pi * radius**3
    return mass, 0.4 * mass * radius**2


def _rod(length: float, radius: float = 0.01) -> tuple[float, float]:
    mass = DENSITY * np.pi * radius**2 * length
    return mass, mass * (3 * radius**2 + length**2) / 12


def acceleration_function() -> ca.Function:
    """Return (angle, speed, torque) -> acceleration of the knee with the shank, from energy in closed form."""
    s, v, u = (ca.SX.sym(name) for name in "svu")
    a = ca.vertcat(L1 * ca.sin(s), L1 * ca.cos(s))
    c = ca.vertcat(L4, 0)
    diagonal = ca.norm_2(c - a)
    along = (c - a) / diagonal
    normal = ca.vertcat(-along[1], along[0])
    x = (diagonal**2 + L2**2 - L3**2) / (2 * diagonal)
    b = a + x * along + ca.sqrt(L2**2 - x**2) * normal

    def angle(p: ca.SX, q: ca.SX) -> ca.SX:
        return ca.atan2(q[0] - p[0], q[1] - p[1])

    coupler, rocker = angle(a, b), angle(c, b)
    ball, small = _sphere(0.015), (0.002, 0.4 * 0.002 * 0.005**2)
    shank_arm = ca.vertcat(-0.11105599230618464, -0.16633269844768545)
    shank = ca.vertcat(
        ca.cos(s) * shank_arm[0] + ca.sin(s) * shank_arm[1], -ca.sin(s) * shank_arm[0] + ca.cos(s) * shank_arm[1]
    )
    parts = [  # centre, angle, mass, inertia
        (0 * a, s, *ball),
        (a / 2, s, *_rod(L1)),
        (a, coupler, *ball),
        ((a + b) / 2, coupler, *_rod(L2)),
        (c, rocker, *ball),
        ((b + c) / 2, rocker, *_rod(L3)),
        (c, rocker, *small),
        (b, rocker, *ball),
        (shank, s, 4.0, 0.05),
    ]
    M, V = ca.SX(0), ca.SX(0)
    for centre, turn, mass, inertia in parts:
        M += mass * ca.sumsqr(ca.jacobian(centre, s)) + inertia * ca.jacobian(turn, s) ** 2
        V += mass * GRAVITY * centre[1]
    return ca.Function("acceleration", [s, v, u], [(u - 0.5 * ca.jacobian(M, s) * v**2 - ca.jacobian(V, s)) / M])


# IPOPT as linkplan has it, for every peer.
IPOPT = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": SOLVER_TOLERANCE}
# The quickest of barriers 1e-3, 1e-4, 1e-6 and 1e-8 and pushes 1e-6 and 1e-9 on both problems: 3 and 4 iterations.
WARM = IPOPT | {"expand": True, "error_on_fail": True, "ipopt.warm_start_init_point": "yes", "ipopt.mu_init": 1e-8}
for _push in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push"):
    WARM[f"ipopt.warm_start_{_push}"] = 1e-6


class WarmOpti:
    """An Opti program that has an answer, built once more to be solved from its last answer and multipliers.

    `to_function` is Opti's, or what has a wrapper around one; `goal` its parameter.
    """

    def __init__(self, opti: ca.Opti, goal: ca.MX, to_function: Callable[..., ca.Function]) -> None:
        self._last = [opti.debug.value(opti.x), opti.debug.value(opti.lam_g)]
        opti.solver("ipopt", WARM)
        self._solver = to_function("again", [goal, opti.x, opti.lam_g], [opti.x, opti.lam_g, opti.f])

    def __call__(self, goal: float) -> float:
        """Return the objective of the answer for a goal [rad]; raises RuntimeError where IPOPT finds none."""
        *self._last, objective = self._solver(goal, *self._last)
        return float(objective)


@dataclass(frozen=True, eq=False, slots=True)
class Peer:
    """A built Opti program: solve for a goal, or again and again."""

    opti: ca.Opti
    goal: ca.MX
    angle: ca.MX
    effort: ca.MX
    duration: ca.MX | float

    def solve(self, goal: float) -> ca.OptiSol:
        """Return the solution for a goal [rad], from the guess."""
        self.opti.set_value(self.goal, goal)
        return self.opti.solve()

    def again(self) -> WarmOpti:
        """Return what solves for other goals from the last solution."""
        return WarmOpti(self.opti, self.goal, self.opti.to_function)


def build_peer(intervals: int, start: float, goal: float, duration: float | None, *, expand: bool = False) -> Peer:
    """Return the program: least effort in a given duration, least time where it is None; in scalars where `expand`."""
    f = acceleration_function()
    opti = ca.Opti()
    q, v, u = (opti.variable(2 * intervals + 1) for _ in range(3))  # nodes and midpoints in turn
    T = opti.variable() if duration is None else duration
    target = opti.parameter()
    h = T / intervals
    a = f.map(2 * intervals + 1)(q.T, v.T, u.T).T
    left, middle, right = slice(0, -2, 2), slice(1, None, 2), slice(2, None, 2)
    for x, rate in ((q, v), (v, a)):
        opti.subject_to(x[right] - x[left] == h / 6 * (rate[left] + 4 * rate[middle] + rate[right]))
        opti.subject_to(x[middle] == (x[left] + x[right]) / 2 + h / 8 * (rate[left] - rate[right]))
    opti.subject_to(opti.bounded(-LIMIT, u, LIMIT))
    for condition in (q[0] == start, q[-1] == target, v[0] == 0, v[-1] == 0):
        opti.subject_to(condition)
    tau = np.linspace(0, 1, 2 * intervals + 1)
    guessed = 0.15 if duration is None else duration
    opti.set_initial(q, start + (goal - start) * tau)
    opti.set_initial(v, (goal - start) / guessed)
    if duration is None:
        opti.subject_to(opti.bounded(0.01, T, 1.0))
        opti.set_initial(T, guessed)
        opti.minimize(T)
    else:
        opti.minimize(h / 6 * ca.sum(u[left] ** 2 + 4 * u[middle] ** 2 + u[right] ** 2))
    opti.solver("ipopt", IPOPT | {"expand": expand})
    opti.set_value(target, goal)
    return Peer(opti, target, q, u, T)


def drift(peer: Peer, solution: ca.OptiSol) -> float:
    """Return how far [rad] the mechanism goes from the plan's nodes under the plan's torque: quadratics, integrated."""
    f, start = acceleration_function(), float(solution.value(peer.angle)[0])
    angle, torque = (np.array(solution.value(part)).ravel() for part in (peer.angle, peer.effort))
    h = float(solution.value(peer.duration)) / (len(angle) // 2)
    state, furthest = np.array([start, 0.0]), 0.0
    for k in range(0, len(angle) - 2, 2):
        bend = np.polyfit([0.0, h / 2, h], torque[k : k + 3], 2)

        def rate(t: float, x: np.ndarray, bend=bend) -> list[float]:
            return [x[1], float(f(x[0], x[1], np.polyval(bend, t)))]

        state = solve_ivp(rate, (0.0, h), state, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        furthest = max(furthest, abs(state[0] - angle[k + 2]))
    return furthest
