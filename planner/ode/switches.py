"""Switches where Pontryagin's conditions have them: switch times at the zeros of the switching functions.

A solution on a mesh shows its switches as smeared intervals. Arcs shorter than an interval do not show at all, and the
solver rests where the mesh has no room for them; the costates know of them all the same.
"""

import itertools
from dataclasses import replace

import numpy as np

from linkplan.planner.ode.case import FirstSolution, OdeCase
from linkplan.planner.ode.costates import Switching, is_affine, last_costates, switching_of
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.refinement.switch_search import MESH_ERROR_SHARE, mesh_with_switches
from linkplan.planner.solvers.solve import SUCCEEDED, Solution

# A solution replaces another one with switch times if its objective is better by this share, and by ten times the error of
# its states. Next to an arc that vanishes the duration changes by the root of the solver's tolerance, 1e-10.
_MIN_GAIN_SHARE = 1e-6


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
    worth = case.certify(tried.motion).integration_error * float(np.abs(last_costates(case.asked, solution)) @ sizes)
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
