"""Piecewise polynomials by their Bernstein coefficients, against scipy's."""

import numpy as np
import pytest
from scipy.interpolate import BPoly

from linkplan.planner.transcription.bernstein import (
    PiecewisePolynomial,
    bernstein_elevation,
    bernstein_matrix,
    bernstein_part,
    bernstein_product,
)


@pytest.fixture
def curve():
    rng = np.random.default_rng(1)
    return PiecewisePolynomial(rng.normal(size=(5, 4, 2)), np.array([0.0, 0.3, 0.4, 1.0, 1.7]))


@pytest.mark.parametrize("order", [0, 1, 2, 5])
def test_values_and_derivatives_are_scipys_at_breaks_and_beyond_the_ends_too(curve, order):
    at = np.array([-0.1, 0.0, 0.1, 0.3, 0.35, 0.4, 1.0, 1.69, 1.7, 1.9])
    theirs = BPoly(curve.coefficients, curve.breaks)
    expected = theirs.derivative(order)(at) if order < 5 else np.zeros((len(at), 2))
    np.testing.assert_allclose(curve.derivative(order)(at), expected, rtol=0, atol=1e-10 * max(1.0, np.abs(expected).max()))


def test_quintics_pass_with_the_speeds_given_and_no_acceleration():
    breaks, rng = np.array([0.0, 0.2, 1.0]), np.random.default_rng(2)
    position, speed = rng.normal(size=(3, 2)), rng.normal(size=(3, 2))
    path = PiecewisePolynomial.through(breaks, position, speed)
    theirs = BPoly.from_derivatives(breaks, [[p, v, 0 * p] for p, v in zip(position, speed, strict=True)])
    at = np.linspace(0.0, 1.0, 31)
    np.testing.assert_allclose(path(at), theirs(at), rtol=0, atol=1e-12)


def test_an_elevated_curve_is_the_same_curve():
    coefficients, t = np.array([1.0, -2.0, 0.5]), np.linspace(0.0, 1.0, 7)
    higher = bernstein_elevation(2, 5) @ coefficients
    np.testing.assert_allclose(bernstein_matrix(5, t) @ higher, bernstein_matrix(2, t) @ coefficients, rtol=0, atol=1e-14)


def test_a_products_coefficients_are_those_of_the_product():
    first, second, t = np.array([1.0, -2.0, 0.5]), np.array([0.3, 2.0, -1.0, 4.0]), np.linspace(0.0, 1.0, 9)
    both = np.array(bernstein_product(first, second))
    expected = (bernstein_matrix(2, t) @ first) * (bernstein_matrix(3, t) @ second)
    np.testing.assert_allclose(bernstein_matrix(5, t) @ both, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("degree", [0, 1, 4, 8])
def test_coefficients_on_a_part_are_those_of_the_same_polynomial(degree):
    coefficients = np.cos(np.arange(degree + 1.0))
    inside = np.linspace(0.0, 1.0, 7)
    part = bernstein_matrix(degree, inside) @ bernstein_part(degree, 0.3, 0.8) @ coefficients
    np.testing.assert_allclose(part, bernstein_matrix(degree, 0.3 + 0.5 * inside) @ coefficients, atol=1e-14)
