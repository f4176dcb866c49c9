"""Costates of a solution and what they say of its efforts: Pontryagin's switching functions.

H = L + lambda' f with lambda' = -dH/dx backwards; where f and L are affine in u, effort j belongs at its lower limit where
S_j = dH/du_j > 0 and at its upper one where S_j < 0 (Bryson & Ho, Applied Optimal Control, 1975, section 3.9). The costate
at the end of an interval is the multiplier of the row that hands the state on there.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.solvers.solve import Solution

# Runge-Kutta steps in an interval; the switching function is evaluated after each of them.
_STEPS_PER_INTERVAL = 8


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Switching:
    """Switching functions (n, steps + 1, n_u) at instants (n, steps + 1) [s] of the intervals, in the objective's units."""

    time_s: np.ndarray
    value: np.ndarray


def is_affine(problem: OdeProblem) -> bool:
    """True if rate and running cost are affine in the efforts: each effort is then at a limit or on a singular arc."""
    for name in ("rate", "running_cost"):
        function = problem.at_instant(name)
        if function.numel_out(0):
            x, u, p, t = (ca.SX.sym(k, *function.size_in(i)) for i, k in enumerate("xupt"))
            slope = ca.jacobian(function(x, u, p, t), u)
            if ca.depends_on(slope, u):
                return False
    return True


def switching_of(problem: OdeProblem, motion: OdeTrajectory, solution: Solution) -> Switching | None:
    """Return the switching functions along a solution; None where its solver gave no multipliers."""
    if solution.multipliers is None:
        return None
    last = _costates(problem, solution)
    drive, push = _functions(problem, len(last))
    breaks, p = motion.breaks_s, np.tile(problem.parameters[:, None], (1, len(last)))
    step = np.diff(breaks) / _STEPS_PER_INTERVAL

    def at(share: float):
        # A hair inside: at a break the curves are the later interval's.
        time = breaks[:-1] + np.clip(share, 1e-9, 1 - 1e-9) * np.diff(breaks)
        return motion.state_at(time).T, motion.effort_at(time).T, p, time[None]

    costate, values = last.T, []
    for k in range(_STEPS_PER_INTERVAL, -1, -1):
        here = at(k / _STEPS_PER_INTERVAL)
        values.append(np.array(push(*here, costate)).T)
        if k:
            middle, before = at((k - 0.5) / _STEPS_PER_INTERVAL), at((k - 1) / _STEPS_PER_INTERVAL)
            k1 = np.array(drive(*here, costate))
            k2 = np.array(drive(*middle, costate + 0.5 * step * k1))
            k3 = np.array(drive(*middle, costate + 0.5 * step * k2))
            k4 = np.array(drive(*before, costate + step * k3))
            costate = costate + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    time = breaks[:-1, None] + np.diff(breaks)[:, None] * np.linspace(0.0, 1.0, _STEPS_PER_INTERVAL + 1)
    return Switching(time_s=time, value=np.stack(values[::-1], axis=1))


def last_costates(problem: OdeProblem, solution: Solution) -> np.ndarray:
    """Return the costates (n_x,) at the end: what the objective would gain or lose by a unit less or more of each state."""
    return _costates(problem, solution)[-1]


def _costates(problem: OdeProblem, solution: Solution) -> np.ndarray:
    """Return the costates (n, n_x) at the intervals' ends: what a unit more of a state there would cost."""
    transcribed = solution.transcribed
    interval, n = transcribed.program.interval, transcribed.program.layout.n_intervals
    rows = solution.multipliers[: n * interval.n_rows].reshape(n, interval.n_rows)
    handed = [k for k, kind in enumerate(interval.own_kinds) if kind == "continuity"][: problem.n_x]
    units = transcribed.units
    return -rows[:, handed] * units.objective / units.state[: problem.n_x]


def _functions(problem: OdeProblem, n: int) -> tuple[ca.Function, ca.Function]:
    """Return dH/dx, a costate's rate backwards in time, and dH/du, of (x, u, p, t, costate), mapped over n columns."""
    sizes = (("x", problem.n_x), ("u", problem.n_u), ("p", len(problem.parameters)), ("t", 1), ("costate", problem.n_x))
    x, u, p, t, costate = (ca.SX.sym(*size) for size in sizes)
    hamiltonian = ca.dot(costate, problem.at_instant("rate")(x, u, p, t))
    if problem.running_cost is not None:
        hamiltonian += problem.at_instant("running_cost")(x, u, p, t)
    inputs = [x, u, p, t, costate]
    drive, push = (ca.densify(ca.gradient(hamiltonian, of)) for of in (x, u))
    return ca.Function("drive", inputs, [drive]).map(n), ca.Function("push", inputs, [push]).map(n)
