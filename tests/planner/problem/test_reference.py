"""Reference motions: their derivatives, and whole numbers of their periods."""

import numpy as np
import pytest

from linkplan.planner.problem.reference import Sine, is_whole


@pytest.mark.parametrize(
    ("number", "whole"),
    [(1.0, True), (3.0 + 1e-10, True), (1e6 * (1 + 1e-10), True), (2.5, False), (3.0 + 1e-7, False), (0.0, False)],
)
def test_a_ratio_is_whole_but_for_the_rounding_of_decimals(number, whole):
    assert is_whole(number) is whole


@pytest.mark.parametrize("order", [0, 1])
def test_each_derivative_of_a_sine_is_the_slope_of_the_one_before(order):
    sine = Sine(amplitude=np.array([0.3, 0.1]), bias=np.array([0.2, -1.0]), phase=np.array([0.4, 0.0]), frequency_hz=1.5)
    time, step = np.linspace(0.0, 1.0, 7), 1e-6
    slope = (sine.derivative(time + step, order) - sine.derivative(time - step, order)) / (2 * step)
    np.testing.assert_allclose(sine.derivative(time, order + 1), slope, atol=1e-6)
    np.testing.assert_allclose(sine.derivative(np.zeros(1)), [[0.2 + 0.3 * np.sin(0.4), -1.0]])
    assert sine.period_s == pytest.approx(1 / 1.5)
