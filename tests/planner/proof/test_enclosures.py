"""Enclosures against a second route: mpmath in 50 digits, the closure by Newton, the efforts by the planner's long form."""

import mpmath as mp
import numpy as np
import pytest
from flint import arb, ctx

from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.branch import krawczyk, newton
from linkplan.planner.proof.motion import Piece
from linkplan.planner.proof.prove import TAYLOR_ORDER, states_of
from linkplan.planner.proof.taylor import NotSeparatedError, TaylorForm
from linkplan.planner.proof.walk import blocks_of
from linkplan.planner.trajectory import Trajectory
from tests.support.mp_functions import ball, mp_effort, mp_motion, mp_pose, mp_values
from tests.support.plans import optimal
from tests.support.provable import INTERVALS, swing

BITS = 80


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
