"""The least value of a curve between its samples."""

import numpy as np
import pytest

from linkplan.planner.limits.samples import least_between, sample_points

POINTS = sample_points(3)


@pytest.mark.parametrize("vertex", [0.03, 0.4, 0.93])
def test_the_least_value_of_a_parabola_is_its_vertex_s_wherever_the_samples_are(vertex):
    values = 5.0 * (POINTS - vertex) ** 2 - 2.0
    assert values.min() > -2.0 + 1e-6
    assert least_between(values, POINTS)[0] == pytest.approx(-2.0, rel=1e-9)


@pytest.mark.parametrize(
    "values",
    [
        -5.0 * (POINTS - 0.4) ** 2,
        POINTS + 1.0,
        np.where(POINTS > 0.5, np.inf, 3.0),
        5.0 * (POINTS - 1.01) ** 2,
        5.0 * (POINTS + 0.01) ** 2,
    ],
)
def test_without_a_vertex_inside_the_least_sample_counts(values):
    assert least_between(values, POINTS)[0] == values.min()


def test_each_interval_has_its_own_least_value():
    rows = np.array([(POINTS - 0.4) ** 2 + 1.0, (POINTS - 0.7) ** 2 + 2.0])
    np.testing.assert_allclose(least_between(rows.ravel(), POINTS), [1.0, 2.0], rtol=1e-12)


@pytest.mark.parametrize("n_nodes", [1, 3, 5, 7, 9])
def test_the_least_value_of_a_wave_as_short_as_nodes_can_follow_is_found_to_a_hundredth(n_nodes):
    """A polynomial follows a wave with some four nodes a period, and a motion of few nodes may still turn within one."""
    points, share = sample_points(n_nodes), np.linspace(0.0, 1.0, 20001)
    pace = 2 * np.pi * max(1.0, n_nodes / 4)
    for phase in np.linspace(0.0, 2 * np.pi, 61):
        least = least_between(np.cos(pace * points + phase), points)[0]
        assert least == pytest.approx(np.cos(pace * share + phase).min(), abs=0.01)
