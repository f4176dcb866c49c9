"""Existence of a motion near the planned one: contraction, tubes and radii against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from flint import arb, ctx
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.planner.proof.contraction import LinearBox, _growth, _transition, contracted
from linkplan.planner.proof.existence import Neighbourhood, _slopes_at, first_tube
from linkplan.planner.proof.finding import Finding
from linkplan.planner.proof.motion import Piece
from linkplan.planner.proof.prove import prove, states_of
from linkplan.planner.proof.taylor import TaylorForm
from linkplan.planner.proof.walk import blocks_of
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import HINGE, HINGE_INERTIA, PENDULUM, QUARTER_TURN, TURN, body_plan
from tests.support.motions import motion_along
from tests.support.plans import optimal


def radii(plan, trajectory: Trajectory) -> list[Finding]:
    """Return the findings on the model's own motion near a trajectory: first of position, then of speed."""
    return [finding for finding in prove(plan.problem, trajectory).findings if "own motion" in finding.name]


def pushed(trajectory: Trajectory, effort: float) -> Trajectory:
    """Return a trajectory with more effort at every instant."""
    return replace(trajectory, effort=trajectory.effort + effort)


def integrated(mechanism: Mechanism, trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest distances in position and speed (n_s,) of the model's own motion, by tight steps."""
    n_q, far = mechanism.n_q, []
    state = np.concatenate([trajectory.start_pose, trajectory.slope_at(np.zeros(1))[0]])

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        effort = trajectory.effort_at(np.array([t]))[0]
        return np.concatenate([np.array(x).ravel() for x in mechanism.dynamics.flow(y[:n_q], y[n_q:], effort)])

    for begin, end in zip(trajectory.breaks_s[:-1], trajectory.breaks_s[1:], strict=True):
        times = np.linspace(begin, end - 1e-12, 4)
        found = solve_ivp(rate, (begin, times[-1]), state, method="DOP853", rtol=1e-13, atol=1e-14, t_eval=times).y.T
        state = found[-1]
        apart = found[:, mechanism.independent] - trajectory.position_at(times)
        far.append([np.abs(apart).max(axis=0), np.abs(found[:, n_q:] - trajectory.slope_at(times)).max(axis=0)])
    return tuple(np.max(far, axis=0))


@pytest.mark.parametrize("error", [1e-6, 2e-5])
def test_the_radius_of_a_hinge_with_a_known_error_is_the_distance_in_closed_form(error):
    """Too much effort e on an inertia I leads away by e t^2 / (2 I), with the speed e t / I."""
    plan = body_plan(HINGE, QUARTER_TURN + "duration_s = 1.0\n")
    position, speed = radii(plan, pushed(plan.trajectory, error))
    assert position.answer == speed.answer == "proved"
    away = np.degrees(error / HINGE_INERTIA)
    assert 0.5 * away <= position.bound == pytest.approx(0.5 * away, rel=0.05)
    assert position.margin == pytest.approx(position.mark - position.bound, rel=1e-12)
    assert away <= speed.bound == pytest.approx(away, rel=0.05)


@pytest.mark.parametrize("error", [0.0, 1e-5])
def test_an_integration_with_tight_steps_stays_within_the_radius(error):
    plan = optimal("knee-reach")
    trajectory = pushed(plan.trajectory, error)
    position, speed = radii(plan, trajectory)
    assert position.answer == speed.answer == "proved"
    in_position, in_speed = np.degrees(integrated(plan.problem.mechanism, trajectory)).ravel()
    assert in_position <= position.bound <= 0.01
    assert in_speed <= speed.bound


def test_the_radius_of_a_pendulum_contains_its_own_motion():
    turn = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 60.0 }\nduration_s = 1.5\n'
    plan = body_plan(PENDULUM.format(limit=20), turn)
    position, speed = radii(plan, pushed(plan.trajectory, 1e-6))
    in_position, in_speed = np.degrees(integrated(plan.problem.mechanism, pushed(plan.trajectory, 1e-6))).ravel()
    assert position.answer == "proved"
    assert 1e-7 < in_position <= position.bound <= 3 * in_position
    assert in_speed <= speed.bound


@pytest.mark.parametrize(
    ("spoilt", "reason"),
    [
        (lambda motion: pushed(motion, 0.5), "of the motion's span or largest speed"),
        (lambda motion: replace(motion, velocity=1.001 * motion.velocity), "not the slope"),
    ],
    ids=["efforts of another motion", "velocities that are no slope of the positions"],
)
def test_a_motion_that_its_efforts_or_velocities_do_not_give_leads_to_no_proof(spoilt, reason):
    plan = optimal("knee-reach")
    (found,) = radii(plan, spoilt(plan.trajectory))
    assert found.answer == "sampled"
    assert reason in found.reason


