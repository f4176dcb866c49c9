"""Bounds and linear rows of a program, from a formulation's limits and phase boundaries, and its junctions.

Junctions are switch times at which an effort's limit and a limit on a quantity that contains the effort bind together. A
power u w or a torque-speed line continues an arc at the effort's limit without a jump. Rows at the nodes would impose this
twice, once from either side. With the mesh's error such a program is infeasible, or its junction is misplaced. So one
equation is imposed at the node of the switch (Bryson & Ho 1975, section 3.11: entry points), and the effort's own limit is
relaxed next to it; the violation vanishes as the mesh is refined.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from linkplan.planner.transcription.formulation import Formulation, Start
from linkplan.planner.transcription.interval import IntervalFunctions
from linkplan.planner.transcription.mesh import Layout, Mesh, Triplets, no_rows
from linkplan.planner.transcription.schemes import Scheme


def find_junctions(
    formulation: Formulation,
    mesh: Mesh,
    durations: np.ndarray,
    start: Start,
    bang_efforts: np.ndarray | None,
    constrained_paths: np.ndarray | None,
) -> np.ndarray | None:
    """Return the junctions (n_segments - 1, n_path) of path quantities between segments; None if there are none.

    1: the effort is held before and the quantity after. -1: the reverse. 0: the effort jumps, or neither is held.

    Args:
        formulation: the continuous problem.
        mesh: intervals.
        durations: (n_segments,) [s] of its segments in the start.
        start: the motion that gives the efforts.
        bang_efforts: (n_segments, n_u), NaN where they are free.
        constrained_paths: (n_segments, n_path).
    """
    if bang_efforts is None or constrained_paths is None or mesh.n_segments < 2:
        return None
    ends = np.concatenate([[0.0], np.cumsum(durations)])
    found = np.zeros((mesh.n_segments - 1, constrained_paths.shape[1]), dtype=int)
    for k, way, i in _candidates(formulation, bang_efforts, constrained_paths):
        arc, bang = (k + 1, k) if way > 0 else (k, k + 1)
        inside = ends[k + 1] + way * 0.05 * durations[arc]  # close to the switch, but clearly within the arc
        effort = start.nodes(np.array([inside]))[3].reshape(-1)
        changes = np.isnan(bang_efforts[arc]) & ~np.isnan(bang_efforts[bang])
        if np.any(changes) and np.all(effort[changes] * bang_efforts[bang, changes] > 0):
            found[k, i] = way
    return found if found.any() else None


def _candidates(
    formulation: Formulation, bang_efforts: np.ndarray, constrained_paths: np.ndarray
) -> Iterator[tuple[int, int, int]]:
    """Yield the ends of segments where a quantity that jumps with efforts begins (1) or ends (-1) to be held."""
    for k in range(len(bang_efforts) - 1):
        for i in formulation.rows.open_end_path:
            before, after = (bool(constrained_paths[at, i]) for at in (k, k + 1))
            if before != after:
                yield k, 1 if after else -1, i


def junction_places(junctions: np.ndarray | None, mesh: Mesh) -> Iterator[tuple[int, int, int, int]]:
    """Yield for each junction: the last interval before it, and its segment, path quantity and direction."""
    if junctions is None:
        return
    for k, i in zip(*np.nonzero(junctions), strict=True):
        yield int(np.flatnonzero(mesh.segment == k)[-1]), int(k), int(i), int(junctions[k, i])


def bang_coefficients(bang_efforts: np.ndarray | None, mesh: Mesh, layout: Layout) -> np.ndarray | None:
    """Return the held efforts (n_intervals, n_coefficients, n_u), NaN where an effort is free."""
    if bang_efforts is None:
        return None
    return np.repeat(bang_efforts[mesh.segment][:, None, :], layout.effort_coefficients, axis=1)


@dataclass(frozen=True, eq=False, slots=True)
class _Rows:
    """Blocks of rows that are linear in the unknowns: columns and coefficients (n, k), lower and upper bounds (n,)."""

    columns: list[np.ndarray] = field(default_factory=list)
    values: list[np.ndarray] = field(default_factory=list)
    lower: list[np.ndarray] = field(default_factory=list)
    upper: list[np.ndarray] = field(default_factory=list)

    def add(self, columns: np.ndarray, values: np.ndarray, lower: float | np.ndarray, upper: float | np.ndarray) -> None:
        self.columns.append(columns)
        self.values.append(values)
        self.lower.append(np.full(len(columns), lower))
        self.upper.append(np.full(len(columns), upper))

    def stacked(self, size: int):
        if not self.columns:
            return no_rows(size), np.zeros(0), np.zeros(0)
        counts = [len(columns) for columns in self.columns]
        firsts = np.cumsum([0, *counts])
        rows = [
            first + np.repeat(np.arange(n), columns.shape[1])
            for first, n, columns in zip(firsts, counts, self.columns, strict=False)
        ]
        linear = Triplets(
            rows=np.concatenate(rows),
            columns=np.concatenate([columns.ravel() for columns in self.columns]),
            values=np.concatenate([values.ravel() for values in self.values]),
            shape=(int(firsts[-1]), size),
        )
        return linear, np.concatenate(self.lower), np.concatenate(self.upper)


def linear_rows(formulation: Formulation, layout: Layout, mesh: Mesh, chosen: Scheme, bang: np.ndarray | None):
    """Return rows (n, size) with their lower and upper values.

    The rows impose periodic states, efforts and accelerations without jumps, the times of phase boundaries after several
    segments, and, where that factor is an unknown, efforts within a common factor of their limits.
    """
    rows, effort = _Rows(), layout.effort()
    if formulation.returns:
        of = list(formulation.returns)
        ends = np.stack([layout.state(layout.n_intervals)[of], layout.state(0)[of]], axis=1)
        rows.add(ends, np.tile([1.0, -1.0], (len(of), 1)), formulation.advance, formulation.advance)
    if formulation.smooth and layout.effort_coefficients > 1:
        smooth = effort[:, :, list(formulation.smooth)]
        following = np.roll(smooth[:, 0], -1, axis=0)
        pairs = np.stack([smooth[:, -1], following], axis=-1)[: None if formulation.periodic else -1].reshape(-1, 2)
        rows.add(pairs, np.tile([1.0, -1.0], (len(pairs), 1)), 0.0, 0.0)
    for columns, values, asked in _accelerations_without_jumps(formulation, layout, chosen):
        rows.add(columns, values, asked, asked)
    for group, low, high, weight in _boundary_groups(formulation, mesh):
        if len(group) > 1:
            rows.add(layout.durations()[group][None, :], weight[None, :], low, high)
    if layout.n_extra:
        limit, unit = formulation.effort, formulation.units.effort
        for j in range(layout.n_u):
            place = effort[:, :, j].reshape(-1, 1)
            columns = np.hstack([place, np.full_like(place, layout.extra()[0])])
            for bound, low, high in ((limit[j, 0], 0.0, np.inf), (limit[j, 1], -np.inf, 0.0)):
                if np.isfinite(bound):
                    factor = np.tile([1.0, -bound / unit[j]], (len(place), 1))
                    at = np.zeros(len(place), dtype=bool) if bang is None else bang[:, :, j].ravel() == bound
                    rows.add(columns[~at], factor[~at], low, high)
                    rows.add(columns[at], factor[at], 0.0, 0.0)  # held at the limit, whatever its factor
    return rows.stacked(layout.size)


def _accelerations_without_jumps(
    formulation: Formulation, layout: Layout, chosen: Scheme
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Yield columns and coefficients (n, k) of rows, and their value: accelerations with a bounded rate have no jumps.

    A motion that begins or ends at rest has no jump there either: its acceleration is zero at that end. Where efforts hold
    it, sums of accelerations are. At a moving end the acceleration is the one asked for.
    """
    first, last = chosen.acceleration_coefficients[[0, -1]]
    speeds = slice(layout.n_s, 2 * layout.n_s)
    rests = [np.all(formulation.boundaries[end].state[speeds] == 0.0, axis=1) for end in (0, -1)]
    for column in formulation.rows.smooth_columns:
        at = layout.acceleration()[:, :, column]  # (n, m)
        following = np.roll(at, -1, axis=0)
        pairs = np.hstack([at, following])[: None if formulation.periodic else -1]
        yield pairs, np.tile(np.concatenate([last, -first]), (len(pairs), 1)), 0.0
    smooth = list(formulation.rows.smooth_columns)
    for k, (rest, end, of) in enumerate(zip(rests, (0, -1), (first, last), strict=True)):
        still = np.eye(layout.n_s)[[column for column in smooth if rest[column]]]
        if rest.all() and formulation.holds_at_rest:
            import scipy

            sums = np.array(formulation.holds_at_rest[k])
            sums[:, smooth] = 0.0  # so that no row follows from the others
            still = np.vstack([still, scipy.linalg.orth(sums.T).T if len(sums) else sums])
        for weights in () if formulation.periodic else still:
            columns = np.flatnonzero(weights)
            yield layout.acceleration()[end][:, columns].reshape(1, -1), np.outer(of, weights[columns]).reshape(1, -1), 0.0
        asked = formulation.end_accelerations[k]
        for column in np.flatnonzero(np.isfinite(asked) & ~(rest & (rest.all() | np.isin(range(layout.n_s), smooth)))):
            yield layout.acceleration()[end, :, column][None], of[None], float(asked[column])


