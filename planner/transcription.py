"""From a planning problem to numbers for a solver, and from a solver's numbers back to a trajectory."""

import time
from dataclasses import dataclass, replace

import numpy as np

from models.along import needed_effort
from models.assembly import close_at
from models.mechanism import Mechanism
from planner.bounds import bounds, held_efforts, linear_rows, row_bounds, speed_limited
from planner.compiled import cached, compiled, key_of
from planner.guess import Guess, poses_along
from planner.interval import SMOOTHING, IntervalFunctions, IntervalRows, Layout, build_interval
from planner.mechanics import Scales, mechanism_system
from planner.mesh import Mesh
from planner.problem import PlanningProblem
from planner.program import Program, build_program
from planner.schemes import Scheme, scheme
from planner.trajectory import Trajectory

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
    pinned: np.ndarray | None  # (n_segments, n_u) efforts held over whole segments
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
        position_rows: whether independent ranges are kept between the nodes by constraint rows.
        pinned: (n_segments, n_u) efforts held over whole segments, NaN where they are free.
        least_limit: seek, in place of the objective, the smallest common factor on the effort limits.
    """
    begin = time.perf_counter()
    mechanism, chosen = problem.mechanism, scheme(problem.mesh.scheme, problem.mesh.effort)
    scales = scales or choose_scales(problem, guess)
    objective = "none" if least_limit or problem.objective == "time" else problem.objective
    speed_columns, speed_joints = speed_limited(problem)
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
    linear, linear_lower, linear_upper = linear_rows(
        problem, layout, durations, scales, held_efforts(pinned, mesh, layout) if least_limit else None
    )
    cost = np.zeros(layout.size)
    cost[layout.extra()] = 1.0
    if problem.objective == "time" and not least_limit:
        cost[layout.durations()] = 1.0
    lower, upper = bounds(problem, layout, mesh, durations, scales, None if least_limit else pinned)
    row_lower, row_upper = row_bounds(problem, interval, layout, speed_columns, speed_joints, scales)
    breaks = mesh.breaks(durations)
    return Transcribed(
        program=build_program(layout, mesh, interval, linear, cost),
        scheme=chosen,
        scales=scales,
        parameters=_parameters(problem, chosen, mesh, breaks, scales),
        lower=lower,
        upper=upper,
        row_lower=np.concatenate([row_lower, linear_lower]),
        row_upper=np.concatenate([row_upper, linear_upper]),
        start=_start(mechanism, guess, chosen, layout, breaks, durations, scales, problem.limits.effort),
        objective_scale=1.0 if least_limit else _objective_scale(problem, scales),
        mechanism=mechanism,
        start_pose=np.array(guess.start_pose),
        periodic=problem.motion.kind == "periodic",
        pinned=pinned,
        build_s=time.perf_counter() - begin,
    )


def renumbered(transcribed: Transcribed, problem: PlanningProblem, x: np.ndarray) -> Transcribed:
    """Return a program with another problem's numbers in it: boundary states, limits, duration, reference; nothing is built.

    Args:
        transcribed: of a problem with the same mechanism, kind, objective and mesh, and limits finite in the same places.
        problem: whose numbers to take.
        x: unknowns to start from, as a rule the last solution; a fixed duration is the new problem's.
    """
    begin = time.perf_counter()
    program, scales, mesh = transcribed.program, transcribed.scales, transcribed.program.mesh
    layout, interval = program.layout, program.interval
    durations = x[layout.durations()] * scales.time_s
    if problem.motion.duration_s is not None:
        durations = durations * problem.motion.duration_s / durations.sum()
    start = np.array(x)
    start[layout.durations()] = durations / scales.time_s
    lower, upper = bounds(problem, layout, mesh, durations, scales, transcribed.pinned)
    _, linear_lower, linear_upper = linear_rows(problem, layout, durations, scales, None)
    speed_columns, speed_joints = speed_limited(problem)
    row_lower, row_upper = row_bounds(problem, interval, layout, speed_columns, speed_joints, scales)
    return replace(
        transcribed,
        parameters=_parameters(problem, transcribed.scheme, mesh, mesh.breaks(durations), scales),
        lower=lower,
        upper=upper,
        row_lower=np.concatenate([row_lower, linear_lower]),
        row_upper=np.concatenate([row_upper, linear_upper]),
        start=np.clip(start, lower, upper),
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
