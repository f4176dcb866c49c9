"""Enclosures against a second route: mpmath in 50 digits, the closure by Newton, the efforts by the planner's long form."""

import math

import mpmath as mp
import numpy as np
import pytest
from flint import arb, arb_series, ctx

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.branch import krawczyk, newton, series_of
from linkplan.planner.proof.motion import Piece
from linkplan.planner.proof.prove import TAYLOR_ORDER, states_of
from linkplan.planner.proof.taylor import NotSeparatedError, TaylorForm
from linkplan.planner.proof.walk import Blocks, blocks_of
from linkplan.planner.trajectory import Trajectory
from tests.support.mp_functions import ball, mp_effort, mp_motion, mp_pose, mp_values
from tests.support.plans import optimal
from tests.support.provable import INTERVALS, swing


def value_at(form: TaylorForm, x: arb) -> arb:
    return sum((c * x**k for k, c in enumerate(form.coefficients)), arb(0)) + arb(0, form.remainder)


def check_box(problem: Problem, motion: Trajectory, interval: int, centre: float, radius: float, shares) -> int:
    """Check that enclosures on one box contain poses and efforts of mpmath at shares in [-1, 1] of it; return how many."""
    mechanism, piece = problem.mechanism, Piece.of(motion, interval)
    blocks = blocks_of(mechanism)
    slack = [arb(0)] * motion.n_s
    s = np.array([float(p(arb(centre)).mid()) for p in piece.position])
    guess = newton(blocks, s, motion.start_pose[list(blocks.dependent)])
    middle, whole, _ = states_of(blocks, piece, (centre, radius), guess, slack, TAYLOR_ORDER)
    z = [TaylorForm.of(a, b, TAYLOR_ORDER) for a, b in zip(middle.z, whole.z, strict=True)]
    ctx.cap = TAYLOR_ORDER + 2
    first = middle.of_position.tau[0]
    ctx.cap = TAYLOR_ORDER + 3
    tau = [TaylorForm.of(a, b, TAYLOR_ORDER) for a, b in zip(first, whole.of_position.tau[0], strict=True)]
    for share in shares:
        at = mp.mpf(centre) + mp.mpf(radius) * mp.mpf(float(share))
        positions, v, a = mp_motion(motion, interval, at)
        x = arb(float(share))
        near = np.empty(mechanism.n_q)
        near[list(blocks.independent)] = [float(position) for position in positions]
        near[list(blocks.dependent)] = [float(value_at(form, x).mid()) for form in z]
        q = mp_pose(mechanism, positions, near)
        for form, index in zip(z, blocks.dependent, strict=True):
            assert value_at(form, x).contains(ball(q[index]))
            assert form.whole.contains(ball(q[index]))
        for form, exact in zip(tau, mp_effort(mechanism, q, v, a), strict=True):
            assert value_at(form, x).contains(ball(exact))
    assert problem.name != "knee-reach" or all(form.remainder < 1e-3 for form in tau)
    return len(shares)


def test_enclosures_contain_samples_in_fifty_digits():
    rng = np.random.default_rng(0)
    problem, motion = swing(3)
    assert check_box(problem, motion, 2, 0.5, 0.25, rng.uniform(-1, 1, 10)) == 10
    plan = optimal("knee-reach")
    assert check_box(plan.problem, plan.trajectory, 7, 0.25, 0.25, [-1, 1, *rng.uniform(-1, 1, 5)]) == 7


@pytest.mark.slow
def test_enclosures_of_random_boxes_contain_samples_and_the_boxes_ends():
    rng, n = np.random.default_rng(1), 0
    for seed in range(12):
        problem, motion = swing(seed)
        for _ in range(20):
            radius = float(2.0 ** -rng.integers(4, 8))
            centre = float(rng.integers(1, round(1 / radius))) * radius
            n += check_box(problem, motion, int(rng.integers(INTERVALS)), centre, radius, [-1, 1, *rng.uniform(-1, 1, 3)])
    assert n == 1_200


def test_krawczyk_proves_no_root_where_there_is_none_and_none_across_a_singular_pose():
    problem, motion = swing(3)
    blocks = blocks_of(problem.mechanism)
    s0 = float(motion.position[0, 0, 0])
    guess = newton(blocks, np.array([s0]), motion.start_pose[list(blocks.dependent)])
    root = krawczyk(blocks, [arb(s0)], guess)
    assert all(r.contains(x) for r, x in zip(root.region, root.enclosure, strict=True))
    with pytest.raises(NotSeparatedError):
        krawczyk(blocks, [arb(s0)], guess + 0.3)
    with pytest.raises(NotSeparatedError):
        krawczyk(blocks, [arb(s0, 3.2)], guess)


def test_a_polynomials_range_is_tight_and_a_violation_is_a_point():
    form = TaylorForm(coefficients=[arb(1), arb(0.5), arb(-1), arb(0.25)], remainder=arb(0), whole=arb(0, 10))
    x = (2 - np.sqrt(4 - 1.5)) / 1.5  # where 0.5 - 2 x + 0.75 x^2 vanishes
    top = float(1 + 0.5 * x - x**2 + 0.25 * x**3)
    kept = form.verdict(arb(-10), arb(top + 1e-9))
    assert kept.answer is True
    assert top <= kept.greatest <= top + 1e-9
    broken = form.verdict(arb(-10), arb(top - 1e-9))
    assert broken.answer is False
    assert 1 + 0.5 * broken.at - broken.at**2 + 0.25 * broken.at**3 > top - 1e-9
    vague = TaylorForm(coefficients=form.coefficients, remainder=arb(1e-3), whole=form.whole)
    assert vague.verdict(arb(-10), arb(top + 1e-9)).answer is None


