"""Bernstein polynomials, and an interval's rows and unknowns."""

import casadi as ca
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
from linkplan.planner.transcription.interval import IntervalRows, build_chain
from linkplan.planner.transcription.schemes import scheme
from linkplan.planner.transcription.system import System, build_node, node_symbols

SHARE, DURATION = 0.25, 3.0  # of a segment's duration: the interval is 0.75 long
WIDTH = SHARE * DURATION
ALPHA, BETA = 0.4, -1.7
ROWS = IntervalRows(
    costs=("time", "effort", "effort_rate"),
    speed_columns=(0,),
    position_columns=(1,),
    rate_columns=(1,),
    motor_columns=((0, 1), (1, 0)),
    power_columns=((1, 0),),
)


def system() -> System:
    """Return two masses that two efforts push."""
    node = node_symbols(2, 0, 0, 2)
    column = ca.vertcat(node.a - node.u, ca.SX(0))
    return System(
        n_s=2, n_x=0, n_z=0, n_u=2, node=ca.Function("node", [node.stacked, ca.SX.sym("p", 0)], [column]),
        n_equations=2, n_path=0, kinds=("dynamics",) * 2,
    )  # fmt: skip


def test_an_interval_has_a_weight_for_its_time_and_for_each_effort_and_a_line_for_each_motor():
    assert ROWS.n_eta(2, 2) == 1 + 2 + 2 + 4
    assert IntervalRows(costs=("effort",)).n_eta(3, 2) == 3
    assert IntervalRows(costs=("time",), motor_columns=((0, 0),)).n_eta(3, 2) == 3


@pytest.mark.parametrize("name", ["radau-3", "gauss-2", "hermite-simpson"])
def test_own_rows_are_the_coefficients_of_what_they_limit(name):
    chosen = scheme(name)
    m = chosen.n_nodes
    chain = build_chain(system(), chosen, ROWS, build_node(system()))
    draw = np.random.default_rng(1)
    s0, v0, s1, v1 = draw.normal(size=(4, 2))
    a, u = draw.normal(size=(m, 2)), draw.normal(size=(chosen.effort_at.shape[1], 2))
    w = np.concatenate([s0, v0, a.ravel(), u.ravel(), s1, v1, [DURATION]])
    eta = np.array([2.0, 0.3, 0.5, 0.07, 0.09, ALPHA, BETA, 3 * ALPHA, 5 * BETA])
    own, cost = (np.array(value).ravel() for value in chain.own(w, SHARE, eta))

    tau = np.linspace(0.0, 1.0, 11)
    kinds, items = np.array(chain.own_kinds), np.array(chain.own_items)

    def along(kind: str, item: int) -> np.ndarray:
        """Return what a row's coefficients are of, at 11 instants."""
        coefficients = own[(kinds == kind) & (items == item)]
        return bernstein_matrix(len(coefficients) - 1, tau) @ coefficients

    def values(coefficients: np.ndarray) -> np.ndarray:
        return bernstein_matrix(len(coefficients) - 1, tau) @ coefficients

    speed = v0 + WIDTH * values(chosen.velocity_coefficients @ a)
    position = s0 + WIDTH * tau[:, None] * v0 + WIDTH**2 * values(chosen.position_coefficients @ a)
    effort = values(u)
    assert along("speed", 0) == pytest.approx(speed[:, 0])
    assert along("position", 0) == pytest.approx(position[:, 1])
    assert along("power", 0) == pytest.approx(effort[:, 1] * speed[:, 0])
    assert along("motor", 0) == pytest.approx(ALPHA * effort[:, 0] + BETA * speed[:, 1])
    assert along("motor", 1) == pytest.approx(3 * ALPHA * effort[:, 1] + 5 * BETA * speed[:, 0])
    slope = np.array([np.polynomial.Polynomial.fit(tau, effort[:, j], m - 1).deriv()(tau) for j in range(2)]).T / WIDTH
    assert along("effort_rate", 0) == pytest.approx(slope[:, 1])
    # The interval's end is where the next one begins.
    gaps = own[kinds == "continuity"]
    assert gaps == pytest.approx(np.concatenate([s1 - position[-1], v1 - speed[-1]]))

    points, weights = np.polynomial.legendre.leggauss(8)
    at = bernstein_matrix(len(u) - 1, 0.5 + 0.5 * points) @ u
    integral = 0.5 * WIDTH * weights @ at**2
    rates = np.array(
        [np.polynomial.Polynomial.fit(tau, effort[:, j], m - 1).deriv()(0.5 + 0.5 * points) for j in range(2)]
    ).T
    of_rates = 0.5 * WIDTH * weights @ (rates / WIDTH) ** 2
    assert cost == pytest.approx([2.0 * WIDTH + np.dot([0.3, 0.5], integral) + np.dot([0.07, 0.09], of_rates)])


