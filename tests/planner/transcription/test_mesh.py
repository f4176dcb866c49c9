"""Meshes, the layout of unknowns, and durations between prescribed times."""

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.transcription.formulation import PhaseBoundary, stretched_durations
from linkplan.planner.transcription.mesh import (
    Layout,
    Mesh,
    broken,
    halved,
    segmented,
    with_breaks,
    with_ends,
    without_empty,
)  # fmt: skip
from linkplan.planner.transcription.system import System, build_node, node_symbols
from tests.support.formulations import formulation

DURATIONS = np.array([0.1, 3.0, 0.2])


def three_segments() -> Mesh:
    return segmented(DURATIONS, 10, phase=np.array([0, 0, 1]))


def test_segments_have_intervals_in_proportion_to_their_durations_and_a_least_number():
    mesh = three_segments()
    assert np.bincount(mesh.segment).tolist() == [3, 9, 3]
    assert (mesh.n_intervals, mesh.n_segments, mesh.n_phases) == (15, 3, 2)
    assert mesh.boundaries().tolist() == [0, 12, 15]


def test_only_marked_intervals_are_halved():
    mesh = halved(broken(np.array([0.0, 0.2, 1.0])), np.array([False, True]))
    np.testing.assert_allclose(mesh.fraction, [0.2, 0.4, 0.4])


@pytest.mark.parametrize(
    ("fraction", "segment", "phase"),
    [
        ([0.5, 0.4], [0, 0], None),
        ([1.5, -0.5], [0, 0], None),
        ([1.0, 0.0], [0, 0], None),
        ([1.0, 1.0], [1, 0], None),
        ([1.0, 1.0], [0, 1], [0]),
        ([1.0, 1.0], [0, 1], [1, 2]),
        ([1.0, 1.0], [0, 1], [0, 2]),
        ([1.0, 1.0], [0, 1], [0, -1]),
    ],
)
def test_a_mesh_that_does_not_fill_its_segments_and_phases_is_refused(fraction, segment, phase):
    with pytest.raises(ValueError, match="mesh"):
        Mesh(fraction=np.array(fraction), segment=np.array(segment), phase=None if phase is None else np.array(phase))


def test_a_segment_without_a_duration_goes_unless_it_is_the_longest_of_its_phase():
    durations = np.array([1e-6, 3.0, 1e-7])
    mesh, left = without_empty(three_segments(), durations, 1e-3)
    assert left.tolist() == [3.0, 1e-7]
    assert np.bincount(mesh.segment).tolist() == [9, 3]
    assert mesh.phase.tolist() == [0, 1]
    same, left = without_empty(three_segments(), DURATIONS, 0.1)
    assert left.tolist() == DURATIONS.tolist()
    assert same.n_intervals == 15


def test_further_segments_take_the_place_of_the_ends_of_intervals_next_to_them():
    mesh = three_segments()  # intervals of 1/30 s, of 1/3 s and of 1/15 s
    cut, durations = with_ends(mesh, DURATIONS, np.array([1.15, 2.25]))
    np.testing.assert_allclose(durations, [0.1, 1.05, 1.1, 0.85, 0.2])
    assert cut.phase.tolist() == [0, 0, 0, 0, 1]
    before, breaks = mesh.breaks(DURATIONS), cut.breaks(durations)
    assert sorted(set(breaks.round(9)) - set(before.round(9))) == [1.15, 2.25]
    # 1.1 s, at 0.15 of an interval from the first time, went; the second time halves its interval.
    assert sorted(set(before.round(9)) - set(breaks.round(9))) == [1.1]


def test_an_interval_does_not_end_just_beside_a_segment():
    mesh = three_segments()
    same = with_breaks(mesh, DURATIONS, np.array([0.1 + 1e-5, 3.1 - 1e-5]))
    np.testing.assert_allclose(same.breaks(DURATIONS), mesh.breaks(DURATIONS))


