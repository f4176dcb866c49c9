"""Where a function changes its sign, against closed forms."""

import math
import warnings

import numpy as np
import pytest

from linkplan.models.poses.sign_change import sign_change

SHAPES = {
    "a line": (lambda x: x - 0.3, 0.3),
    "steep": (lambda x: math.expm1(20 * (x - 0.7)), 0.7),
    "flat": (lambda x: (x - 0.4) ** 5, 0.4),
    "falling": (lambda x: math.cos(3 * x), math.pi / 6),
    "a jump": (lambda x: 1.0 if x > 0.123 else -1.0, 0.123),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("backwards", [False, True])
def test_the_place_is_found_to_the_tolerance(shape, backwards):
    function, root = SHAPES[shape]
    ends = (1.0, 0.0) if backwards else (0.0, 1.0)
    assert sign_change(function, *ends, xtol=1e-14) == pytest.approx(root, abs=1e-3 if shape == "flat" else 2e-14)


def test_many_places_are_found_together_and_none_where_the_function_has_no_value():
    roots, asked = np.array([0.1, 0.5, np.nan, 0.9]), []
    found = sign_change(lambda x: asked.append(x) or np.exp(3 * x) - np.exp(3 * roots), np.zeros(4), np.ones(4), xtol=1e-14)
    np.testing.assert_allclose(found, roots, atol=2e-14)
    assert len(asked) < 20


def test_a_function_that_has_been_without_a_value_says_nothing_more():
    def pair(x: np.ndarray) -> np.ndarray:
        gap = np.where(np.abs(x - 0.5) < 0.05, np.nan, np.where(x > 0.5, 1.0, -0.01 - (x - 0.2) ** 2))
        return np.array([gap[0], np.expm1(20 * (x[1] - 0.7))])

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = sign_change(pair, np.zeros(2), np.ones(2), xtol=1e-14)
    np.testing.assert_allclose(found, [np.nan, 0.7], atol=2e-14)
