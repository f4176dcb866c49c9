"""Taylor forms with remainders, and linear systems of series."""

import math

import numpy as np
import pytest
from flint import arb, arb_series, ctx

from linkplan.planner.proof.taylor import NotSeparatedError, TaylorForm, product, solve_enclosed, transposed

UNKNOWN = arb(0, math.inf)


@pytest.fixture(autouse=True)
def short_series():
    ctx.cap = 10


def form(*coefficients: float, remainder: float = 0.0, whole: float = math.inf) -> TaylorForm:
    return TaylorForm(coefficients=[arb(c) for c in coefficients], remainder=arb(remainder), whole=arb(0, whole))


@pytest.mark.parametrize(
    ("box", "coefficients", "remainder"),
    [
        ([1.0, 2.0, 3.0, 4.0], [10.0, 20.0, 30.0], 4.0),
        ([1.0, 2.0, -3.0, None], [10.0, 20.0], 3.0),
        ([1.0, 2.0, None, None], [10.0], 2.0),
        ([1.0, None, None, None], [1.0], 0.0),
    ],
)
def test_beside_a_kink_a_form_has_as_many_coefficients_as_are_known(box, coefficients, remainder):
    """Three at most here, those at the middle; the next one over the whole box bounds the rest."""
    over = arb_series([UNKNOWN if c is None else arb(c) for c in box], prec=4)
    found = TaylorForm.of(arb_series([10, 20, 30, 40], prec=4), over, 3)
    assert [float(c.mid()) for c in found.coefficients] == coefficients
    assert float(found.remainder) == remainder
    assert float(found.whole.mid()) == 1.0


@pytest.mark.parametrize(("low", "high", "answer"), [(-1.0, 4.0, True), (0.0, 4.0, None), (-1.0, 3.0, None)])
def test_without_a_remainder_the_range_over_the_box_alone_is_judged(low, high, answer):
    found = TaylorForm(coefficients=[arb(1)], remainder=UNKNOWN, whole=arb(1.5, 2.0)).verdict(arb(low), arb(high))
    assert found.answer is answer
    assert (found.least, found.greatest) == pytest.approx((-0.5, 3.5))


@pytest.mark.parametrize("sign", [+1.0, -1.0])
@pytest.mark.parametrize(("mark", "answer"), [(3.01, True), (2.99, False)])
def test_a_line_is_kept_or_broken_at_the_end_where_it_is_largest(sign, mark, answer):
    """1 + 2 x is -1 to 3; with the other sign it is low that is broken."""
    for slope in (2.0, -2.0):
        found = form(sign, sign * slope).verdict(*sorted((arb(sign * mark), arb(-sign * 1.01)), key=lambda x: float(x)))
        assert found.answer is answer
        if answer:
            assert sorted((sign * found.least, sign * found.greatest)) == pytest.approx([-1.0, 3.0])
        else:
            assert found.at == pytest.approx(math.copysign(1.0, slope))
            assert sign * found.least == pytest.approx(3.0)


def test_a_remainder_leaves_open_what_it_may_break_and_is_counted_on_both_sides():
    assert form(1.0, 2.0, remainder=0.1).verdict(arb(-1.11), arb(3.11)).answer is True
    assert form(1.0, 2.0, remainder=0.1).verdict(arb(-1.09), arb(3.11)).answer is None
    assert form(1.0, 2.0, remainder=0.1).verdict(arb(-1.11), arb(3.09)).answer is None
    broken = form(1.0, 2.0, remainder=0.1).verdict(arb(-1.11), arb(2.89))
    assert broken.answer is False
    assert (broken.least, broken.greatest) == pytest.approx((2.9, 3.1))
    found = form(1.0, 2.0, remainder=0.1).verdict(arb(-1.09), arb(3.11))
    assert (found.least, found.greatest) == pytest.approx((-1.1, 3.1), rel=0.1)


@pytest.mark.parametrize(("room", "answer"), [(1e-10, True), (1e-15, None), (-1e-10, False)])
def test_a_box_is_halved_up_to_a_million_times(room, answer):
    """1 - (x - r)^2 is 1 at r = 1 / sqrt(2); over a millionth of the box it differs from its polygon by 1e-12."""
    r = math.sqrt(0.5)
    curve = form(1.0 - r * r, 2.0 * r, -1.0)
    for sign in (+1.0, -1.0):
        signed = form(*(sign * float(c) for c in curve.coefficients))
        marks = (arb(-9), arb(1.0 + room)) if sign > 0 else (arb(-1.0 - room), arb(9))
        found = signed.verdict(*marks)
        assert found.answer is answer
        if answer is not False:  # a range over the whole box, whose end at -1 is the farthest from r
            assert sorted((sign * found.least, sign * found.greatest)) == pytest.approx([1.0 - (1.0 + r) ** 2, 1.0])


