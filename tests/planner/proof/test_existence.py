"""A motion of the model near a plan: the radius contains it, is hardly larger than it must be, and grows with an error."""

from dataclasses import replace

import numpy as np
import pytest
from flint import arb, ctx
from scipy.integrate import solve_ivp

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.planner.proof.contraction import LinearBox, contracted
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


def test_efforts_that_do_not_give_the_motion_lead_to_no_proof():
    plan = optimal("knee-reach")
    (found,) = radii(plan, pushed(plan.trajectory, 0.5))
    assert found.answer == "sampled"
    assert "of the motion's span or largest speed" in found.reason


def test_velocities_that_are_no_slope_of_the_positions_lead_to_no_proof():
    plan = optimal("knee-reach")
    (found,) = radii(plan, replace(plan.trajectory, velocity=1.001 * plan.trajectory.velocity))
    assert found.answer == "sampled"
    assert "not the slope" in found.reason


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


# Along t^2 (3 - 2 t) of the quarter turn in two seconds: the largest coefficient of its speed, and its acceleration.
DURATION_S, SPEED, ACCELERATION = 2.0, 1.5 * TURN, 1.5 * TURN


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


@pytest.mark.parametrize(("share", "answer"), [(0.99, "proved"), (1.01, "sampled")])
def test_a_radius_is_proved_up_to_what_a_certificate_allows(monkeypatch, share, answer):
    """A hundredth of a degree, and a fiftieth of the largest speed."""
    monkeypatch.setattr(Neighbourhood, "radii", lambda _: share * np.array([np.radians(0.01), 0.02 * SPEED]))
    position, speed = near().findings()
    assert (position.answer, speed.answer) == (answer, answer)
    assert (position.mark, speed.mark) == pytest.approx((0.01, np.degrees(0.02 * SPEED)))
    assert position.margin == pytest.approx((1 - share) * 0.01)


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
