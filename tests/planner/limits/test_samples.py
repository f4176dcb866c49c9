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


@pytest.mark.parametrize("values", [-5.0 * (POINTS - 0.4) ** 2, POINTS + 1.0, np.where(POINTS > 0.5, np.inf, 3.0)])
def test_without_a_vertex_inside_the_least_sample_counts(values):
    assert least_between(values, POINTS)[0] == values.min()


def test_each_interval_has_its_own_least_value():
    rows = np.array([(POINTS - 0.4) ** 2 + 1.0, (POINTS - 0.7) ** 2 + 2.0])
    np.testing.assert_allclose(least_between(rows.ravel(), POINTS), [1.0, 2.0], rtol=1e-12)
