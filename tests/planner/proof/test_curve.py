"""Enclosures of tables over time contain the curve, on one piece and across knots."""

import itertools

import numpy as np
import pytest
import scipy
from flint import arb, arb_series, ctx

from linkplan.planner.problem.table_reference import Spline
from linkplan.planner.proof.curve import enclosed
from linkplan.planner.proof.taylor import TaylorForm

KNOTS = np.array([0.0, 0.2, 0.25, 0.6, 1.0])
ROWS = np.array([1.0, 4.0, -2.0, 3.0, 1.0])
ORDER = 6


def curve_of(kind: str, *, periodic: bool) -> tuple[Spline, object]:
    """Return a table's curve and the same function by numpy or scipy."""
    if kind == "cubic":
        through = scipy.interpolate.CubicSpline(KNOTS, ROWS, bc_type="periodic")
        known, c = through, through.c
    else:
        slope = np.diff(ROWS) / np.diff(KNOTS)
        known, c = (lambda t: np.interp(t, KNOTS, ROWS)), np.stack([0 * slope, 0 * slope, slope, ROWS[:-1]])
    return Spline(knots_s=KNOTS, coefficients=c[:, :, None], periodic=periodic), known


def form_on(curve: Spline, middle: float, radius: float) -> TaylorForm:
    """Return the Taylor form of a curve over times middle + radius x, with x in [-1, 1]."""
    ctx.prec, both = 80, []
    for at in (arb(0), arb(0, 1)):
        ctx.cap = ORDER + 2
        both.append(enclosed(curve, 0, arb_series([middle + radius * at, radius], prec=ORDER + 2)))
    return TaylorForm.of(*both, ORDER)


@pytest.mark.parametrize("kind", ["linear", "cubic"])
@pytest.mark.parametrize("periodic", [True, False])
def test_forms_contain_the_curve_on_every_box(kind, periodic):
    curve, known = curve_of(kind, periodic=periodic)
    rng, crossing = np.random.default_rng(1), 0
    for _ in range(300):
        radius = 10.0 ** rng.uniform(-4, -0.8)
        middle = rng.uniform(radius, (3.0 if periodic else 1.0) - radius)
        form, x = form_on(curve, middle, radius), np.linspace(-1.0, 1.0, 41)
        crossing += len(form.coefficients) < 4
        exact = known((middle + radius * x) % 1.0)
        for at, value in zip(x, exact, strict=True):
            ball = sum((c * float(at) ** k for k, c in enumerate(form.coefficients)), arb(0)) + arb(0, form.remainder)
            assert ball.overlaps(arb(float(value), 1e-12)), (middle, radius, at)
    assert crossing > 20, "boxes meet several pieces"


@pytest.mark.parametrize("kind", ["linear", "cubic"])
def test_a_box_within_a_piece_is_enclosed_almost_exactly(kind):
    curve, _ = curve_of(kind, periodic=True)
    for begin, end in itertools.pairwise(KNOTS):
        form = form_on(curve, 1.0 + 0.5 * (begin + end), 0.5 * (end - begin))
        assert float(form.remainder) < 1e-12
        assert float(form.coefficients[0].rad()) < 1e-6


@pytest.mark.parametrize("kind", ["linear", "cubic"])
def test_boxes_across_a_knot_shrink_with_their_width(kind):
    curve, _ = curve_of(kind, periodic=True)
    widths = [float(form_on(curve, 0.2, radius).remainder) for radius in (1e-2, 1e-3)]
    assert 0 < widths[1] < 0.11 * widths[0]
