"""Costates of a solution, what they say of its efforts, and switch times where Pontryagin's conditions have them.

H = L + lambda' f with lambda' = -dH/dx backwards; where f and L are affine in u, effort j belongs at its lower limit where
S_j = dH/du_j > 0 and at its upper one where S_j < 0 (Bryson & Ho, Applied Optimal Control, 1975, section 3.9). The costate
at the end of an interval is the multiplier of the row that hands the state on there.

A solution on a mesh shows its switches as smeared intervals. Arcs shorter than an interval do not show at all, and the
solver rests where the mesh has no room for them; the costates know of them all the same.
"""

import itertools
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from linkplan.planner.ode.case import FirstSolution, OdeCase
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.refinement.switch_search import MESH_ERROR_SHARE, mesh_with_switches
from linkplan.planner.solvers.solve import SUCCEEDED, Solution

# Runge-Kutta steps in an interval; the switching function is evaluated after each of them.
_STEPS_PER_INTERVAL = 8
# A solution replaces another one with switch times if its objective is better by this share, and by ten times the error of
# its states. Next to an arc that vanishes the duration changes by the root of the solver's tolerance, 1e-10.
_MIN_GAIN_SHARE = 1e-6


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
    drive, push = _functions(problem)
    breaks, p = motion.breaks_s, problem.parameters
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


def _costates(problem: OdeProblem, solution: Solution) -> np.ndarray:
    """Return the costates (n, n_x) at the intervals' ends: what a unit more of a state there would cost."""
    transcribed = solution.transcribed
    interval, n = transcribed.program.interval, transcribed.program.layout.n_intervals
    rows = solution.multipliers[: n * interval.n_rows].reshape(n, interval.n_rows)
    handed = [k for k, kind in enumerate(interval.own_kinds) if kind == "continuity"][: problem.n_x]
    units = transcribed.units
    return -rows[:, handed] * units.objective / units.state[: problem.n_x]


def _functions(problem: OdeProblem) -> tuple[ca.Function, ca.Function]:
    """Return dH/dx, a costate's rate backwards in time, and dH/du, of (x, u, p, t, costate)."""
    sizes = (("x", problem.n_x), ("u", problem.n_u), ("p", len(problem.parameters)), ("t", 1), ("costate", problem.n_x))
    x, u, p, t, costate = (ca.SX.sym(*size) for size in sizes)
    hamiltonian = ca.dot(costate, problem.at_instant("rate")(x, u, p, t))
    if problem.running_cost is not None:
        hamiltonian += problem.at_instant("running_cost")(x, u, p, t)
    inputs = [x, u, p, t, costate]
    drive, push = (ca.densify(ca.gradient(hamiltonian, of)) for of in (x, u))
    return ca.Function("drive", inputs, [drive]), ca.Function("push", inputs, [push])


def switch_by_costates(first: FirstSolution) -> FirstSolution:
    """Return a first solution with its efforts at the limits that their switching functions ask for, on a mesh cut there.

    The solution is returned unchanged if an effort does not enter affinely, lacks a limit, or has an arc within its limits.
    """
    asked, problem, limit = first.case, first.case.asked, first.case.asked.effort_limit
    if not np.all(np.isfinite(limit)) or not is_affine(problem):
        return first
    # The largest number of updates of the switch times: an arc that vanishes shrinks from one update to the next.
    for _ in range(8):
        motion, solution = first.found.motion, first.found.solution
        if has_arcs(motion, limit):
            return first
        switching = switching_of(problem, motion, solution)
        if switching is None or not np.all(np.isfinite(switching.value)):
            return first
        switch_times = _switch_times(switching)
        promised = _promised(motion, switching, limit)
        # A solution with more switch times than this chatters.
        if promised <= _MIN_GAIN_SHARE * abs(solution.objective) or len(switch_times) > 40:
            return first
        boundaries = motion.breaks_s[[0, -1]]
        finer, durations = mesh_with_switches(boundaries, switch_times, asked.problem.mesh.intervals)
        ends = np.concatenate([boundaries[:1], switch_times, boundaries[1:]])
        bang_efforts, start = _bang_efforts(switching, ends, limit), asked.start_from(motion)
        better = None
        for efforts, what in (
            (bang_efforts, "switch times from the costates"),
            (None, "switch times from the costates, efforts free"),
        ):
            tried = attempt(asked, start, finer, durations, what, bang_efforts=efforts, warm=True)
            if tried is None or tried.solution.status != SUCCEEDED:
                continue
            if _replaces(asked, tried, solution, uncut=not first.case.has_switch_times):
                better = replace(first, found=tried, case=replace(asked, has_switch_times=True, bang_efforts=efforts))
                break
        if better is None:
            return first
        first = better
    return first