def test_bounds_of_verdicts_contain_the_range_tightly():
    rng = np.random.default_rng(0)
    x = np.linspace(-1.0, 1.0, 4001)
    for _ in range(5):
        c = rng.normal(size=6)
        values = np.polynomial.polynomial.polyval(x, c)
        found = form(*c).verdict(arb(values.min() - 1e-3), arb(values.max() + 1e-3))
        assert found.answer is True
        assert values.min() - 1e-3 <= found.least <= values.min() + 1e-9
        assert values.max() - 1e-9 <= found.greatest <= values.max() + 1e-3


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_bounds_far_within_the_marks_are_tight_where_they_extend_the_known_range(side):
    """1 - 8 x^2 + 8 x^4 is -1 to 1. Its Bernstein coefficients are -3 to 1; on eighths of the box the least is -1.02."""
    curve = form(side, 0.0, -8.0 * side, 0.0, 8.0 * side)
    loose, tight = (curve.verdict(arb(-9), arb(9), known=(known, -known)) for known in (-math.inf, math.inf))
    assert sorted((side * loose.least, side * loose.greatest)) == pytest.approx([-3.0, 1.0])
    assert sorted((side * tight.least, side * tight.greatest)) == pytest.approx([-1.0, 1.0], rel=2e-2)
    assert loose.answer is tight.answer is True
    known_already = curve.verdict(arb(-9), arb(9), known=(-3.5, 3.5))
    assert (known_already.least, known_already.greatest) == (loose.least, loose.greatest)
    small = curve.verdict(arb(-9), arb(9), known=(math.inf, -math.inf), size=400.0)
    assert (small.least, small.greatest) == (loose.least, loose.greatest)


def entries(A: np.ndarray) -> dict:
    return {(i, j): arb(float(A[i, j])) for i, j in np.argwhere(A)}


def numbers(x) -> np.ndarray:
    return np.array([float(one.mid()) for one in x])


@pytest.mark.parametrize("seed", range(4))
def test_sparse_systems_have_the_solutions_of_dense_ones(seed):
    """With zeros on the diagonal, so that rows change places, and right sides with zeros, which None stands for."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(5, 5)) * (rng.uniform(size=(5, 5)) < 0.6)
    np.fill_diagonal(A[:, ::-1], rng.choice([-1, 1], 5) * rng.uniform(1.0, 2.0, 5))
    b = rng.normal(size=(5, 2)) * (rng.uniform(size=(5, 2)) < 0.6)
    found = solve_enclosed(entries(A), [[arb(float(x)) if x else None for x in column] for column in b.T])
    np.testing.assert_allclose(np.array([numbers(x) for x in found]).T, np.linalg.solve(A, b), atol=1e-12)
    (flat,) = solve_enclosed(transposed(entries(A)), [[arb(float(x)) for x in b[:, 0]]])
    np.testing.assert_allclose(numbers(flat), np.linalg.solve(A.T, b[:, 0]), atol=1e-12)
    np.testing.assert_allclose(numbers(product(entries(A), [arb(float(x)) for x in b[:, 1]], 5)), A @ b[:, 1], atol=1e-12)


def test_a_system_of_series_is_solved_coefficient_by_coefficient():
    """(2 + t) x = 1 + 3 t."""
    ((x,),) = solve_enclosed({(0, 0): arb_series([2, 1], prec=3)}, [[arb_series([1, 3], prec=3)]])
    assert [float(x[k].mid()) for k in range(3)] == pytest.approx([0.5, 1.25, -0.625])


@pytest.mark.parametrize("matrix", [{(0, 0): arb(0, 1)}, {(0, 0): arb(1, 1)}, {(0, 0): arb(-1, 1.5)}, {}])
def test_a_pivot_that_may_vanish_is_refused(matrix):
    with pytest.raises(NotSeparatedError):
        solve_enclosed(matrix, [[arb(1)]])
    assert solve_enclosed({(0, 0): arb(-1, 0.5)}, [[arb(1)]])
