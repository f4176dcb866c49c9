"""Direct collocation: build a nonlinear program from a formulation on a mesh, and convert a solution to curves."""

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from linkplan.models.compiled.functions import CodeT, cached, compiled_as_asked
from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.planner.transcription.bounds import (
    bang_coefficients,
    bounds,
    find_junctions,
    linear_rows,
    row_bounds,
)
from linkplan.planner.transcription.formulation import Formulation, Start, Units, stretched_durations
from linkplan.planner.transcription.interval import (
    ChainFunctions,
    IntervalFunctions,
    build_chain,
    interval_of,
    open_end_path,
)
from linkplan.planner.transcription.mesh import Layout, Mesh, Triplets
from linkplan.planner.transcription.program import Program, build_program, chain_key, node_key, without_numbers
from linkplan.planner.transcription.schemes import Scheme
from linkplan.planner.transcription.system import Endpoint, NodeFunctions, build_node

# Efforts stay this share inside their limits, so that rounding in evaluating the polynomial cannot exceed a limit.
_LIMIT_ROUNDING_SHARE = 4e-15
# From this many intervals on, compiling (half a second) costs less than a dozen interpreted iterations.
_MIN_COMPILED_INTERVALS = 400


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Transcribed:
    """A program with the numbers of one problem.

    `bang_efforts` (n_segments, n_u) are efforts held over whole segments. `constrained_paths` (n_segments, n_path) marks
    path quantities held at their upper limit (1) or lower limit (-1). `junctions` (n_segments - 1, n_path) marks the
    switches between them. With `least_limit` the program minimises the common factor on the effort limits instead of the
    objective. `numbers` (n_numbers,) are the constants of the system's expressions. `origin` is data of the caller.
    """

    program: Program
    scheme: Scheme
    formulation: Formulation
    parameters: np.ndarray
    numbers: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    row_lower: np.ndarray
    row_upper: np.ndarray
    start: np.ndarray
    bang_efforts: np.ndarray | None
    constrained_paths: np.ndarray | None
    junctions: np.ndarray | None
    least_limit: bool
    build_s: float  # building time [s]
    origin: Any = None

    @property
    def units(self) -> Units:
        """The units of the scaled unknowns."""
        return self.formulation.units

    @property
    def objective_scale(self) -> float:
        """The ratio of the objective in SI units to the program's value."""
        return 1.0 if self.least_limit else self.units.objective


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Curves:
    """A solution's polynomials: Bernstein coefficients (degree + 1, n, k) on n intervals, in the problem's units.

    `state` and `effort` are those of the first-order states and of the efforts, `position` and `velocity` those of the
    second-order coordinates. `breaks_s` (n + 1,) are the intervals' ends [s].
    """

    breaks_s: np.ndarray
    state: np.ndarray
    effort: np.ndarray
    position: np.ndarray
    velocity: np.ndarray