def _boundary_groups(formulation: Formulation, mesh: Mesh):
    """Yield per constraint on segment durations: segment indices, bounds on the weighted sum, and weights; all scaled."""
    begun, at = 0, 0.0
    for k, boundary in enumerate(formulation.boundaries[1:]):
        if boundary.share is not None:
            before = np.flatnonzero(mesh.phase <= k)
            weight = np.full(mesh.n_segments, -boundary.share)
            weight[before] += 1.0
            yield np.arange(mesh.n_segments), 0.0, 0.0, weight
        elif boundary.fixed:
            group = np.flatnonzero((mesh.phase >= begun) & (mesh.phase <= k))
            yield group, boundary.time[0] - at, boundary.time[0] - at, np.ones(len(group))
            begun, at = k + 1, boundary.time[0]
        elif boundary.time[0] > 0 or np.isfinite(boundary.time[1]):
            group = np.flatnonzero((mesh.phase >= begun) & (mesh.phase <= k))
            yield group, boundary.time[0] - at, boundary.time[1] - at, np.ones(len(group))


def bounds(
    formulation: Formulation,
    layout: Layout,
    mesh: Mesh,
    durations: np.ndarray,
    bang_efforts: np.ndarray | None,
    open_end_z: tuple[int, ...] = (),
    junctions: np.ndarray | None = None,
):
    """Return lower and upper bounds (n,) of the unknowns.

    Args:
        formulation: limits, phase boundaries and units.
        layout: the unknowns.
        mesh: the intervals.
        durations: guessed segment durations (n_segments,) [s].
        bang_efforts: held efforts (n_segments, n_u), NaN where an effort is free.
        open_end_z: the algebraic unknowns at open ends.
        junctions: the result of `find_junctions`.
    """
    lower, upper = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    states = layout.states()
    lower[states], upper[states] = formulation.state.T
    lower[layout.dependent()], upper[layout.dependent()] = formulation.algebraic.T
    lower[layout.open_end_dependent()], upper[layout.open_end_dependent()] = formulation.algebraic[list(open_end_z)].T
    unit = formulation.units.effort
    if not layout.n_extra or formulation.peak is not None:
        lower[layout.effort()] = formulation.effort[:, 0] / unit
        upper[layout.effort()] = formulation.effort[:, 1] / unit
    if formulation.end_efforts is not None:
        place, (low, high) = layout.effort()[[0, -1], [0, -1]], np.moveaxis(formulation.end_efforts / unit[:, None], -1, 0)
        lower[place], upper[place] = np.maximum(lower[place], low), np.minimum(upper[place], high)
    lower[layout.extra()] = 0.0
    bang = bang_coefficients(bang_efforts, mesh, layout)
    if bang is not None:
        place = layout.effort()[~np.isnan(bang)]
        lower[place] = upper[place] = (bang / unit)[~np.isnan(bang)]
        _with_junctions(lower, upper, formulation, layout, mesh, bang_efforts, junctions)
    for k, boundary in zip(mesh.boundaries(), formulation.boundaries, strict=True):
        lower[states[k]] = np.maximum(lower[states[k]], boundary.state[:, 0])
        upper[states[k]] = np.minimum(upper[states[k]], boundary.state[:, 1])
        fixed = boundary.state[:, 0] == boundary.state[:, 1]  # a prescribed state overrides the limits
        lower[states[k][fixed]] = upper[states[k][fixed]] = boundary.state[fixed, 0]
    scaled = np.asarray(durations) / formulation.units.time_s
    place = layout.durations()
    # A free segment stays between 0.02 of its guessed duration and 100 times the whole guessed duration.
    lower[place], upper[place] = 0.02 * scaled, 100.0 * scaled.sum()
    between_switches = np.bincount(mesh.phase)[mesh.phase] > 1
    # Segments between switch times may change by this factor plus half a mean interval: bounded, switch times converge to a
    # nearby solution. Guessed switch times beside constrained arcs are less accurate, and junction equations fix these.
    factor = 1.1 if junctions is None else 1.3
    room = factor + 0.5 * scaled.sum() / (layout.n_intervals * scaled)
    lower[place[between_switches]], upper[place[between_switches]] = (
        (scaled / room)[between_switches],
        (room * scaled)[between_switches],
    )
    for group, low, high, _ in _boundary_groups(formulation, mesh):
        if len(group) == 1:
            one = place[group[0]]
            lower[one], upper[one] = (low, high) if low == high else (max(lower[one], low), min(upper[one], high))
    return lower, upper


