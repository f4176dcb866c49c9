"""Meshes: intervals, segments and phases, and how they are divided."""

import numpy as np
import pytest

from linkplan.planner.transcription.mesh import Mesh, broken, halved, segmented, without_empty

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
