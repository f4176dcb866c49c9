"""Curves that a site follows: their shapes and their smoothness."""

import casadi as ca
import numpy as np
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.guide.curve import Curve, curve_through
from tests.support.refusals import assert_refused

CORNER = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.0, 0.1], [0.0, 0.0, 0.2]]


def derivatives(curve: Curve, x: float) -> list[np.ndarray]:
    """Return the place and its first two derivatives at a parameter."""
    return [np.array(one).ravel() for one in curve.function(x)]


@pytest.mark.parametrize("order", [2, 3])
def test_the_derivatives_of_a_rounded_polyline_have_no_jumps_up_to_the_order_asked_for(order):
    curve = curve_through(CORNER, "polyline", 0.02, "path", order)
    assert len(curve.corners) == 4
    assert curve.is_smooth is (order == 3)
    for corner in curve.corners:
        before, after = (derivatives(curve, corner + side) for side in (-1e-9, 1e-9))
        for k, tolerance in enumerate((1e-8, 1e-6, 1e-3)):  # the third derivative is about 1 / blend^2
            np.testing.assert_allclose(before[k], after[k], atol=tolerance)
        step = 1e-5  # the third derivative is zero at the ends of a blend; the fourth is about 1 / blend^3
        third = [derivatives(curve, corner + side)[2] - derivatives(curve, corner)[2] for side in (-step, step)]
        assert bool(np.abs(third).max() <= 1e-2 * step / 0.02**2) is (order == 3)


def test_a_rounded_polyline_is_its_segments_but_for_the_blends():
    curve = curve_through(CORNER, "polyline", 0.02, "path")
    assert curve.length == pytest.approx(0.1 + 0.1 + np.hypot(0.1, 0.1), abs=1e-15)
    np.testing.assert_allclose(
        curve.places(np.array([0.0, 0.05, 0.15])), [[0, 0, 0], [0.05, 0, 0], [0.1, 0, 0.05]], atol=1e-15
    )
    np.testing.assert_allclose(curve.places(np.array([curve.length])), [CORNER[-1]], atol=1e-15)
    blend = curve.places(np.linspace(0.08, 0.12, 41))
    assert np.all(blend[:, 0] <= 0.1 + 1e-15)
    assert np.all(blend[:, 2] >= -1e-15)


def test_an_arc_keeps_its_radius_and_passes_its_points_in_order():
    centre, radius, angles = np.array([0.2, -0.1, 0.3]), 0.15, np.radians([10.0, 200.0, 300.0])
    first, second = np.array([0.6, 0.8, 0.0]), np.array([0.0, 0.0, 1.0])
    points = [centre + radius * (np.cos(t) * first + np.sin(t) * second) for t in angles]
    curve = curve_through(points, "arc", 0.0, "path")
    assert curve.length == pytest.approx(radius * np.radians(290.0), rel=1e-12)
    places = curve.places(np.array([0.0, radius * np.radians(190.0), curve.length]))
    np.testing.assert_allclose(places, points, atol=1e-14)
    for start, piece in zip(curve.starts, curve.pieces, strict=True):
        x = np.linspace(0.0, piece.length, 5)
        of_piece = [np.array(ca.evalf(piece.place(ca.SX(at)))).ravel() for at in x]
        np.testing.assert_allclose(of_piece, curve.places(start + x), atol=1e-14)


def test_a_spline_passes_all_points_and_ends_without_curvature():
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.02, 0.0], [0.15, 0.1, 0.05], [0.1, 0.2, 0.1]])
    curve = curve_through(points, "spline", 0.0, "path")
    chords = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    np.testing.assert_allclose(curve.places(chords), points, atol=1e-15)
    for x in (0.0, curve.length):
        np.testing.assert_allclose(derivatives(curve, x)[2], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("points", "shape", "blend_m", "said"),
    [
        (CORNER, "polyline", 0.0, "has a corner at [0.1, 0, 0], where a site could only stop; give the path's blend_m"),
        (CORNER, "polyline", 0.06, "blends overlap on a segment of 0.1 m"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], "arc", 0.0, "three points on a line, which no arc joins"),
        (CORNER, "arc", 0.0, "has three points, got 4"),
        ([[0, 0, 0], [0, 0, 0]], "polyline", 0.0, "has distinct consecutive points, got [0, 0, 0] twice"),
        ([[0, 0, 0], [1, 0, 0], [0, 0, 0]], "polyline", 0.1, "turns back on itself at [1, 0, 0]"),
        ([[0, 0, 0], [1, 0, 1], [0, 0, 0]], "spline", 0.0, "turns back on itself at [1, 0, 1]"),
        ([[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], "spline", 0.0, "turns back on itself at [1."),
    ],
)
def test_points_without_a_curve_are_refused(points: list, shape: str, blend_m: float, said: str):
    assert_refused(lambda: curve_through(points, shape, blend_m, "path"), said, kind=ModelError)


def test_a_spline_of_many_points_is_that_of_scipy_with_its_derivatives():
    import scipy

    s = np.linspace(0.0, 1.0, 40)
    points = np.stack([s, 0.3 * np.sin(3.0 * s), 0.1 * np.cos(2.0 * s)], axis=1)
    chords = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    expected = scipy.interpolate.CubicSpline(chords, points, bc_type="natural")
    curve = curve_through(points.tolist(), "spline", 0.0, "path")
    for x in np.linspace(-0.01, curve.length + 0.01, 97):
        for order, found in enumerate(derivatives(curve, x)):
            np.testing.assert_allclose(found, expected(x, order), rtol=0, atol=1e-12)
