"""Bounds on linear errors over boxes: fundamental matrices against scipy, and the closed form of a double integrator."""

import numpy as np
import pytest
from flint import arb
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from linkplan.planner.proof.contraction import LinearBox, _growth, _transition, contracted
from linkplan.planner.proof.taylor import TaylorForm

# A double integrator of one coordinate; a damped one with a spring that changes; two that are coupled.
FREE = [[[0.0], [0.0]]]
CHANGING = [[[-9.0, 2.0, 0.5], [-1.0]]]
COUPLED = [[[-9.0], [4.0, 1.0], [-0.5], [0.2]], [[2.0], [3.0, -2.0], [0.0], [-0.3, 0.1]]]


def box(slopes, width: float = 0.1, defect=((0.0,),), remainder: float = 0.0, jump=None) -> LinearBox:
    n_s = len(slopes)
    return LinearBox(
        end_s=width,
        tube=np.ones(2 * n_s),
        width=arb(width),
        slopes=slopes,
        variation=[[arb(0)] * (2 * n_s) for _ in range(n_s)],
        defect=[TaylorForm(coefficients=[arb(c) for c in d], remainder=arb(remainder), whole=arb(0)) for d in defect],
        jump=[arb(j) for j in (jump or [0.0] * (2 * n_s))],
    )


def numbers(matrix) -> np.ndarray:
    return np.array([[float(x.mid()) for x in row] for row in matrix.tolist()])


def state_matrix(slopes, x: float, size=float) -> np.ndarray:
    """Return A of e' = A e at x in [-1, 1], e of positions and velocities."""
    n_s = len(slopes)
    lower = [[sum(size(c) * size(x) ** k for k, c in enumerate(entry)) for entry in row] for row in slopes]
    return np.vstack([np.hstack([np.zeros((n_s, n_s)), np.eye(n_s)]), lower])


@pytest.mark.parametrize("slopes", [FREE, CHANGING, COUPLED])
@pytest.mark.parametrize("unit", [1.0, 3.0])
def test_the_fundamental_matrix_and_what_a_defect_adds_are_those_of_tight_steps(slopes, unit):
    n_s, h = len(slopes), 0.4
    defect = [[0.5, -0.3, 0.2], [0.1, 0.7]][:n_s]
    scale = np.array([1.0] * n_s + [1 / unit] * n_s)

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        x = 2 * t / h - 1
        d = np.array([np.polynomial.polynomial.polyval(x, c) for c in defect])
        forced = np.zeros((2 * n_s, 2 * n_s + 1))
        forced[n_s:, -1] = -d
        return (state_matrix(slopes, x) @ y.reshape(2 * n_s, -1) + forced).ravel()

    begin = np.hstack([np.eye(2 * n_s), np.zeros((2 * n_s, 1))])
    found = solve_ivp(rate, (0.0, h), begin.ravel(), method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1].reshape(2 * n_s, -1)
    phi, added = _transition(box(slopes, h, defect), arb(unit), n_s)
    np.testing.assert_allclose(numbers(phi), scale[:, None] * found[:, :-1] / scale, atol=1e-11)
    np.testing.assert_allclose(numbers(added), scale[:, None] * found[:, -1:], atol=1e-11)


def test_what_the_series_leaves_out_is_bounded_by_its_growth_on_a_disc():
    """|Y| <= exp(int_0^8 |A| dy) there, y = x + 1; the terms after the fortieth are below a third of that over 4^40."""
    h, slopes = 4.0, [[[-3.0, 2.0], [0.0]]]
    # A of y, over a half width: [0 1; -5 + 2 y, 0]. The norms of its coefficients are 5 and 2; of the defect none.
    growth = np.exp(h / 2 * (8 * 5.0 + 32 * 2.0))
    phi, _ = _transition(box(slopes, h), arb(1.0), 1)
    left_out = growth / 3 / 4.0**40
    for x in phi.entries():
        assert left_out <= float(x.rad()) == pytest.approx(left_out, rel=1e-3)


@pytest.mark.parametrize("slopes", [FREE, CHANGING, COUPLED])
def test_growth_is_the_exponential_of_the_slopes_sizes(slopes):
    n_s, h, unit = len(slopes), 0.3, 2.0
    scale = np.array([1.0] * n_s + [1 / unit] * n_s)
    size = np.abs(state_matrix([[[abs(c) for c in entry] for entry in row] for row in slopes], 1.0))
    expected = expm(h * scale[:, None] * size / scale)
    np.testing.assert_allclose(numbers(_growth(box(slopes, h), arb(unit), n_s)), expected, rtol=1e-12)


def test_errors_of_a_double_integrator_add_up_as_in_closed_form():
    """Two boxes of width h: remainders r and the plan's jump act by their size, the polynomial d with its sign.

    With G = [1 h; 0 1], the first reaches G (0, h d) + G (0, h r), and the second begins at |(d h^2 / 2, d h)|, at what
    remainders left of the first, and at the jump.
    """
    h, d, r, jump = 0.1, -0.5, 0.02, [0.003, 0.07]
    boxes = [box(FREE, h, [[d]], r, [9.0, 9.0]), box(FREE, h, [[d]], r, jump)]  # the first begins where the plan does
    G = np.array([[1.0, h], [0.0, 1.0]])
    own = G @ [0.0, h * r]
    first = own + G @ [0.0, h * abs(d)]
    begin = np.array([abs(d) * h**2 / 2, abs(d) * h]) + own + jump
    np.testing.assert_allclose(contracted(boxes, 1)[0], [first, G @ begin + first], rtol=1e-10)


def test_defects_of_opposite_signs_cancel_and_remainders_do_not():
    """After d and -d over boxes of one width, the speed is back and the position off by d h^2; a third box begins there."""
    h, d, r = 0.1, 0.5, 1e-3
    boxes = [box(FREE, h, [[d]]), box(FREE, h, [[-d]]), box(FREE, h, [[0.0]], r)]
    bounds, _ = contracted(boxes, 1)
    G = np.array([[1.0, h], [0.0, 1.0]])
    third = G @ [d * h**2, 0.0] + G @ [0.0, h * r]
    second = G @ [d * h**2 / 2, d * h] + G @ [0.0, h * d]
    np.testing.assert_allclose(bounds[1:], [second, np.maximum(second, third)], rtol=1e-10)
    remainders = contracted([box(FREE, h, [[0.0]], r)] * 3, 1)[0]
    own = G @ [0.0, h * r]
    np.testing.assert_allclose(remainders, [own, G @ own + own, G @ (G @ own + own) + own], rtol=1e-10)
