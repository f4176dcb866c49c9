"""Rows on the durations of segments, against the times that the phase boundaries ask."""

import itertools

import numpy as np
import pytest

from linkplan.planner.transcription.bounds import _boundary_groups, _hold_paths, find_junctions
from linkplan.planner.transcription.formulation import PhaseBoundary, Start
from linkplan.planner.transcription.interval import IntervalRows
from linkplan.planner.transcription.mesh import segmented
from tests.support.formulations import formulation

# Times of two fixed waypoints, of one within a window, of one that is free, and of the goal [s].
WINDOWS = ((0.2, 0.2), (0.4, 0.6), (0.7, 0.7), (0.0, np.inf), (1.0, 1.1))
PHASE = np.array([0, 0, 1, 1, 2, 3, 4, 4])


def keeps_rows(durations: np.ndarray, windows, shares) -> bool:
    """Return True if segment durations (n_segments,) keep every row."""
    boundaries = [PhaseBoundary(state=np.zeros((2, 2)), time=t, share=s) for t, s in zip(windows, shares, strict=True)]
    rows = _boundary_groups(formulation(None, *boundaries), segmented(durations, 30, phase=PHASE))
    return all(low - 1e-9 <= float(weight @ durations[group]) <= high + 1e-9 for group, low, high, weight in rows)


def durations_of(times: np.ndarray) -> np.ndarray:
    """Return durations of segments whose phases end at times (5,) [s], in unequal parts."""
    parts = np.array([0.3, 0.7, 0.6, 0.4, 1.0, 1.0, 0.5, 0.5])
    return parts * np.diff(times, prepend=0.0)[PHASE]


def test_durations_keep_the_rows_exactly_if_every_boundary_is_at_a_time_that_it_may_have():
    grid = [(0.1, 0.2), (0.3, 0.4, 0.6, 0.65), (0.68, 0.7), (0.75, 0.9), (0.95, 1.0, 1.1, 1.2)]
    for times in itertools.product(*grid):
        legal = all(low <= time <= high for time, (low, high) in zip(times, WINDOWS, strict=True))
        assert keeps_rows(durations_of(np.array(times)), WINDOWS, [None] * 5) is legal, times


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


@pytest.mark.parametrize(("before", "after"), [(5.0, -5.0), (-5.0, 5.0), (5.0, 5.0)])
def test_an_arc_meets_a_bang_without_a_jump_where_its_effort_beside_the_switch_has_the_bangs_sign(before, after):
    """The effort along the arc from 1 s to 3 s is positive in its first half and negative in its second."""
    durations = np.array([1.0, 2.0, 1.0])

    def nodes(time: np.ndarray) -> tuple:
        effort = np.where((time > 1.0) & (time < 3.0), np.sign(2.0 - time), 0.0)
        return None, None, None, effort[:, None]

    junctions = find_junctions(
        formulation(rows=IntervalRows(open_end_path=(0,))),
        segmented(durations, 12),
        durations,
        Start(states=nodes, nodes=nodes),
        np.array([[before], [np.nan], [after]]),
        np.array([[0], [1], [0]]),
    )
    expected = [[int(before > 0)], [-int(after < 0)]]
    assert (np.zeros((2, 1)) if junctions is None else junctions).tolist() == expected
