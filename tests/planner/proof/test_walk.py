"""The walk of expressions on balls and series: CasADi's own values, switches, and that a wrong sign is found."""

import operator
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from flint import arb, arb_series, ctx

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.proof.walk import UnknownOperationError, Walk, larger, walk_of
from tests.support.linkages import RSSR
from tests.support.tolerances_planner import ROUNDING

MODELS = ("optimus-knee", "five-bar", "andrews-squeezer", RSSR)
BLOCKS = ("tree_effort", "independent_closure", "closure_jacobian", "effort_matrix", "block_singularity", "site_places")


def off(function: ca.Function, walk: Walk, rng: np.random.Generator) -> float:
    """Return the largest difference between a walk and CasADi at a random point, as a share of the value."""
    points = [rng.uniform(-1, 1, function.numel_in(k)) for k in range(function.n_in())]
    expected = np.array(function(*points))
    found = walk(*[[arb(float(x)) for x in point] for point in points])[0]
    return max(abs(float(x.mid()) - expected[place]) / max(1.0, abs(expected[place])) for place, x in found.items())


@pytest.mark.parametrize("model", MODELS, ids=["knee", "five-bar", "squeezer", "rssr"])
def test_the_walk_has_casadis_values_at_random_points(model):
    rng, dynamics = np.random.default_rng(0), load_mechanism(model).dynamics
    for name in BLOCKS:
        function = getattr(dynamics, name)
        assert max(off(function, walk_of(function), rng) for _ in range(5)) < ROUNDING, name


def test_a_wrong_sign_in_any_term_of_the_walk_is_found():
    function = load_mechanism("optimus-knee").dynamics.tree_effort
    walk, other = walk_of(function), {operator.add: operator.sub, operator.sub: operator.add}
    signed = [k for k, step in enumerate(walk.steps) if step[0] in other]
    assert len(signed) > 20
    for k in signed:
        steps = list(walk.steps)
        steps[k] = (other[steps[k][0]], *steps[k][1:])
        wrong, rng = replace(walk, steps=tuple(steps)), np.random.default_rng(0)
        assert max(off(function, wrong, rng) for _ in range(3)) > 1e6 * ROUNDING, k


def _switches() -> ca.Function:
    x = ca.SX.sym("x", 3)
    terms = [
        ca.if_else(x[0] > x[1], x[0] ** 3, ca.fabs(x[1])),
        ca.fmax(x[0], x[2]) * ca.fmin(x[1], 0.5),
        ca.tanh(x[0]) + ca.sinh(x[1]) + ca.cosh(x[2]),
        ca.atan2(x[0], x[1]) + ca.sign(x[2]) + ca.floor(x[1]),
        (2 + x[0]) ** 2.5 + (2 + x[1]) ** x[2] + (2 + x[2]) ** -3,
        ca.if_else(ca.logic_and(x[0] > 0, x[1] <= 0.5), 1, ca.if_else(ca.logic_or(x[2] < 0, x[1] < 0), 2, 3)),
        ca.asin(x[0] / 2) + ca.acos(x[1] / 2) + ca.atan(x[2]) + ca.tan(x[0]) + ca.log(2 + x[1]) + ca.exp(x[2]),
    ]
    return ca.Function("switches", [x], [ca.vertcat(*terms)])


def test_switches_and_functions_have_casadis_values():
    function, rng = _switches(), np.random.default_rng(1)
    assert max(off(function, walk_of(function), rng) for _ in range(50)) < ROUNDING


def test_series_are_the_derivatives_along_a_line():
    function, rng = _switches(), np.random.default_rng(2)
    t = ca.SX.sym("t")
    before = ctx.cap
    try:
        ctx.cap = 4
        for _ in range(10):
            x, way = rng.uniform(-1, 1, (2, 3))
            along = function(x + t * way)
            found = walk_of(function)([arb_series([float(a), float(b)]) for a, b in zip(x, way, strict=True)])[0]
            for order in range(4):
                exact = np.array(ca.Function("d", [t], [along])(0.0)).ravel() / max(1, [1, 1, 2, 6][order])
                got = [
                    float((f[order] if isinstance(f, arb_series) else arb(0 if order else f)).mid()) for f in found.values()
                ]
                assert np.abs(np.array(got) - exact).max() < 1e3 * ROUNDING
                along = ca.jacobian(along, t)
    finally:
        ctx.cap = before