def test_every_box_adds_its_variation_to_the_contraction():
    """Over one box of width h without slopes, v = h D |x| and s = h v: the contraction is D (h + h^2)."""

    def contraction(*variations: float) -> float:
        form = TaylorForm(coefficients=[arb(0)], remainder=arb(1e-6), whole=arb(0))
        boxes = [
            LinearBox(
                end_s=0.1 * (k + 1),
                tube=np.ones(2),
                width=arb(0.1),
                slopes=[[[0.0], [0.0]]],
                variation=[[arb(d), arb(d)]],
                defect=[form],
                jump=[arb(0)] * 2,
            )
            for k, d in enumerate(variations)
        ]
        return contracted(boxes, 1)[1]

    assert contraction(0.0) < 1e-300
    assert contraction(0.01) == pytest.approx(0.01 * 0.11, rel=1e-12)
    assert contraction(0.01, 0.01) > 1.2 * max(contraction(0.01, 0.0), contraction(0.0, 0.01))


@pytest.mark.parametrize("name", ["cart-pole-swing-up", "gripper-close"])
def test_the_first_tube_s_bounds_make_a_second_one_in_which_a_motion_is_proved(name):
    plan = optimal(name)
    found = radii(plan, plan.trajectory)
    assert len(found) == 2 * plan.problem.mechanism.dof
    assert {finding.answer for finding in found} == {"proved"}


# Along t^2 (3 - 2 t) of the quarter turn in two seconds: its largest acceleration.
DURATION_S, ACCELERATION = 2.0, 1.5 * TURN


def without_efforts() -> Trajectory:
    """Return the hinge's quarter turn, with no effort."""
    begin = np.radians(10.0)
    return motion_along([0.0, DURATION_S], [begin, begin, begin + TURN, begin + TURN], effort=np.zeros((2, 1, 1)))


def near() -> Neighbourhood:
    """Return the neighbourhood of the hinge's quarter turn, in its first tube."""
    mechanism, trajectory = load_mechanism(HINGE), without_efforts()
    return Neighbourhood(mechanism, trajectory, first_tube(trajectory))


def form(*coefficients: float, remainder: float) -> TaylorForm:
    return TaylorForm(coefficients=[arb(c) for c in coefficients], remainder=arb(remainder), whole=arb(0))


@pytest.mark.parametrize(
    ("coefficients", "remainder", "small"),
    [
        ((0.0,), 0.9e-7 * ACCELERATION, True),
        ((0.0,), 1.1e-7 * ACCELERATION, False),
        ((1e-3, -1e-3), 0.49e-3, True),
        ((1e-3, -1e-3), 0.51e-3, False),
    ],
)
def test_a_defect_is_small_by_the_acceleration_or_by_its_polynomial(coefficients, remainder, small):
    assert near()._is_small([form(*coefficients, remainder=remainder)]) is small


@pytest.mark.parametrize(
    ("stiffness", "damping", "tight"),
    [
        (form(0.0, remainder=0.24), form(0.0, remainder=0.49), True),  # 1 / T^2 and 1 / T
        (form(0.0, remainder=0.26), form(0.0, remainder=0.49), False),
        (form(0.0, remainder=0.24), form(0.0, remainder=0.51), False),
        (form(-3.0, remainder=2.9), form(2.0, remainder=1.9), True),
        (form(-3.0, remainder=3.1), form(2.0, remainder=1.9), False),
    ],
)
def test_slopes_are_tight_by_their_own_size_or_by_the_motion_s_rates(stiffness, damping, tight):
    assert near()._is_tight([[stiffness, damping]]) is tight


def test_the_defect_of_a_turn_without_efforts_is_its_acceleration():
    """Over the whole quarter turn, x from -1 to 1, the defect is exactly -A x; its remainder is zero."""
    ctx.prec = 100
    blocks, piece = blocks_of(load_mechanism(HINGE)), Piece.of(without_efforts(), 0)
    middle, whole, _ = states_of(blocks, piece, (0.5, 0.5), np.zeros(0), [arb(0)], 2)
    (defect,) = near()._defect((middle, whole), 2)
    assert [abs(float(c.mid())) for c in defect.coefficients] == pytest.approx([0.0, ACCELERATION], abs=1e-12)
    assert float(defect.remainder) < 1e-12


@pytest.mark.parametrize("acceleration", [0.0, 30.0])
def test_slopes_of_the_motion_equation_are_those_of_the_model_from_any_acceleration(acceleration):
    mechanism = load_mechanism("optimus-knee")
    q, v, u = mechanism.home, np.array([2.0]), np.array([40.0])
    balls = [[arb(float(x)) for x in values] for values in (q, v, [acceleration], u)]
    (found,) = _slopes_at(mechanism, *balls)
    by_s, by_v, _ = mechanism.dynamics.linearisation(q, v, u)
    assert [float(x.mid()) for x in found] == pytest.approx([float(by_s), float(by_v)], rel=1e-9)


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