@pytest.mark.parametrize("name", ["radau-3", "gauss-2", "trapezoid"])
def test_unknowns_at_nodes_are_those_of_the_polynomials(name):
    """One mass and one state of first order: speeds and states integrate accelerations and rates, positions speeds."""
    chosen, node = scheme(name), node_symbols(1, 1, 0, 1)
    column = ca.vertcat(node.a - node.u, node.r - node.x, ca.SX(0))
    one = System(
        n_s=1, n_x=1, n_z=0, n_u=1, node=ca.Function("node", [node.stacked, ca.SX.sym("p", 0)], [column]),
        n_equations=2, n_path=0, kinds=("dynamics",) * 2,
    )  # fmt: skip
    m, draw = chosen.n_nodes, np.random.default_rng(2)
    (s0, v0, x0), end = draw.normal(size=3), draw.normal(size=3)
    a, r, u = draw.normal(size=m), draw.normal(size=m), draw.normal(size=chosen.effort_at.shape[1])
    w = np.concatenate([[s0, v0, x0], a, r, u, end, [DURATION]])
    chain = build_chain(one, chosen, IntervalRows(state_columns=(0,)), build_node(one))
    found, own = np.array(chain.nodes(w, SHARE)), np.array(chain.own(w, SHARE, [])[0]).ravel()

    def through(values: np.ndarray) -> np.polynomial.Polynomial:
        return np.polynomial.Polynomial(np.polynomial.polynomial.polyfit(chosen.nodes, values, m - 1))

    at = np.array(chosen.nodes)
    speed = v0 + WIDTH * through(a).integ()(at)
    # Where accelerations are a polynomial through the nodes, positions are its second integral.
    position = s0 + WIDTH * (v0 * at + WIDTH * through(a).integ(2)(at))
    if name == "trapezoid":  # in first-order form it is the integral of the polynomial through the speeds
        position = s0 + WIDTH * through(speed).integ()(at)
    state = x0 + WIDTH * through(r).integ()(at)
    effort = bernstein_matrix(len(u) - 1, at) @ u
    assert found == pytest.approx(np.array([position, speed, a, state, r, effort]))
    # Rows: what the next interval begins with less where this one ends, then the coefficients of the state.
    position = s0 + WIDTH * v0 + WIDTH**2 * float(chosen.position_coefficients[-1] @ a)
    reached = [position, v0 + WIDTH * through(a).integ()(1.0), x0 + WIDTH * through(r).integ()(1.0)]
    assert own[:3] == pytest.approx(end - reached)
    tau = np.linspace(0.0, 1.0, 7)
    along = bernstein_matrix(len(own) - 4, tau) @ own[3:]
    assert along == pytest.approx(x0 + WIDTH * through(r).integ()(tau))


@pytest.mark.parametrize("name", ["radau-3", "gauss-3", "hermite-simpson"])
def test_the_jerk_at_nodes_and_open_ends_is_the_slope_of_the_polynomial_of_accelerations(name):
    chosen, node = scheme(name), node_symbols(2, 0, 0, 2, has_jerk=True)
    column = ca.vertcat(node.a - node.u, ca.sumsqr(node.j), ca.SX(0))
    two = System(
        n_s=2, n_x=0, n_z=0, n_u=2, node=ca.Function("node", [node.stacked, ca.SX.sym("p", 0)], [column]),
        n_equations=2, n_path=1, kinds=("dynamics", "dynamics", "site_jerk"), has_jerk=True,
    )  # fmt: skip
    draw = np.random.default_rng(3)
    a = draw.normal(size=(chosen.n_nodes, 2))
    w = np.concatenate([draw.normal(size=4), a.ravel(), draw.normal(size=chosen.effort_at.shape[1] * 2 + 4), [DURATION]])
    chain = build_chain(two, chosen, IntervalRows(open_end_path=(0,)), build_node(two, (0,)))
    found = np.array(chain.nodes(w, SHARE))[6:8].T
    at = np.append(chosen.nodes, chosen.open_ends)
    fits = [np.polynomial.Polynomial(np.polynomial.polynomial.polyfit(chosen.nodes, column, 2)) for column in a.T]
    assert len(found) == len(at)
    assert found == pytest.approx(np.array([fit.deriv()(at) / WIDTH for fit in fits]).T)


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