def test_beside_a_kink_both_slopes_are_enclosed_and_no_more():
    x = ca.SX.sym("x")
    walk = walk_of(ca.Function("kink", [x], [ca.fabs(x)]))
    (found,) = walk([arb_series([arb(0, 0.5), 1])])[0].values()
    assert found[0].contains(arb(0))
    assert found[0].contains(arb(0.5))
    assert found[1].contains(arb(1))
    assert found[1].contains(arb(-1))
    assert not found[2].is_finite()
    one, other = arb_series([arb(0, 0.5), 1], prec=3), arb_series([arb(0, 0.5), -1], prec=5)
    assert larger(one, other).prec == larger(other, one).prec == 3, "no more coefficients than both are known to"


def test_a_jump_has_no_known_slope_also_in_a_product():
    x = ca.SX.sym("x")
    jumps = ca.vertcat(ca.sign(x) * (x + 2), (x > 0) * (x + 2), ca.if_else(x > 0, x, 3))
    found = walk_of(ca.Function("jumps", [x], [jumps]))([arb_series([arb(0, 0.5), 1])])[0]
    for series, values in zip(found.values(), ((-2.5, 2.5), (0, 2.5), (0.5, 3)), strict=True):
        assert all(series[0].contains(arb(value)) for value in values)
        assert not series[1].is_finite()


def test_a_signed_square_has_two_bounded_derivatives():
    x = ca.SX.sym("x")
    walk = walk_of(ca.Function("damper", [x], [x * ca.fabs(x)]))
    (found,) = walk([arb_series([arb(0.25, 0.5), 1], prec=4)])[0].values()
    for at in (-0.25, 0.0, 0.75):
        assert found[0].contains(arb(at * abs(at)))
        assert found[1].contains(arb(2 * abs(at)))
    assert found[2].contains(arb(1))
    assert found[2].contains(arb(-1))
    assert not found[3].is_finite()
    assert off(ca.Function("damper", [x], [x * ca.fabs(x)]), walk, np.random.default_rng(0)) < ROUNDING


@pytest.mark.parametrize(
    ("expression", "low", "high"),
    [
        (lambda x: ca.fmax(x, 0.25), 0.25, 1.0),
        (lambda x: ca.fmin(x, 0.25), -0.5, 0.25),
        (ca.fabs, 0.0, 1.0),
        (ca.sign, -1.0, 1.0),
        (lambda x: x < 0.5, 0.0, 1.0),
        (lambda x: x <= -0.6, 0.0, 0.0),
        (lambda x: x <= 1.1, 1.0, 1.0),
        (lambda x: x * ca.fabs(x), -0.25, 1.0),
        (lambda x: ca.if_else(x > 2, 7, x), -0.5, 1.0),
        (lambda x: x**5, -1 / 32, 1.0),
        (ca.sinh, np.sinh(-0.5), np.sinh(1.0)),
        (ca.tanh, np.tanh(-0.5), np.tanh(1.0)),
        (ca.cosh, 1.0, np.cosh(1.0)),
    ],
)
def test_over_an_interval_the_range_is_enclosed(expression, low, high):
    """Of x from -0.5 to 1: all of it, and of functions without cancellation little more."""
    x = ca.SX.sym("x")
    (found,) = walk_of(ca.Function("f", [x], [expression(x)]))([arb(0.25, 0.75)])[0].values()
    assert float(found.lower()) <= low + 1e-12
    assert float(found.upper()) >= high - 1e-12
    assert float(found.upper() - found.lower()) <= 2.0 * (high - low) + 1.5


@pytest.mark.parametrize("middle", [-1.5, 1.5])
def test_where_its_sign_is_known_a_signed_square_keeps_it(middle):
    x = ca.SX.sym("x")
    (found,) = walk_of(ca.Function("f", [x], [x * ca.fabs(x)]))([arb(middle, 0.1)])[0].values()
    low, high = sorted(np.sign(middle) * np.square([1.4, 1.6]))
    assert low - 0.05 <= float(found.lower()) <= low + 1e-12
    assert high - 1e-12 <= float(found.upper()) <= high + 0.05


@pytest.mark.parametrize("exponent", [5, 0, -3, 64])
def test_a_whole_power_of_a_negative_number_is_that_of_numbers_and_finite_around_zero(exponent):
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    walk = walk_of(ca.Function("f", [x, y], [x**y]))
    (found,) = walk([arb(-1.5)], [arb(exponent)])[0].values()
    assert float(found.mid()) == pytest.approx((-1.5) ** exponent)
    (around,) = walk([arb(0.125, 0.5)], [arb(exponent)])[0].values()
    assert around.is_finite() == (exponent >= 0)


def test_an_operation_without_an_enclosure_is_refused():
    x = ca.SX.sym("x")
    with pytest.raises(UnknownOperationError):
        walk_of(ca.Function("f", [x], [ca.erf(x)]))
