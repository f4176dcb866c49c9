"""Bounds and linear rows of a program: what a problem's limits and boundary states are in scaled numbers."""

import numpy as np
import scipy.sparse as sp

from planner.interval import IntervalFunctions, Layout
from planner.mechanics import Scales
from planner.mesh import Mesh
from planner.problem import PlanningProblem

# Free segments may shrink to this share of their guessed duration and no further, so that no interval collapses.
_SHORTEST_SEGMENT = 0.02
# A segment between cuts may shrink or stretch by this factor, and by half a mean interval beyond it.
_CUT_ROOM = 1.1


def speed_limited(problem: PlanningProblem) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the independent columns and the dependent joints whose speeds are limited."""
    mechanism = problem.mechanism
    limited = [i for i in range(mechanism.n_q) if np.any(np.isfinite(problem.limits.speed[i]))]
    columns = tuple(k for k, i in enumerate(mechanism.independent) if i in limited)
    return columns, tuple(i for i in limited if i not in mechanism.independent)


def held_efforts(pinned: np.ndarray | None, mesh: Mesh, layout: Layout) -> np.ndarray | None:
    """Return what efforts are held at (n_intervals, n_coefficients, n_u), NaN where they are free."""
    if pinned is None:
        return None
    return np.repeat(pinned[mesh.segment][:, None, :], layout.effort_coefficients, axis=1)


def linear_rows(problem: PlanningProblem, layout: Layout, durations, scales: Scales, held: np.ndarray | None):
    """Return rows (n, size) with their lower and upper values.

    A periodic motion's return, an effort without jumps where a reference is tracked, the total duration where cuts move,
    and efforts within a factor of their limits where that factor is sought.
    """
    blocks: list[tuple[np.ndarray, np.ndarray, float, float]] = []  # columns, coefficients (n, k); lower, upper
    ones, limit = np.ones((layout.n_s * 2, 1)), problem.limits.effort
    periodic = problem.motion.kind == "periodic"
    if periodic:
        ends = np.stack([layout.state(layout.n_intervals), layout.state(0)], axis=1)
        blocks.append((ends, np.hstack([ones, -ones]), 0.0, 0.0))
    effort = layout.effort()
    if problem.objective == "tracking" and layout.effort_coefficients > 1:
        following = effort[(np.arange(layout.n_intervals) + 1) % layout.n_intervals, 0]
        pairs = np.stack([effort[:, -1], following], axis=-1)[: None if periodic else -1].reshape(-1, 2)
        blocks.append((pairs, np.tile([1.0, -1.0], (len(pairs), 1)), 0.0, 0.0))
    if layout.n_segments > 1 and problem.motion.duration_s is not None:
        total = float(np.sum(durations)) / scales.time_s
        blocks.append((layout.durations()[None, :], np.ones((1, layout.n_segments)), total, total))
    elif layout.n_segments > 1 and problem.motion.max_duration_s is not None:
        longest = problem.motion.max_duration_s / scales.time_s
        blocks.append((layout.durations()[None, :], np.ones((1, layout.n_segments)), -np.inf, longest))
    if layout.n_extra:
        for j in range(layout.n_u):
            place = effort[:, :, j].reshape(-1, 1)
            columns = np.hstack([place, np.full_like(place, layout.extra()[0])])
            for bound, low, high in ((limit[j, 0], 0.0, np.inf), (limit[j, 1], -np.inf, 0.0)):
                if np.isfinite(bound):
                    rows = np.tile([1.0, -bound / scales.effort[j]], (len(place), 1))
                    at = np.zeros(len(place), dtype=bool) if held is None else held[:, :, j].ravel() == bound
                    blocks.append((columns[~at], rows[~at], low, high))
                    blocks.append((columns[at], rows[at], 0.0, 0.0))  # held at the limit, whatever its factor
    if not blocks:
        return sp.csr_matrix((0, layout.size)), np.zeros(0), np.zeros(0)
    matrices = []
    for columns, values, _, _ in blocks:
        row = np.repeat(np.arange(len(columns)), columns.shape[1])
        matrices.append(sp.csr_matrix((values.ravel(), (row, columns.ravel())), shape=(len(columns), layout.size)))
    lower = np.concatenate([np.full(len(block[0]), block[2]) for block in blocks])
    upper = np.concatenate([np.full(len(block[0]), block[3]) for block in blocks])
    return sp.vstack(matrices).tocsr(), lower, upper


def bounds(problem: PlanningProblem, layout: Layout, mesh: Mesh, durations, scales: Scales, pinned):
    """Return the unknowns' bounds: ranges, speeds, effort limits, boundary states, durations, efforts that are held."""
    mechanism, motion, limit = problem.mechanism, problem.motion, problem.limits.effort
    lower, upper = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    n_s, rate = layout.n_s, scales.position / scales.time_s
    states = layout.states()
    position, speed = problem.limits.position, problem.limits.speed
    lower[states[:, :n_s]] = position[mechanism.independent, 0] / scales.position
    upper[states[:, :n_s]] = position[mechanism.independent, 1] / scales.position
    lower[states[:, n_s:]] = speed[mechanism.independent, 0] / rate
    upper[states[:, n_s:]] = speed[mechanism.independent, 1] / rate
    lower[layout.dependent()] = position[mechanism.dependent, 0]
    upper[layout.dependent()] = position[mechanism.dependent, 1]
    if not layout.n_extra:
        lower[layout.effort()] = limit[:, 0] / scales.effort
        upper[layout.effort()] = limit[:, 1] / scales.effort
    lower[layout.extra()] = 0.0
    held = held_efforts(pinned, mesh, layout)
    if held is not None:
        place = layout.effort()[~np.isnan(held)]
        lower[place] = upper[place] = (held / scales.effort)[~np.isnan(held)]

    def fix(k: int, s: np.ndarray | None, v: np.ndarray | None) -> None:
        for value, unit, place in ((s, scales.position, states[k, :n_s]), (v, rate, states[k, n_s:])):
            if value is not None:
                lower[place] = upper[place] = value / unit

    if motion.kind == "reach":
        rest = np.zeros(n_s)
        fix(0, motion.start, rest if motion.start_speed is None else motion.start_speed)
        fix(layout.n_intervals, motion.goal, rest if motion.goal_speed is None else motion.goal_speed)
    elif motion.kind == "periodic" and motion.start is not None:
        fix(0, motion.start, None)
        fix(layout.n_intervals // 2, motion.goal, None)
    scaled = np.asarray(durations) / scales.time_s
    place = layout.durations()
    if motion.duration_s is not None and layout.n_segments == 1:
        lower[place] = upper[place] = scaled
    else:
        lower[place] = _SHORTEST_SEGMENT * scaled
        longest = motion.max_duration_s or 100.0 * float(np.sum(durations))
        upper[place] = longest / scales.time_s
        if layout.n_segments > 1:
            # Cuts begin next to their switches: kept from wandering off, they settle there.
            room = _CUT_ROOM + 0.5 * scaled.sum() / (layout.n_intervals * scaled)
            lower[place], upper[place] = scaled / room, np.minimum(room * scaled, upper[place])
    return lower, upper


def row_bounds(problem, interval: IntervalFunctions, layout: Layout, speed_columns, speed_joints, scales: Scales):
    """Return the bounds of an interval's rows, repeated over the intervals: its own, then each node's."""
    lower, upper = np.zeros(interval.n_own), np.zeros(interval.n_own)
    speed, position = problem.limits.speed, problem.limits.position
    independent = problem.mechanism.independent
    own = {kind: np.flatnonzero([k == kind for k in interval.own_kinds]) for kind in ("speed", "position")}
    for place, column in zip(np.array_split(own["speed"], max(1, len(speed_columns))), speed_columns, strict=False):
        lower[place], upper[place] = speed[independent[column]] * scales.time_s / scales.position[column]
    for place, column in zip(np.array_split(own["position"], layout.n_s), range(layout.n_s), strict=True):
        if len(place):
            lower[place], upper[place] = position[independent[column]] / scales.position[column]
    of_path = speed[list(speed_joints)].reshape(-1, 2)
    node_lower = np.concatenate([np.zeros(interval.n_equations), of_path[:, 0]])
    node_upper = np.concatenate([np.zeros(interval.n_equations), of_path[:, 1]])
    lower = np.concatenate([lower, np.tile(node_lower, interval.n_nodes)])
    upper = np.concatenate([upper, np.tile(node_upper, interval.n_nodes)])
    return np.tile(lower, layout.n_intervals), np.tile(upper, layout.n_intervals)