def collocate(
    formulation: Formulation,
    chosen: Scheme,
    mesh: Mesh,
    durations: np.ndarray,
    start: Start,
    *,
    compile_mode: str = "auto",
    deadline: Deadline = NO_DEADLINE,
    least_limit: bool = False,
    bang_efforts: np.ndarray | None = None,
    constrained_paths: np.ndarray | None = None,
) -> Transcribed:
    """Return the program of a formulation on a mesh, with bounds and a starting point.

    Args:
        formulation: the continuous problem.
        chosen: the transcription.
        mesh: intervals; its phases lie between the formulation's phase boundaries.
        durations: guessed durations (n_segments,) [s] of its segments.
        start: the motion to start from.
        compile_mode: "auto", "always" or "never".
        deadline: ends compilation.
        least_limit: minimise the common factor on the effort limits instead of the objective.
        bang_efforts: (n_segments, n_u) efforts held over whole segments, NaN where they are free.
        constrained_paths: (n_segments, n_path) path quantities held at their upper limit (1) or lower limit (-1) over whole
            segments.
    """
    begin = time.perf_counter()
    interval = _interval(formulation, chosen, mesh.n_intervals, compile_mode, deadline)
    layout = Layout(
        n_s=formulation.n_s,
        n_x=formulation.n_x,
        n_z=formulation.n_z,
        n_u=formulation.n_u,
        n_nodes=chosen.n_nodes,
        n_effort=chosen.effort_at.shape[1],
        n_intervals=mesh.n_intervals,
        n_segments=mesh.n_segments,
        n_extra=int(least_limit or formulation.peak is not None),
        n_open_ends=interval.n_open_ends,
        n_z_open_end=len(interval.open_end_z),
    )
    durations = stretched_durations(durations, formulation.boundaries, mesh.phase, formulation.units.time_s)
    linear, linear_lower, linear_upper = linear_rows(
        formulation, layout, mesh, chosen, bang_coefficients(bang_efforts, mesh, layout) if least_limit else None
    )
    junctions = None
    if 1 not in chosen.open_ends and not least_limit:  # a junction's equation needs a node at the interval's end
        junctions = find_junctions(formulation, mesh, durations, start, bang_efforts, constrained_paths)
    lower, upper = bounds(
        formulation, layout, mesh, durations, None if least_limit else bang_efforts, interval.open_end_z, junctions
    )
    breaks, (_, numbers) = mesh.breaks(durations), without_numbers(formulation.build_system())
    row_lower, row_upper = row_bounds(formulation, chosen, interval, mesh, breaks, constrained_paths, junctions)
    return Transcribed(
        program=_program(layout, mesh, interval, linear, formulation.endpoint, _extra_cost(formulation, least_limit)),
        scheme=chosen,
        formulation=formulation,
        parameters=_parameters(formulation, chosen, interval.n_open_ends, mesh, breaks, numbers),
        numbers=numbers,
        lower=lower,
        upper=upper,
        row_lower=np.concatenate([row_lower, linear_lower, formulation.endpoint_bounds[:, 0]]),
        row_upper=np.concatenate([row_upper, linear_upper, formulation.endpoint_bounds[:, 1]]),
        start=_start(formulation, start, chosen, interval, layout, breaks, durations),
        bang_efforts=bang_efforts,
        constrained_paths=constrained_paths,
        junctions=junctions,
        least_limit=least_limit,
        build_s=time.perf_counter() - begin,
    )


def renumbered_with(transcribed: Transcribed, formulation: Formulation, x: np.ndarray) -> Transcribed:
    """Return a program with the numbers of another formulation, without building it again.

    Args:
        transcribed: a program of the same structure.
        formulation: gives the new numbers, in the same units.
        x: unknowns to start from, usually the last solution; prescribed times are replaced by the new formulation's.
    """
    begin = time.perf_counter()
    program = transcribed.program
    layout, mesh, unit = program.layout, program.mesh, formulation.units.time_s
    durations = stretched_durations(x[layout.durations()] * unit, formulation.boundaries, mesh.phase, unit)
    start = np.array(x)
    start[layout.durations()] = durations / unit
    lower, upper = bounds(
        formulation, layout, mesh, durations, transcribed.bang_efforts, program.interval.open_end_z, transcribed.junctions
    )
    _, linear_lower, linear_upper = linear_rows(formulation, layout, mesh, transcribed.scheme, None)
    breaks, open_ends, numbers = mesh.breaks(durations), program.interval.n_open_ends, transcribed.numbers
    row_lower, row_upper = row_bounds(
        formulation, transcribed.scheme, program.interval, mesh, breaks, transcribed.constrained_paths, transcribed.junctions
    )
    return replace(
        transcribed,
        formulation=formulation,
        parameters=_parameters(formulation, transcribed.scheme, open_ends, mesh, breaks, numbers),
        lower=lower,
        upper=upper,
        row_lower=np.concatenate([row_lower, linear_lower, formulation.endpoint_bounds[:, 0]]),
        row_upper=np.concatenate([row_upper, linear_upper, formulation.endpoint_bounds[:, 1]]),
        start=np.clip(start, lower, upper),
        build_s=time.perf_counter() - begin,
    )