def _replaces(case: OdeCase, tried: Iterate[OdeTrajectory], before: Solution, *, uncut: bool) -> bool:
    """True if a solution replaces the previous one.

    The first with switch times does where it is no worse than a mesh without switch times is wrong, later ones where they
    gain more than what their states' errors are worth by their own costates.
    """
    solution, allowed = tried.solution, MESH_ERROR_SHARE * abs(before.objective)
    if uncut:
        return solution.objective <= before.objective + allowed
    sizes = np.abs(tried.motion.state[:, :, : case.asked.n_x]).max(axis=(0, 1))
    worth = case.certify(tried.motion).integration_error * float(np.abs(_costates(case.asked, solution)[-1]) @ sizes)
    return before.objective - solution.objective > max(_MIN_GAIN_SHARE * abs(before.objective), 10.0 * worth)


def has_arcs(motion: OdeTrajectory, limit: np.ndarray) -> bool:
    """True if an effort stays within its limits for longer than a smeared switch."""
    # An effort within this share of its range from a limit is at the limit; the solver is exact to 1e-8.
    slack = np.where(np.isfinite(limit).all(axis=1), 1e-3 * np.diff(limit, axis=1).ravel(), np.inf)
    within = (motion.effort.min(axis=0) < limit[:, 1] - slack) & (motion.effort.max(axis=0) > limit[:, 0] + slack)
    for column in within.T:
        padded = np.concatenate([[False], column, [False]]).astype(int)
        lengths = np.flatnonzero(np.diff(padded) < 0) - np.flatnonzero(np.diff(padded) > 0)
        # More successive intervals than this with an effort within its limits are an arc and not a smeared switch.
        if lengths.max(initial=0) > 3:
            return True
    return False


def _signs(switching: Switching) -> np.ndarray:
    """Return the signs (n (steps + 1), n_u) of the switching functions in order of time, zero where they are faint."""
    flat = switching.value.reshape(-1, switching.value.shape[2])
    # A switching function below this share of its largest value is zero.
    return np.where(np.abs(flat) > 1e-6 * np.abs(flat).max(axis=0), np.sign(flat), 0.0)


def _promised(motion: OdeTrajectory, switching: Switching, limit: np.ndarray) -> float:
    """Return the first-order gain of the objective with every effort at its optimal limit."""
    n, steps, n_u = switching.value.shape
    signs = _signs(switching).reshape(n, steps, n_u)
    share = np.clip(np.linspace(0.0, 1.0, steps), 1e-9, 1 - 1e-9)
    time = motion.breaks_s[:-1, None] + np.diff(motion.breaks_s)[:, None] * share
    effort = motion.effort_at(time.ravel()).reshape(n, steps, n_u)
    wanted = np.where(signs > 0, limit[:, 0], np.where(signs < 0, limit[:, 1], effort))
    gain = (switching.value * (effort - wanted)).sum(axis=2)
    return float(np.sum(np.trapezoid(gain, switching.time_s, axis=1)))


def _switch_times(switching: Switching) -> np.ndarray:
    """Return the instants (n,) [s] at which a switching function changes its sign, in order."""
    time, signs = switching.time_s.ravel(), _signs(switching)
    flat, switch_times = switching.value.reshape(signs.shape), []
    for j in range(signs.shape[1]):
        known = np.flatnonzero(signs[:, j])
        for a, b in itertools.pairwise(known):
            if signs[a, j] != signs[b, j]:
                share = flat[a, j] / (flat[a, j] - flat[b, j])
                switch_times.append(float(time[a] + share * (time[b] - time[a])))
    # Switch times within this share of the duration from one another or from an end are one.
    apart, kept = 1e-7 * (time[-1] - time[0]), []
    for at in sorted(switch_times):
        if min(at - time[0], time[-1] - at) > apart and (not kept or at - kept[-1] > apart):
            kept.append(at)
    return np.array(kept)


def _bang_efforts(switching: Switching, ends: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return the limits (n_segments, n_u) that efforts are held at between ends (n_segments + 1,) [s]."""
    time, n_u = switching.time_s.ravel(), switching.value.shape[2]
    flat = switching.value.reshape(-1, n_u)
    middle = 0.5 * (ends[1:] + ends[:-1])
    value = np.column_stack([np.interp(middle, time, flat[:, j]) for j in range(n_u)])
    return np.where(value > 0, limit[:, 0], limit[:, 1])