def test_every_unknown_has_one_place_of_its_own():
    counts = {"n_s": 2, "n_z": 3, "n_u": 2, "n_nodes": 3, "n_intervals": 4, "n_segments": 3, "n_x": 1, "n_effort": 2}
    layout = Layout(**counts, n_extra=2, n_open_ends=1, n_z_open_end=2)
    of_intervals = {
        "acceleration": (layout.acceleration(), (4, 3, 2)),
        "rate": (layout.rate(), (4, 3, 1)),
        "dependent": (layout.dependent(), (4, 3, 3)),
        "effort": (layout.effort(), (4, 2, 2)),
        "open end": (layout.open_end_dependent(), (4, 1, 2)),
    }
    for name, (places, shape) in of_intervals.items():
        assert places.shape == shape, name
    ends = [layout.states(), layout.durations(), layout.extra()]
    everything = np.concatenate([places.ravel() for places in (*ends, *(places for places, _ in of_intervals.values()))])
    np.testing.assert_array_equal(np.sort(everything), np.arange(layout.size))
    assert layout.states().shape == (5, 5)  # two positions, two speeds and a state of first order
    np.testing.assert_array_equal(layout.states(), [layout.state(k) for k in range(5)])
    np.testing.assert_array_equal(layout.durations(), layout.states().max() + 1 + np.arange(3))
    np.testing.assert_array_equal(layout.extra(), layout.durations().max() + 1 + np.arange(2))


def test_unknowns_at_open_ends_are_the_algebraic_ones_in_the_rows_there():
    """A closure of the second of three unknowns, and of two quantities the one of the third unknown and of the effort."""
    node = node_symbols(1, 1, 3, 2)
    column = ca.vertcat(node.z[1] - node.s, node.a - node.u[0] - node.z[0], node.r, node.v, node.z[2] * node.u[1], 0)
    system = System(
        n_s=1, n_x=1, n_z=3, n_u=2, node=ca.Function("node", [node.stacked, ca.SX.sym("p", 0)], [column]),
        n_equations=3, n_path=2, kinds=("closure", "dynamics", "dynamics", "speed", "power"),
    )  # fmt: skip
    assert (system.n_xi, system.n_state) == (3 + 2 + 3 + 2, 3)
    functions = build_node(system, (1,))
    assert functions.open_end_rows == (0, 4)
    assert functions.open_end_z == (1, 2)


FREE = (0.0, np.inf)


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([FREE, FREE, FREE], [1.0, 1.0, 2.0, 4.0]),
        ([(0.5, 0.5), FREE, FREE], [0.5, 0.5, 2.0, 4.0]),
        ([FREE, (3.0, 3.0), FREE], [1.5, 1.5, 3.0, 4.0]),
        ([(0.5, 0.5), (3.0, 3.0), FREE], [0.5, 0.5, 5.0, 4.0]),
        ([(0.5, 0.5), FREE, (6.5, 6.5)], [0.5, 0.5, 4.0, 8.0]),
    ],
)
def test_durations_are_stretched_between_prescribed_times_only(times, expected):
    """Phases of 2, 1 and 1 segments; times are in units of 2 s."""
    boundaries = tuple(PhaseBoundary(state=np.zeros((1, 2)), time=time) for time in [(0.0, 0.0), *times])
    found = stretched_durations(np.array([1.0, 1.0, 2.0, 4.0]), boundaries, np.array([0, 0, 1, 2]), 2.0)
    assert found == pytest.approx(expected)


@pytest.mark.parametrize(
    ("returns", "free_at_end", "periodic"),
    [((), (), False), ((0, 1), (), False), ((0, 1, 2), (), True), ((0, 1), (2,), True), ((0,), (2,), False)],
)
def test_a_problem_is_periodic_if_all_states_return_but_those_that_nothing_depends_on(returns, free_at_end, periodic):
    assert formulation(returns=returns, free_at_end=free_at_end, state=np.zeros((3, 2))).periodic == periodic