def _interval(
    formulation: Formulation, chosen: Scheme, n_intervals: int, mode: str, deadline: Deadline
) -> IntervalFunctions:
    """Return the functions of one interval, compiled if the mode asks for it or the cache has them."""
    (system, _), rows = without_numbers(formulation.build_system()), formulation.rows
    at_once = mode == "always" or (mode == "auto" and n_intervals >= _MIN_COMPILED_INTERVALS)

    def code(kind: type[CodeT], key: str, build: Callable[[], CodeT]) -> CodeT:
        if at_once:
            return compiled_as_asked(key, kind, build, "always", deadline)
        found = None if mode == "never" else cached(key, kind)
        by = functools.partial(compiled_as_asked, key, kind, build, mode, deadline)  # once in a process
        return _built(_BuildRequest(key=(key, kind, mode), by=by)) if found is None else found

    at_open_ends = open_end_path(chosen, rows)
    node = code(NodeFunctions, node_key(system, at_open_ends), lambda: build_node(system, at_open_ends))
    chain_named = chain_key(system, chosen, rows, node)
    chain = code(ChainFunctions, chain_named, lambda: build_chain(system, chosen, rows, node))
    return interval_of(system, chosen, rows, node, chain)


def with_compiled_code(transcribed: Transcribed, deadline: Deadline = NO_DEADLINE) -> Transcribed:
    """Return a program with compiled functions in place of interpreted ones; both give the same numbers.

    If compilation does not end within its share of the time until `deadline`, the functions stay interpreted.
    """
    begin = time.perf_counter()
    old, formulation = transcribed.program, transcribed.formulation
    interval = _interval(formulation, transcribed.scheme, old.mesh.n_intervals, "always", deadline)
    cost = _extra_cost(formulation, transcribed.least_limit)
    program = _program(old.layout, old.mesh, interval, old.linear, formulation.endpoint, cost)
    return replace(transcribed, program=program, build_s=transcribed.build_s + time.perf_counter() - begin)


@dataclass(frozen=True, slots=True, kw_only=True)
class _BuildRequest:
    """An argument for a memoised builder: equal keys share one result of the function `by`."""

    key: tuple
    by: Callable[[], Any] = field(compare=False)


@functools.lru_cache(maxsize=16)
def _built(request: _BuildRequest) -> Any:
    return request.by()


def _extra_cost(formulation: Formulation, least_limit: bool) -> float:
    """Return the linear cost of the extra unknown."""
    return 1.0 if least_limit else formulation.peak or 0.0


def _program(
    layout: Layout, mesh: Mesh, interval: IntervalFunctions, linear: Triplets, endpoint: Endpoint | None, extra_cost: float
) -> Program:
    """Return the program over a mesh; the extra unknown, if there is one, has a linear cost."""
    cost = np.zeros(layout.size)
    cost[layout.extra()] = extra_cost
    numbers = (mesh.fraction, mesh.segment, mesh.phase, linear.rows, linear.columns, linear.values)
    sizes = tuple(getattr(layout, name) for name in layout.__slots__)
    key = (sizes, interval.node, interval.chain, endpoint, linear.shape, extra_cost, *(part.tobytes() for part in numbers))
    return _built_program(_BuildRequest(key=key, by=lambda: build_program(layout, mesh, interval, linear, cost, endpoint)))


@functools.lru_cache(maxsize=4)
def _built_program(request: _BuildRequest) -> Program:
    return request.by()


def _parameters(
    formulation: Formulation, chosen: Scheme, n_open_ends: int, mesh: Mesh, breaks: np.ndarray, numbers: np.ndarray
) -> np.ndarray:
    """Return the parameters: per interval its share, its own, those of its nodes and open ends; then the endpoint's.

    A node's parameters end with the numbers (n,) of its system's expressions.
    """
    at = np.concatenate([chosen.nodes, chosen.open_ends[:n_open_ends]])
    times = breaks[:-1, None] + np.diff(breaks)[:, None] * at
    n = mesh.n_intervals
    theta = formulation.theta(times)
    theta = np.concatenate([theta, np.broadcast_to(numbers, (*theta.shape[:2], len(numbers)))], axis=2).reshape(n, -1)
    per_interval = np.hstack([mesh.fraction[:, None], np.tile(formulation.eta, (n, 1)), theta])
    return np.concatenate([per_interval.ravel(), formulation.endpoint_parameters])