def test_the_blocks_forces_are_the_closure_forces():
    for name in ("knee-reach", "squeezer-turn"):
        problem, motion = optimal(name).problem, optimal(name).trajectory
        blocks, piece = blocks_of(problem.mechanism), Piece.of(motion, 3)
        s = np.array([float(p(arb(0.5)).mid()) for p in piece.position])
        middle, _, _ = states_of(
            blocks,
            piece,
            (0.5, 2.0**-6),
            newton(blocks, s, motion.start_pose[list(blocks.dependent)]),
            [arb(0)],
            TAYLOR_ORDER,
        )
        at, v, a = mp_motion(motion, 3, mp.mpf(0.5))
        q = mp_pose(problem.mechanism, at, np.array([float(x[0].mid()) for x in middle.q]))
        u = [mp.mpf(float(p(arb(0.5)).mid())) for p in piece.effort]
        exact = mp_values(problem.mechanism.dynamics.closure_force, q, v, a, u)
        ctx.cap = TAYLOR_ORDER + 2
        for got, wanted in zip(middle.of_position.closure_forces, exact, strict=True):
            value = got if isinstance(got, arb) else got[0]
            assert abs(float(value.mid()) - float(wanted)) < 1e-9 * max(1.0, abs(float(wanted)))


# A crank of 0.3 m, a rod of 0.8 m and a slider on the axis.
CRANK, ROD = 0.3, 0.8
MODEL = """<mujoco><worldbody>
<body><joint name="O" axis="0 -1 0"/><inertial pos="0.1 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
<body pos="0.3 0 0"><joint name="A" axis="0 -1 0"/><inertial pos="0.4 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
<site name="tip" pos="0.8 0 0"/></body></body>
<body pos="1.1 0 0"><joint name="P" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<site name="pin"/></body></worldbody><equality><connect site1="tip" site2="pin"/></equality>
<actuator><motor joint="O" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def blocks() -> Blocks:
    mechanism = load_mechanism(MODEL)
    assert [mechanism.joints[i].name for i in mechanism.independent] == ["O"]
    return blocks_of(mechanism)


def root(s: float, exactly=math) -> list:
    """Return the rod's angle to the crank [rad] and the slider's place from home [m]."""
    lean = exactly.asin(-CRANK / ROD * exactly.sin(s))
    return [lean - s, CRANK * exactly.cos(s) + ROD * exactly.cos(lean) - CRANK - ROD]


@pytest.mark.parametrize("s", [0.4, 2.0, -1.3])
@pytest.mark.parametrize("off", [0.0, 1e-3, 0.2])
def test_newton_s_method_finds_the_root_near_a_guess(blocks, s, off):
    found = newton(blocks, np.array([s]), np.array(root(s)) + off)
    np.testing.assert_allclose(found, root(s), atol=1e-13)


def test_newton_s_method_says_where_it_does_not_converge(blocks):
    for guess in ([math.pi / 2 - 0.4, 0.0], [1e9, 1e9]):  # the rod across the guide, where J_z is singular
        with pytest.raises(NotSeparatedError):
            newton(blocks, np.array([0.4]), np.array(guess))


@pytest.mark.parametrize(("s", "width"), [(0.4, 0.0), (0.4, 1e-3), (2.0, 0.05)])
def test_krawczyk_s_enclosure_has_the_roots_of_all_positions_of_a_box_and_little_else(blocks, s, width):
    found = krawczyk(blocks, [arb(s, width)], np.array(root(s)))
    for at in (s - width, s, s + width):
        for enclosure, region, exact in zip(found.enclosure, found.region, root(at), strict=True):
            assert region.contains(enclosure)
            assert float(enclosure.lower()) - 1e-14 <= exact <= float(enclosure.upper()) + 1e-14
    assert all(float(enclosure.rad()) <= 3.0 * width + 1e-14 for enclosure in found.enclosure)


def test_a_guess_off_the_root_is_corrected_as_long_as_the_operator_contracts(blocks):
    for off, known in ((1e-6, True), (1e-2, True), (0.7, False)):
        guess = np.array(root(0.4)) + off
        if not known:
            with pytest.raises(NotSeparatedError):
                krawczyk(blocks, [arb(0.4)], guess)
            continue
        found = krawczyk(blocks, [arb(0.4)], guess)
        for enclosure, exact in zip(found.enclosure, root(0.4), strict=True):
            assert float(enclosure.lower()) - 1e-14 <= exact <= float(enclosure.upper()) + 1e-14
            assert float(enclosure.rad()) < 10 * off**2 + 1e-14


class Series:
    """The functions of flint's series that the closed form needs."""

    asin = staticmethod(lambda x: x.asin())
    sin = staticmethod(lambda x: x.sin())
    cos = staticmethod(lambda x: x.cos())


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 7, 8, 9, 12])
def test_a_series_along_a_motion_has_the_closed_form_s_coefficients(blocks, order):
    ctx.cap = order
    s = arb_series([0.4, 1.5, -0.7, 0.3], prec=order)
    start = krawczyk(blocks, [s[0]], np.array(root(0.4))).enclosure
    found = series_of(blocks, [s], start, order)
    ctx.cap = order
    for one, exact in zip(found, root(s, Series), strict=True):
        assert [float(one[k].mid()) for k in range(order)] == pytest.approx(
            [float(exact[k].mid()) for k in range(order)], rel=1e-12, abs=1e-12
        )
