"""Bounds of unknowns: boundaries, durations, held arcs and their junctions."""

import itertools

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.transcription.bounds import (
    _boundary_groups,
    _given_nodes,
    _hold_paths,
    _with_junctions,
    bounds,
    find_junctions,
    linear_rows,
    row_bounds,
)
from linkplan.planner.transcription.formulation import Formulation, PhaseBoundary, Start
from linkplan.planner.transcription.interval import IntervalRows, build_chain, interval_of
from linkplan.planner.transcription.mesh import Layout, Mesh, segmented, uniform
from linkplan.planner.transcription.schemes import scheme
from linkplan.planner.transcription.system import System, build_node
from tests.support.formulations import formulation

INF = np.inf
FREE_TIME = (0.0, INF)
SCHEME = scheme("hermite-simpson")


def boundary(low: float = -INF, high: float = INF, time=FREE_TIME, share=None) -> PhaseBoundary:
    """Return a boundary with bounds on a position and a free speed."""
    return PhaseBoundary(state=np.array([[low, high], [-INF, INF]]), time=time, share=share)


def layout_of(mesh: Mesh) -> Layout:
    return Layout(n_s=1, n_z=0, n_u=1, n_nodes=3, n_intervals=mesh.n_intervals, n_segments=mesh.n_segments)


def bounds_of(problem: Formulation, mesh: Mesh, durations: np.ndarray) -> tuple[Layout, np.ndarray]:
    layout = layout_of(mesh)
    return layout, np.array(bounds(problem, layout, mesh, durations, None)).T


@pytest.mark.parametrize(
    ("asked", "expected"),
    [((-2.0, 0.5), [-1.0, 0.5]), ((0.2, 7.0), [0.2, 1.0]), ((0.3, 0.3), [0.3, 0.3]), ((1.5, 1.5), [1.5, 1.5])],
)
def test_a_boundary_narrows_the_limits_of_a_state_and_a_prescribed_state_overrides_them(asked, expected):
    layout, found = bounds_of(formulation(boundary(0.0, 0.0), boundary(*asked)), uniform(2), np.array([1.0]))
    assert found[layout.states()[:, 0]].tolist() == [[0.0, 0.0], [-1.0, 1.0], expected]


def durations_of(durations: np.ndarray, phase: list[int], n_intervals: int, *boundaries: PhaseBoundary) -> np.ndarray:
    """Return the bounds (n_segments, 2) on the durations of segments."""
    mesh = segmented(durations, n_intervals, phase=np.array(phase))
    layout, found = bounds_of(formulation(boundary(), *boundaries), mesh, durations)
    return found[layout.durations()]


def test_a_free_phase_of_one_segment_may_become_much_shorter_and_longer():
    found = durations_of(np.array([2.0]), [0], 8, boundary())
    assert found == pytest.approx(np.array([[0.04, 200.0]]))


def test_segments_between_switch_times_change_by_a_tenth_and_half_a_mean_interval():
    """Of 12 intervals in 6 s the mean one is half a second. The last phase has one segment."""
    found = durations_of(np.array([1.0, 3.0, 2.0]), [0, 0, 1], 12, boundary(), boundary())
    factors = 1.1 + 0.5 * 6.0 / 13 / np.array([1.0, 3.0])  # a segment has at least three intervals: 13 in all
    assert segmented(np.array([1.0, 3.0, 2.0]), 12).n_intervals == 13
    assert found[0] == pytest.approx([1.0 / factors[0], factors[0]])
    assert found[1] == pytest.approx([3.0 / factors[1], 3.0 * factors[1]])
    assert found[2] == pytest.approx([0.04, 600.0])


@pytest.mark.parametrize(
    ("window", "expected"),
    [
        ((0.3, INF), (0.3, 100.0)),
        ((0.0, 0.8), (0.02, 0.8)),
        ((0.3, 0.8), (0.3, 0.8)),
        ((0.001, 500.0), (0.02, 100.0)),
        ((0.7, 0.7), (0.7, 0.7)),
        ((0.001, 0.001), (0.001, 0.001)),
    ],
)
def test_the_window_of_a_phase_s_only_segment_bounds_its_duration(window, expected):
    assert durations_of(np.array([1.0]), [0], 6, boundary(time=window))[0] == pytest.approx(expected)


def test_the_duration_between_two_given_times_is_their_difference():
    found = durations_of(np.array([0.2, 0.5]), [0, 1], 6, boundary(time=(0.2, 0.2)), boundary(time=(0.7, 0.7)))
    assert found == pytest.approx(np.array([[0.2, 0.2], [0.5, 0.5]]))


# Linear rows.