def _given_nodes(formulation: Formulation, mesh: Mesh, nodes: np.ndarray) -> np.ndarray:
    """Return a mask (n, n_nodes) of the nodes at phase boundaries that prescribe all positions.

    Args:
        formulation: its phase boundaries.
        mesh: intervals.
        nodes: positions (n_nodes,) of the nodes in the unit interval.
    """
    found = np.zeros((mesh.n_intervals, len(nodes)), dtype=bool)
    for k, boundary in zip(mesh.boundaries(), formulation.boundaries, strict=True):
        if np.all(boundary.state[: formulation.n_s, 0] == boundary.state[: formulation.n_s, 1]):
            found[k : k + 1] |= nodes == 0.0
            found[max(k - 1, 0) : k] |= nodes == 1.0
    return found


def _with_junctions(lower, upper, formulation: Formulation, layout: Layout, mesh: Mesh, bang_efforts, junctions) -> None:
    """Widen the effort bounds beside a junction by the limits' span, and fix the effort at the end of a constrained arc."""
    room, unit = np.diff(formulation.effort, axis=1).ravel(), formulation.units.effort
    for last, segment, _, way in junction_places(junctions, mesh):
        arc, bang = (segment + 1, segment) if way > 0 else (segment, segment + 1)
        beside = last + 1 if way > 0 else last
        for j in np.flatnonzero(np.isnan(bang_efforts[arc]) & ~np.isnan(bang_efforts[bang])):
            place = layout.effort()[beside, :, j]
            lower[place], upper[place] = lower[place] - room[j] / unit[j], upper[place] + room[j] / unit[j]
            if way < 0:
                lower[place[-1]] = upper[place[-1]] = bang_efforts[bang, j] / unit[j]