def _start(
    formulation: Formulation,
    start: Start,
    chosen: Scheme,
    interval: IntervalFunctions,
    layout: Layout,
    breaks: np.ndarray,
    durations: np.ndarray,
) -> np.ndarray:
    """Return the starting point (n,): a motion sampled at breaks and nodes, with efforts inside their limits."""
    x = np.zeros(layout.size)
    x[layout.states()] = start.states(breaks)
    n, m = layout.n_intervals, layout.n_nodes
    # An interval's right end belongs to the next interval. Sample just before it, because accelerations may jump there.
    nodes = np.clip(chosen.nodes, 0.0, 1.0 - 1e-9)
    times = (breaks[:-1, None] + np.diff(breaks)[:, None] * nodes).ravel()
    acceleration, rate, algebraic, effort = start.nodes(times)
    x[layout.acceleration().ravel()] = acceleration.ravel()
    x[layout.rate().ravel()] = rate.ravel()
    x[layout.dependent().ravel()] = algebraic.ravel()
    if layout.n_open_ends and layout.n_z_open_end:
        ends = np.clip(np.array(chosen.open_ends, dtype=float), 0.0, 1.0 - 1e-9)
        times = (breaks[:-1, None] + np.diff(breaks)[:, None] * ends).ravel()
        x[layout.open_end_dependent().ravel()] = start.nodes(times)[2][:, list(interval.open_end_z)].ravel()
    coefficients = np.einsum("ij,kju->kiu", np.linalg.pinv(chosen.effort_at), effort.reshape(n, m, -1))
    x[layout.durations()] = np.asarray(durations) / formulation.units.time_s
    limit, unit = formulation.effort, formulation.units.effort
    if layout.n_extra:
        x[layout.extra()] = 1.1 * np.max(np.abs(coefficients) / np.abs(limit).max(axis=1))
    if layout.n_extra and formulation.peak is None:  # limits are sought, and none is satisfied yet
        x[layout.effort()] = coefficients / unit
        return x
    finite = np.all(np.isfinite(limit), axis=1)
    both = np.where(finite[:, None], limit, 0.0)
    middle, half = 0.5 * both.sum(axis=1), 0.5 * np.diff(both, axis=1).ravel()
    # Interior-point methods need a start inside the limits, unless it is close to a solution.
    low = np.where(finite, middle - start.share_of_effort * half, limit[:, 0])
    high = np.where(finite, middle + start.share_of_effort * half, limit[:, 1])
    x[layout.effort()] = np.clip(coefficients, low, high) / unit
    return x


def curves_of(transcribed: Transcribed, x: np.ndarray, limit: np.ndarray) -> Curves:
    """Return the polynomials of a program's unknowns x (n,); efforts are clipped to `limit` (n_u, 2) against rounding."""
    program, chosen, units = transcribed.program, transcribed.scheme, transcribed.units
    layout, n_s, T = program.layout, program.layout.n_s, transcribed.units.time_s
    breaks = program.mesh.breaks(x[layout.durations()] * T)
    h = np.diff(breaks)[:, None]
    states = x[layout.states()][:-1] * units.state
    s, v, first = states[:, :n_s], states[:, n_s : 2 * n_s], states[:, 2 * n_s :]
    a = x[layout.acceleration()] * units.state[:n_s] / T**2
    r = x[layout.rate()] * units.state[2 * n_s :] / T
    degree = len(chosen.position_coefficients) - 1
    tau = (np.arange(degree + 1) / degree)[:, None, None]

    def integrated(coefficients: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.einsum("pj,kjs->pks", coefficients, values)

    inside = np.where(np.isfinite(limit), _LIMIT_ROUNDING_SHARE * np.abs(limit), 0.0)
    effort = np.clip(x[layout.effort()] * units.effort, limit[:, 0] + inside[:, 0], limit[:, 1] - inside[:, 1])
    return Curves(
        breaks_s=breaks,
        position=s + tau * h * v + h**2 * integrated(chosen.position_coefficients, a),
        velocity=v + h * integrated(chosen.velocity_coefficients, a),
        state=first + h * integrated(chosen.velocity_coefficients, r),
        effort=effort.transpose(1, 0, 2),
    )
