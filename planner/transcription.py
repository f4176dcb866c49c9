"""From a planning problem to numbers for a solver, and from a solver's numbers back to a trajectory."""

import time
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from models.along import needed_effort
from models.assembly import close_at
from models.mechanism import Mechanism
from planner.compiled import cached, compiled, key_of
from planner.guess import Guess, poses_along
from planner.interval import SMOOTHING, IntervalFunctions, IntervalRows, Layout, build_interval
from planner.mechanics import Scales, mechanism_system
from planner.mesh import Mesh
from planner.problem import PlanningProblem
from planner.program import Program, build_program
from planner.schemes import Scheme, scheme
from planner.trajectory import Trajectory

# Free segments may shrink to this share of their guessed duration and no further, so that no interval collapses.
_SHORTEST_SEGMENT = 0.02
# A segment between cuts may shrink or stretch by this factor, and by half a mean interval beyond it.
_CUT_ROOM = 1.1
# Efforts stay this share inside their limits, so that no rounding in evaluating the polynomial carries them outside.
_ROUNDING = 4e-15
# From this many intervals on, compiling (about a second) costs less than a dozen interpreted iterations.
_WORTH_COMPILING = 400
# Share of a limit that a guessed effort may use: interior-point methods want room.
_GUESS_ROOM = 0.95


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Transcribed:
    """A program with the numbers that one problem puts into it."""

    program: Program
    scheme: Scheme
    scales: Scales
    parameters: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    row_lower: np.ndarray
    row_upper: np.ndarray
    start: np.ndarray
    objective_scale: float  # objective = scale * the program's value
    mechanism: Mechanism
    start_pose: np.ndarray  # closed, near the start
    periodic: bool
    build_s: float  # time that building took [s]


def choose_scales(problem: PlanningProblem, guess: Guess) -> Scales:
    """Return units of order one: durations, spans, limits, or the guess's needs where they are far below the limits."""
    mechanism, limit = problem.mechanism, problem.limits.effort
    sampled = np.linspace(0.0, guess.duration_s, 61)
    s = guess.position(sampled)
    poses = poses_along(mechanism, guess, sampled)
    need, _ = needed_effort(mechanism, poses, guess.velocity(sampled), guess.acceleration(sampled))
    need = np.abs(need).max(axis=0)
    largest = np.where(np.isfinite(limit), np.abs(limit), 0.0).max(axis=1)
    if problem.objective == "time":
        effort = np.where(largest > 0, largest, need)
    else:
        effort = np.where(largest > 0, np.minimum(largest, need), need)
    effort = np.where(effort > 0, effort, 1.0)
    extent = float(mechanism.model.stat.extent)
    unit = np.array([1.0 if joint.kind == "hinge" else extent for joint in mechanism.independent_joints])
    span = np.ptp(s, axis=0)
    maps = np.array([np.array(mechanism.dynamics.effort_map(q)) for q in poses[::10]])
    residual = np.abs(maps).max(axis=0) @ effort
    return Scales(
        time_s=guess.duration_s,
        position=np.where(span > 1e-3 * unit, span, unit),
        effort=effort,
        residual=np.where(residual > 0, residual, effort.max()),
        length_m=extent,
    )