def row_bounds(
    formulation: Formulation,
    chosen: Scheme,
    interval: IntervalFunctions,
    mesh: Mesh,
    breaks_s: np.ndarray,
    constrained_paths: np.ndarray | None,
    junctions: np.ndarray | None,
):
    """Return the lower and upper bounds of each interval's rows: its own rows, its nodes' rows, its open ends' rows.

    Args:
        formulation: its limits; at nodes with prescribed positions `position_path` needs no bound.
        chosen: the transcription.
        interval: the rows.
        mesh: the intervals; a node ends the interval before each phase boundary where `passed` has a value.
        breaks_s: (n + 1,) of the mesh [s].
        constrained_paths: (n_segments, n_path) path quantities held at nodes at their upper limit (1) or lower limit (-1).
        junctions: the result of `find_junctions`.
    """
    n, m = len(breaks_s) - 1, interval.n_nodes
    own = np.zeros((interval.n_own, 2))
    for row, (kind, item) in enumerate(zip(interval.own_kinds, interval.own_items, strict=True)):
        if kind != "continuity":
            own[row] = formulation.own[kind][item]
    path = np.broadcast_to(formulation.path.reshape(-1, 2), (n, interval.n_path, 2))
    if formulation.tightening is not None:
        path = path + formulation.tightening(breaks_s)[:, :, None] * np.array([1.0, -1.0])
    at_open_ends, at_nodes = np.array(path), np.repeat(path[:, None], m, axis=1)
    if constrained_paths is not None:
        continuous = set() if 1 in chosen.open_ends else set(range(interval.n_path)) - set(formulation.rows.open_end_path)
        held, meetings = constrained_paths[mesh.segment], tuple(junction_places(junctions, mesh))
        _hold_paths(path, at_nodes, at_open_ends, held, meetings, continuous)
    if formulation.position_path:
        given = _given_nodes(formulation, mesh, np.asarray(chosen.nodes, dtype=float))
        out_of_the_way = np.array([-10.0, 10.0])  # scaled quantities are of order one, so this never binds
        at_nodes[:, :, list(formulation.position_path)] += given[:, :, None, None] * out_of_the_way
    for boundary, i, value in formulation.passed:
        at_nodes[mesh.boundaries()[boundary] - 1, -1, i] = value
    equations = np.zeros((n, m, interval.n_equations, 2))
    at_nodes = np.concatenate([equations, at_nodes], axis=2).reshape(n, -1, 2)
    at_open_ends = np.concatenate([equations[:, 0], at_open_ends], axis=1)[:, list(interval.open_end_rows)]
    own = np.tile(own, (n, 1, 1))
    for kind, tightening in formulation.own_tightening.items():
        amount = tightening(breaks_s)
        for row in np.flatnonzero(np.array(interval.own_kinds) == kind):
            own[:, row] += amount[:, interval.own_items[row], None] * np.array([1.0, -1.0])
    both = np.concatenate([own, at_nodes, np.tile(at_open_ends, (1, interval.n_open_ends, 1))], axis=1)
    return both[:, :, 0].ravel(), both[:, :, 1].ravel()


def _hold_paths(path, at_nodes, at_open_ends, constrained_paths, meetings, continuous: set[int]) -> None:
    """Set the bounds at nodes and open ends of held path quantities; `continuous` ones are held from the node before too."""
    for k, i in zip(*np.nonzero(constrained_paths), strict=True):
        # The tightest limit of all intervals holds on the whole arc, because an arc is smooth and joins the next one.
        limit = path[:, i, 1].min() if constrained_paths[k, i] > 0 else path[:, i, 0].max()
        at_nodes[k, :, i] = limit
        at_open_ends[k, i] = -np.inf, np.inf  # the nodes already hold the quantity
        if k and constrained_paths[k - 1, i] == 0 and i in continuous:
            at_nodes[k - 1, -1, i] = limit  # a continuous quantity is at its limit when the arc begins
    for last, _, i, way in meetings:
        if way > 0:
            at_nodes[last, -1, i] = at_nodes[last + 1, -1, i]  # the value held on the next arc
        else:
            at_open_ends[last + 1, i] = -np.inf, np.inf