def rows_of(problem: Formulation, mesh: Mesh) -> tuple[Layout, np.ndarray, np.ndarray, np.ndarray]:
    """Return the layout, the rows as a matrix, and their bounds."""
    layout = layout_of(mesh)
    linear, low, high = linear_rows(problem, layout, mesh, scheme("radau-2"), None)
    return layout, np.array(linear.dm()), low, high


@pytest.mark.parametrize("periodic", [False, True])
def test_efforts_without_jumps_end_an_interval_where_they_begin_the_next(periodic):
    layout, rows, low, high = rows_of(
        formulation(boundary(), boundary(), smooth=(0,), returns=(0, 1) if periodic else ()), uniform(3)
    )
    effort, x = layout.effort()[:, :, 0], np.zeros(layout.size)
    x[effort] = [[1.0, 9.0, 2.0], [2.0, 9.0, 5.0], [5.5, 9.0, 3.0]]
    assert (rows @ x)[rows[:, effort.ravel()].any(axis=1)] == pytest.approx([0.0, -0.5, 2.0] if periodic else [0.0, -0.5])
    assert not low.any()
    assert not high.any()


def test_smooth_accelerations_end_an_interval_where_they_begin_the_next_and_are_zero_at_rest():
    at_rest, mesh = PhaseBoundary(state=np.zeros((2, 2)), time=FREE_TIME), uniform(2)
    problem, layout = formulation(at_rest, boundary(), rows=IntervalRows(smooth_columns=(0,))), layout_of(mesh)
    linear, _, _ = linear_rows(problem, layout, mesh, SCHEME, None)
    x = np.zeros(layout.size)
    x[layout.acceleration()[:, :, 0]] = [[1.0, 2.0, 3.0], [4.5, 4.0, 4.0]]
    assert np.array(linear.dm()) @ x == pytest.approx([3.0 - 4.5, 1.0])


def test_the_time_of_a_boundary_after_several_segments_is_a_row():
    mesh = segmented(np.array([1.0, 2.0, 3.0]), 9, phase=np.array([0, 0, 1]))
    problem = formulation(boundary(), boundary(time=(2.5, 2.5)), boundary(time=(4.0, 9.0)))
    layout, rows, low, high = rows_of(problem, mesh)
    x = np.zeros(layout.size)
    x[layout.durations()] = [1.0, 2.0, 4.0]
    assert rows @ x == pytest.approx([3.0])
    assert (low[0], high[0]) == (2.5, 2.5)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_a_boundary_at_a_share_of_the_whole_duration_has_that_share_before_it(share):
    mesh = segmented(np.array([1.0, 2.0, 3.0]), 9, phase=np.array([0, 0, 1]))
    layout, rows, low, high = rows_of(formulation(boundary(), boundary(share=share), boundary()), mesh)
    x = np.zeros(layout.size)
    x[layout.durations()] = [0.25 * share, 0.75 * share, 1 - share]
    assert rows @ x == pytest.approx([0.0], abs=1e-12)
    assert (low[0], high[0]) == (0.0, 0.0)


# Bounds of rows.


def test_nodes_at_boundaries_that_prescribe_the_position_are_given_from_both_sides():
    """Phases of two and one intervals; the waypoint's position is free within a window."""
    mesh = segmented(np.array([2.0, 1.0]), 6, phase=np.array([0, 1]))
    ends = formulation(boundary(0.0, 0.0), boundary(0.2, 0.4), boundary(1.0, 1.0))
    found = _given_nodes(ends, mesh, np.array(SCHEME.nodes))
    expected = np.zeros_like(found)
    expected[0, 0] = expected[-1, -1] = True
    assert np.array_equal(found, expected)
    way = formulation(boundary(0.0, 0.5), boundary(0.3, 0.3), boundary(0.9, 1.0))
    found, first = _given_nodes(way, mesh, np.array(SCHEME.nodes)), int(mesh.boundaries()[1])
    expected = np.zeros_like(found)
    expected[first - 1, -1] = expected[first, 0] = True
    assert np.array_equal(found, expected)


def rows_bounded(problem: Formulation, mesh: Mesh, held: np.ndarray | None = None) -> np.ndarray:
    """Return the bounds (n, n_nodes, 2) of a path quantity, which is a node's only row."""
    xi = ca.SX.sym("xi", 4)
    node = ca.Function("node", [xi, ca.SX.sym("theta", 0)], [ca.vertcat(xi[1], 0)])
    system = System(n_s=1, n_x=0, n_z=0, n_u=1, node=node, n_equations=0, n_path=1, kinds=("speed",))
    functions = build_node(system, ())
    interval = interval_of(system, SCHEME, problem.rows, functions, build_chain(system, SCHEME, problem.rows, functions))
    breaks = np.linspace(0.0, 1.0, mesh.n_intervals + 1)
    low, high = row_bounds(problem, SCHEME, interval, mesh, breaks, held, None)
    return np.stack([low, high], axis=1).reshape(mesh.n_intervals, -1, 2)[:, interval.n_own :]