def transcribe(
    problem: PlanningProblem,
    guess: Guess,
    mesh: Mesh,
    durations: np.ndarray,
    *,
    scales: Scales | None = None,
    effort_limit: np.ndarray | None = None,
    position_rows: bool = False,
    least_limit: bool = False,
    pinned: np.ndarray | None = None,
) -> Transcribed:
    """Return the program of a problem on a mesh, with bounds and a starting point.

    Args:
        problem: what to plan.
        guess: the motion to start from.
        mesh: intervals; its segments have `durations` (n_segments,) [s] in the guess.
        durations: guessed durations of the segments.
        scales: units; chosen from the guess by default.
        effort_limit: (n_u, 2) in place of the problem's.
        position_rows: whether independent ranges are kept between the nodes by constraint rows.
        pinned: (n_segments, n_u) efforts held over whole segments, NaN where they are free.
        least_limit: seek, in place of the objective, the smallest common factor on the effort limits.
    """
    begin = time.perf_counter()
    mechanism, chosen = problem.mechanism, scheme(problem.mesh.scheme, problem.mesh.effort)
    scales = scales or choose_scales(problem, guess)
    objective = "none" if least_limit or problem.objective == "time" else problem.objective
    speed_limited = [i for i in range(mechanism.n_q) if np.any(np.isfinite(problem.limits.speed[i]))]
    speed_columns = tuple(k for k, i in enumerate(mechanism.independent) if i in speed_limited)
    speed_joints = tuple(i for i in speed_limited if i not in mechanism.independent)
    rows = IntervalRows(
        effort_weight=tuple((scales.effort / scales.effort.max()) ** 2) if objective == "effort" else (),
        rate_weight=SMOOTHING if objective == "tracking" else 0.0,
        speed_columns=speed_columns,
        position_rows=position_rows,
    )
    interval = _interval(problem, chosen, rows, objective == "tracking", speed_joints, mesh.n_intervals)
    layout = Layout(
        n_s=mechanism.dof,
        n_z=mechanism.n_q - mechanism.dof,
        n_u=mechanism.n_u,
        n_nodes=chosen.n_nodes,
        n_effort=chosen.effort_at.shape[1],
        n_intervals=mesh.n_intervals,
        n_segments=mesh.n_segments,
        n_extra=int(least_limit),
    )
    limit = problem.limits.effort if effort_limit is None else effort_limit
    # (n_intervals, n_coefficients, n_u) of what is held where, NaN where nothing is
    held = None if pinned is None else np.repeat(pinned[mesh.segment][:, None, :], layout.effort_coefficients, axis=1)
    linear, linear_lower, linear_upper = _linear_rows(problem, layout, durations, scales, limit, held)
    cost = np.zeros(layout.size)
    cost[layout.extra()] = 1.0
    if problem.objective == "time" and not least_limit:
        cost[layout.durations()] = 1.0
    program = build_program(layout, mesh, interval, linear, cost)
    lower, upper = _bounds(problem, layout, durations, scales, limit)
    if held is not None and not least_limit:
        place = layout.effort()[~np.isnan(held)]
        lower[place] = upper[place] = (held / scales.effort)[~np.isnan(held)]
    row_lower, row_upper = _row_bounds(problem, interval, layout, speed_columns, speed_joints, scales)
    breaks = mesh.breaks(durations)
    return Transcribed(
        program=program,
        scheme=chosen,
        scales=scales,
        parameters=_parameters(problem, chosen, mesh, breaks, scales),
        lower=lower,
        upper=upper,
        row_lower=np.concatenate([row_lower, linear_lower]),
        row_upper=np.concatenate([row_upper, linear_upper]),
        start=_start(mechanism, guess, chosen, layout, breaks, durations, scales, limit),
        objective_scale=1.0 if least_limit else _objective_scale(problem, scales),
        mechanism=mechanism,
        start_pose=np.array(guess.start_pose),
        periodic=problem.motion.kind == "periodic",
        build_s=time.perf_counter() - begin,
    )


def _interval(problem, chosen: Scheme, rows: IntervalRows, tracking: bool, speed_joints, n_intervals) -> IntervalFunctions:
    """Return the functions of one interval: compiled ones where they are wanted or at hand."""
    mechanism, mode = problem.mechanism, problem.solver.compile

    def build() -> IntervalFunctions:
        return build_interval(mechanism_system(mechanism, tracking, speed_joints), chosen, rows)

    if mode == "never":
        return build()
    key = key_of(mechanism.fingerprint(), chosen.name, chosen.effort_at, repr(rows), tracking, speed_joints)
    if mode == "always" or n_intervals >= _WORTH_COMPILING:
        return compiled(key, build)
    return cached(key) or build()


def _objective_scale(problem: PlanningProblem, scales: Scales) -> float:
    if problem.objective == "time":
        return scales.time_s
    unit = scales.effort.max() if problem.objective == "effort" else scales.position.max()
    return scales.time_s * float(unit) ** 2


def _linear_rows(problem: PlanningProblem, layout: Layout, durations, scales: Scales, limit: np.ndarray, pinned):
    """Return rows (n, size) with their lower and upper values.

    A periodic motion's return, an effort without jumps where a reference is tracked, the total duration where cuts move,
    and efforts within a factor of their limits where that factor is sought.
    """
    blocks: list[tuple[np.ndarray, np.ndarray, float, float]] = []  # columns, coefficients (n, k); lower, upper
    ones = np.ones((layout.n_s * 2, 1))
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
                    at = np.zeros(len(place), dtype=bool) if pinned is None else pinned[:, :, j].ravel() == bound
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


def _bounds(problem: PlanningProblem, layout: Layout, durations: np.ndarray, scales: Scales, limit: np.ndarray):
    mechanism, motion = problem.mechanism, problem.motion
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


def _row_bounds(problem, interval: IntervalFunctions, layout: Layout, speed_columns, speed_joints, scales: Scales):
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


def _parameters(problem, chosen: Scheme, mesh: Mesh, breaks: np.ndarray, scales: Scales) -> np.ndarray:
    """Return the parameter vector: per interval its share, the reference at its nodes, the scales."""
    times = breaks[:-1, None] + np.diff(breaks)[:, None] * chosen.nodes
    n, m = times.shape
    if problem.reference is not None:
        reference = problem.reference.derivative(times.ravel()).reshape(n, m, -1) / scales.position
    else:
        reference = np.zeros((n, m, problem.mechanism.dof))
    theta = np.concatenate([reference, np.broadcast_to(scales.vector(), (n, m, len(scales.vector())))], axis=2)
    return np.hstack([mesh.fraction[:, None], theta.reshape(n, -1)]).ravel()


def _start(mechanism: Mechanism, guess: Guess, chosen, layout: Layout, breaks, durations, scales, limit) -> np.ndarray:
    """Return the starting point (n,): the guess sampled at the nodes, loops closed, efforts inside their limits."""
    x = np.zeros(layout.size)
    rate = scales.position / scales.time_s
    states = layout.states()
    x[states[:, : layout.n_s]] = guess.position(breaks) / scales.position
    x[states[:, layout.n_s :]] = guess.velocity(breaks) / rate
    n, m = layout.n_intervals, layout.n_nodes
    # The right end of an interval belongs to the next one; step a hair inside, where accelerations may jump.
    nodes = np.clip(chosen.nodes, 0.0, 1.0 - 1e-9)
    times = (breaks[:-1, None] + np.diff(breaks)[:, None] * nodes).ravel()
    acceleration = guess.acceleration(times)
    poses = poses_along(mechanism, guess, times)
    x[layout.acceleration().ravel()] = (acceleration / (rate / scales.time_s)).ravel()
    x[layout.dependent().ravel()] = poses[:, mechanism.dependent].ravel()
    effort = (
        guess.effort(times)
        if guess.effort is not None
        else needed_effort(mechanism, poses, guess.velocity(times), acceleration)[0]
    )
    coefficients = np.einsum("ij,kju->kiu", np.linalg.pinv(chosen.effort_at), effort.reshape(n, m, -1))
    x[layout.durations()] = np.asarray(durations) / scales.time_s
    if layout.n_extra:
        x[layout.effort()] = coefficients / scales.effort
        x[layout.extra()] = 1.1 * np.max(np.abs(coefficients) / np.abs(limit).max(axis=1))
        return x
    middle, half = 0.5 * limit.sum(axis=1), 0.5 * np.diff(limit, axis=1).ravel()
    finite = np.isfinite(half)
    low = np.where(finite, middle - _GUESS_ROOM * half, limit[:, 0])
    high = np.where(finite, middle + _GUESS_ROOM * half, limit[:, 1])
    x[layout.effort()] = np.clip(coefficients, low, high) / scales.effort
    return x


def trajectory_of(transcribed: Transcribed, x: np.ndarray, limit: np.ndarray) -> Trajectory:
    """Return the continuous motion of a program's unknowns x (n,); efforts are cut at `limit` against rounding."""
    program, scales, chosen = transcribed.program, transcribed.scales, transcribed.scheme
    layout, mesh = program.layout, program.mesh
    breaks = mesh.breaks(x[layout.durations()] * scales.time_s)
    h = np.diff(breaks)[:, None]
    states = x[layout.states()]
    s = states[:-1, : layout.n_s] * scales.position
    v = states[:-1, layout.n_s :] * scales.position / scales.time_s
    a = x[layout.acceleration()] * scales.position / scales.time_s**2
    degree = len(chosen.position_coefficients) - 1
    tau = (np.arange(degree + 1) / degree)[:, None, None]
    velocity = v + h * np.einsum("pj,kjs->pks", chosen.velocity_coefficients, a)
    position = s + tau * h * v + h**2 * np.einsum("pj,kjs->pks", chosen.position_coefficients, a)
    inside = _ROUNDING * np.abs(limit)
    effort = np.clip(x[layout.effort()] * scales.effort, limit[:, 0] + inside[:, 0], limit[:, 1] - inside[:, 1])
    return Trajectory(
        breaks_s=breaks,
        position=position,
        velocity=velocity,
        effort=effort.transpose(1, 0, 2),
        start_pose=close_at(transcribed.mechanism, position[0, 0], transcribed.start_pose),
        periodic=transcribed.periodic,
    )