def test_a_tightened_limit_is_narrower_at_both_ends_on_its_interval():
    problem = formulation(boundary(), boundary(), tightening=lambda _: np.array([[0.0], [0.4]]))
    found = rows_bounded(problem, uniform(2))
    assert found[0] == pytest.approx(np.tile([-2.0, 3.0], (3, 1)))
    assert found[1] == pytest.approx(np.tile([-1.6, 2.6], (3, 1)))


def test_a_value_that_a_waypoint_prescribes_is_held_at_the_last_node_before_it():
    mesh = segmented(np.array([1.0, 1.0]), 6, phase=np.array([0, 1]))
    problem = formulation(boundary(), boundary(), boundary(), passed=((1, 0, 0.7),))
    expected = np.tile([-2.0, 3.0], (6, 3, 1))
    expected[2, 2] = 0.7
    assert rows_bounded(problem, mesh) == pytest.approx(expected)


@pytest.mark.parametrize("jumps", [False, True])
def test_a_held_quantity_is_held_from_the_node_before_unless_it_jumps_with_the_effort(jumps):
    mesh = segmented(np.array([1.0, 1.0]), 6)
    problem = formulation(boundary(), boundary(), rows=IntervalRows(open_end_path=(0,) if jumps else ()))
    expected = np.tile([-2.0, 3.0], (6, 3, 1))
    expected[3:] = 3.0
    if not jumps:
        expected[2, 2] = 3.0
    assert rows_bounded(problem, mesh, np.array([[0], [1]])) == pytest.approx(expected)


def test_a_quantity_along_its_lower_limit_is_held_at_the_tightest_of_all_intervals():
    path = np.tile([-5.0, 5.0], (4, 1, 1))
    path[2, 0, 0] = -4.5
    at_nodes, at_open_ends, held = np.repeat(path[:, None], 3, axis=1), np.array(path), np.zeros((4, 1))
    held[1] = -1
    _hold_paths(path, at_nodes, at_open_ends, held, (), set())
    assert at_nodes[1].ravel().tolist() == [-4.5] * 6


def test_limits_on_positions_are_out_of_the_way_at_given_nodes_only():
    problem = formulation(boundary(0.0, 0.0), boundary(0.1, 0.2), position_path=(0,))
    found = rows_bounded(problem, uniform(2))
    assert found[0, 0, 0] <= -10.0
    assert found[0, 0, 1] >= 10.0
    assert found.reshape(-1, 2)[1:] == pytest.approx(np.tile([-2.0, 3.0], (5, 1)))


# Times of two fixed waypoints, of one within a window, of one that is free, and of the goal [s].
WINDOWS = ((0.2, 0.2), (0.4, 0.6), (0.7, 0.7), (0.0, np.inf), (1.0, 1.1))
PHASE = np.array([0, 0, 1, 1, 2, 3, 4, 4])


def keeps_rows(durations: np.ndarray, windows, shares) -> bool:
    """Return True if segment durations (n_segments,) keep every row."""
    boundaries = [PhaseBoundary(state=np.zeros((2, 2)), time=t, share=s) for t, s in zip(windows, shares, strict=True)]
    rows = _boundary_groups(formulation(None, *boundaries), segmented(durations, 30, phase=PHASE))
    return all(low - 1e-9 <= float(weight @ durations[group]) <= high + 1e-9 for group, low, high, weight in rows)


def phase_durations(times: np.ndarray) -> np.ndarray:
    """Return durations of segments whose phases end at times (5,) [s], in unequal parts."""
    parts = np.array([0.3, 0.7, 0.6, 0.4, 1.0, 1.0, 0.5, 0.5])
    return parts * np.diff(times, prepend=0.0)[PHASE]


def test_durations_keep_the_rows_exactly_if_every_boundary_is_at_a_time_that_it_may_have():
    grid = [(0.1, 0.2), (0.3, 0.4, 0.6, 0.65), (0.68, 0.7), (0.75, 0.9), (0.95, 1.0, 1.1, 1.2)]
    for times in itertools.product(*grid):
        legal = all(low <= time <= high for time, (low, high) in zip(times, WINDOWS, strict=True))
        assert keeps_rows(phase_durations(np.array(times)), WINDOWS, [None] * 5) is legal, times


@pytest.mark.parametrize("continuous", [False, True])
@pytest.mark.parametrize("way", [1, -1, 0])
def test_a_held_quantity_is_at_its_limit_at_every_node_of_its_arc_and_where_it_meets_a_bang(continuous, way):
    """Intervals 2 and 3 of six are an arc along the upper limit. The limit is smallest on interval 3."""
    n, m, free = 6, 3, np.array([-5.0, 5.0])
    path = np.tile(free, (n, 1, 1))
    path[3, 0, 1] = 4.5
    at_nodes, at_open_ends = np.repeat(path[:, None], m, axis=1), np.array(path)
    held = np.zeros((n, 1))
    held[2:4] = 1
    last = {1: 1, -1: 3, 0: None}[way]
    meetings = () if last is None else ((last, 0, 0, way),)
    _hold_paths(path, at_nodes, at_open_ends, held, meetings, {0} if continuous else set())
    expected, open_ends = np.tile(free, (n, m, 1)), np.tile(free, (n, 1))
    open_ends[2:4] = -np.inf, np.inf
    expected[2:4] = 4.5
    if continuous or way == 1:
        expected[1, -1] = 4.5
    if way == -1:
        open_ends[4] = -np.inf, np.inf
    np.testing.assert_array_equal(at_nodes[:, :, 0], expected)
    np.testing.assert_array_equal(at_open_ends[:, 0], open_ends)


NAN, DURATIONS = np.nan, np.array([1.0, 2.0, 1.0])
FORMULATION = formulation(rows=IntervalRows(open_end_path=(0,)), effort=np.array([[-4.0, 4.0]]))
# Between two bangs the power is held. The arc goes on from the first without a jump, or into the last.
ONTO = np.array([[4.0], [NAN], [-4.0]]), np.array([[0], [1], [0]])
OFF = np.array([[-4.0], [NAN], [4.0]]), np.array([[0], [1], [0]])


def found(held: tuple[np.ndarray, np.ndarray], along: float, after: float | None = None) -> np.ndarray | None:
    """Return the junctions of a motion whose effort is `along` on the arc from 1 s to 3 s, `after` from 2 s on."""

    def nodes(times: np.ndarray):
        effort = np.where(times < 2.0, along, along if after is None else after)
        return None, None, None, np.where((times > 1.0) & (times < 3.0), effort, 0.0)[:, None]

    return find_junctions(FORMULATION, segmented(DURATIONS, 12), DURATIONS, Start(states=nodes, nodes=nodes), *held)


@pytest.mark.parametrize(
    ("held", "along", "ways"), [(ONTO, 4.0, [1, 0]), (ONTO, -4.0, [0, -1]), (OFF, 4.0, [0, -1]), (OFF, -4.0, [1, 0])]
)
def test_an_effort_that_does_not_change_its_sign_goes_on_without_a_jump(held, along, ways):
    assert found(held, along).ravel().tolist() == ways


@pytest.mark.parametrize(("before", "after"), [(4.0, -4.0), (-4.0, 4.0), (4.0, 4.0)])
def test_an_arc_meets_a_bang_without_a_jump_where_its_effort_beside_the_switch_has_the_bangs_sign(before, after):
    junctions = found((np.array([[before], [NAN], [after]]), ONTO[1]), 1.0, -1.0)
    expected = [[int(before > 0)], [-int(after < 0)]]
    assert (np.zeros((2, 1)) if junctions is None else junctions).tolist() == expected


def test_between_two_bangs_there_is_no_junction():
    assert found((np.array([[4.0], [-4.0], [4.0]]), np.zeros((3, 1), dtype=int)), 5.0) is None


@pytest.mark.parametrize(("held", "way"), [(ONTO, 1), (OFF, -1)])
def test_beside_a_junction_the_effort_of_the_arc_may_exceed_its_limit(held, way):
    mesh = segmented(DURATIONS, 12)
    of_arc = np.flatnonzero(mesh.segment == 1)
    layout = Layout(n_s=1, n_z=0, n_u=1, n_nodes=2, n_intervals=mesh.n_intervals, n_segments=3)
    lower, upper, expected = np.full(layout.size, -1.0), np.ones(layout.size), np.ones(layout.size)
    _with_junctions(lower, upper, FORMULATION, layout, mesh, held[0], np.array([[1], [0]] if way > 0 else [[0], [-1]]))
    widened = layout.effort()[of_arc[0] if way > 0 else of_arc[-1], :, 0]
    expected[widened] = 3.0  # by the distance of the two limits
    if way < 0:
        expected[widened[-1]] = 1.0  # where the arc ends, the effort is at the bang's limit
        assert lower[widened[-1]] == 1.0
    np.testing.assert_array_equal(upper, expected)
    others = np.setdiff1d(np.arange(layout.size), widened[-1:] if way < 0 else [])
    np.testing.assert_array_equal(lower[others], -expected[others])
