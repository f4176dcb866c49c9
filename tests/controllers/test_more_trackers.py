"""LQR with integral action, gain-scheduled PD, computed torque and MPC: each against what it is to be, and run in MuJoCo."""

from dataclasses import replace
from functools import cache

import casadi as ca
import control
import numpy as np
import pytest

from linkplan.controllers.imperfections.imperfections import Imperfections, Sensors
from linkplan.controllers.linearisation import discretise, linearise
from linkplan.controllers.rollout import ControlLoop, Rollout
from linkplan.controllers.trackers.integral_lqr import integrable
from linkplan.controllers.trackers.mpc import HORIZON_BLOCKS
from linkplan.controllers.trackers.names import BUILT_IN, LINEAR, TRACKERS
from linkplan.controllers.trackers.prediction import predictor
from linkplan.controllers.trackers.tracker import StateFeedback, steps_of
from linkplan.models.compiled.functions import compiler
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import close_at
from linkplan.studies.compare.compare import build_tracker
from tests.support.machines import run_alone, run_machines
from tests.support.plans import optimal
from tests.support.references import PERIOD, reference_of
from tests.support.tolerances_planner import ROUNDING, SAME_FIGURE

needs_compiler = pytest.mark.skipif(compiler() is None, reason="this machine has no C compiler")

MORE = ("lqi", "gs-pd+ff", "ct", "mpc")


@cache
def tracker_of(kind: str, name: str = "knee-reach", period_s: float = PERIOD, duration_s: float | None = None):
    return build_tracker(kind, optimal(name), reference_of(name, period_s, duration_s))


@cache
def run_of(kind: str, name: str, *, mass_factor: float = 1.0, delay: int = 0, duration_s: float | None = None) -> Rollout:
    plan = optimal(name)
    loop = ControlLoop(effort_limit=np.array(plan.problem.limits.effort), mass_factor=mass_factor, delay_periods=delay)
    reference = reference_of(name, 1e-4, duration_s)
    return run_alone(plan.problem.mechanism, reference, tracker_of(kind, name, 1e-4, duration_s), loop)


def asked(kind: str, k: int, position: np.ndarray, velocity: np.ndarray, name: str = "knee-reach") -> np.ndarray:
    law = steps_of(tracker_of(kind, name))
    return law.step(k, position, velocity, law.start(len(position)))[0]


def states_about(name: str, k: int, n: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return n states (n, n_s) about a reference's, off by `size` [rad] and ten times that a second."""
    rng, reference = np.random.default_rng(3), reference_of(name)
    shape = (n, reference.position_rad.shape[1])
    return reference.position_rad[k] + size * rng.normal(size=shape), reference.velocity_rad_s[k] + 10 * size * rng.normal(
        size=shape
    )


@pytest.mark.parametrize("kind", TRACKERS)
def test_the_table_of_trackers_says_what_each_one_is(kind):
    law = tracker_of(kind)
    assert law.name == kind
    assert isinstance(law, StateFeedback) == BUILT_IN[kind].in_c
    assert BUILT_IN[kind].in_c or kind not in LINEAR  # a linear law is a table in C


def test_trackers_have_colours_and_words_of_their_own():
    assert len({one.colour for one in BUILT_IN.values()}) == len({one.words for one in BUILT_IN.values()}) == len(TRACKERS)


@pytest.mark.parametrize("name", ["knee-reach", "five-bar-reach"])
@pytest.mark.parametrize("kind", TRACKERS)
def test_a_batch_is_answered_as_its_states_one_by_one_to_the_last_bit(kind, name):
    position, velocity = states_about(name, 30, 9, 0.02)
    batch = asked(kind, 30, position, velocity, name)
    each = np.concatenate([asked(kind, 30, s[None], v[None], name) for s, v in zip(position, velocity, strict=True)])
    assert np.ptp(batch, axis=0).min() > 1e-3
    np.testing.assert_array_equal(batch, each)


@pytest.mark.parametrize("kind", MORE)
def test_on_the_reference_itself_only_the_feedforward_acts(kind):
    reference = reference_of("knee-reach")
    for k in (0, 80, 159):
        effort = asked(kind, k, reference.position_rad[k, None], reference.velocity_rad_s[k, None])
        np.testing.assert_allclose(effort[0], reference.effort[k], rtol=SAME_FIGURE)


@pytest.mark.parametrize("kind", MORE)
def test_a_mechanism_as_modelled_is_tracked(kind):
    followed = run_of(kind, "knee-reach")
    assert followed.stable
    assert 1e-4 < np.degrees(np.abs(followed.error_rad).max()) < 0.05


# Computed torque.


@pytest.mark.parametrize("name", ["knee-reach", "five-bar-reach"])
def test_computed_torque_makes_errors_obey_their_second_order_equation(name):
    mechanism, reference, tracker = optimal(name).problem.mechanism, reference_of(name), tracker_of("ct", name)
    k = 40
    position, velocity = states_about(name, k, 8, 0.05)
    poses = np.array([close_at(mechanism, s, reference.pose_rad[k]) for s in position])
    effort = tracker.effort(k, position, velocity)
    found = sampled(mechanism.dynamics.acceleration, poses, velocity, effort)[:, :, 0]
    w = 2 * np.pi * 20.0
    wanted = (
        tracker.acceleration[k]
        + 2 * w * (reference.velocity_rad_s[k] - velocity)
        + w**2 * (reference.position_rad[k] - position)
    )
    np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-7 * np.abs(wanted).max())


def test_computed_torque_far_from_its_reference_still_answers():
    reference = reference_of("knee-reach")
    effort = tracker_of("ct").effort(40, reference.position_rad[40] + 2.5, reference.velocity_rad_s[40])
    assert np.all(np.isfinite(effort))


# Gain-scheduled PD.


def test_scheduled_gains_are_the_reduced_inertia_times_the_wanted_frequency_and_damping():
    mechanism, reference = optimal("knee-reach").problem.mechanism, reference_of("knee-reach")
    for k in (0, 60, 120):
        inertia = float(mechanism.dynamics.reduced_inertia(reference.pose_rad[k]))
        state = reference.position_rad[k, None] - 0.01, reference.velocity_rad_s[k, None] + 0.2
        w = 2 * np.pi * 20.0
        wanted = reference.effort[k] + inertia * (w**2 * 0.01 - 2 * w * 0.2)
        np.testing.assert_allclose(asked("gs-pd+ff", k, *state)[0], wanted, rtol=SAME_FIGURE)


# LQR with integral action.


def test_integral_gains_at_rest_are_python_control_s():
    plan, reference = optimal("knee-reach"), reference_of("knee-reach", PERIOD, 0.3)
    mechanism, tracking = plan.problem.mechanism, plan.problem.tracking
    states = reference.pose_rad, reference.velocity_rad_s, reference.effort
    A, B = (x[0] for x in discretise(*linearise(mechanism, *(x[-1:] for x in states)), PERIOD))
    A_all = np.block([[A, np.zeros((2, 1))], [np.array([[-PERIOD, 0.0, 1.0]])]])
    B_all = np.concatenate([B, np.zeros((1, 1))])
    position, velocity = tracking.lqr_errors(mechanism.independent_joints)
    weights = np.concatenate([position, velocity, tracking.integral_time_s * position])
    limit = plan.problem.limits.effort[0, 1]
    K, _, _ = control.dlqr(A_all, B_all, np.diag(weights**-2.0), np.array([[limit**-2.0]]))
    gains = tracker_of("lqi", "knee-reach", PERIOD, 0.3).gains[-1]
    np.testing.assert_allclose(gains[0], [K[0, 0], K[0, 1], -K[0, 2]], rtol=1e-6)


def test_integral_action_takes_a_lasting_error_away():
    """A payload a fifth heavier pulls at the goal: LQR stays off, its integral does not."""
    errors = {
        kind: float(np.degrees(np.abs(run_of(kind, "knee-reach", mass_factor=1.2, duration_s=0.8).error_rad[-1]).max()))
        for kind in ("lqr", "lqi")
    }
    assert errors["lqr"] > 1e-3
    assert errors["lqi"] < 0.1 * errors["lqr"]


def test_the_integral_stands_still_beyond_a_limit():
    law, reference = tracker_of("lqi"), reference_of("knee-reach")
    far, near = reference.position_rad[40, None] - 2.0, reference.position_rad[40, None] - 1e-4
    effort, memory = law.step(40, far, reference.velocity_rad_s[40, None], law.start(1))
    assert effort[0, 0] > 100
    np.testing.assert_array_equal(memory, 0)
    _, memory = law.step(40, near, reference.velocity_rad_s[40, None], law.start(1))
    np.testing.assert_allclose(memory, PERIOD * 1e-4, rtol=SAME_FIGURE)


@pytest.mark.parametrize(
    ("name", "integrated"), [("cart-pole-swing-up", [0]), ("knee-reach", [0]), ("five-bar-reach", [0, 1])]
)
def test_as_many_errors_are_integrated_as_efforts_can_keep_at_zero(name, integrated):
    law = tracker_of("lqi", name)
    assert list(law.integrated) == integrated
    assert law.start(3).shape == (3, len(integrated))


def test_an_output_with_a_transmission_zero_at_standstill_is_not_integrated():
    """Of a cart (first) and a pole under one force; of a chain that is driven at its end; of joints without a motor."""
    leaning, force = np.array([[0.0, -1.0], [0.0, 11.0]]), np.array([[1.0], [-1.0]])
    assert list(integrable(leaning, force)) == [0]
    assert list(integrable(leaning[::-1, ::-1], force[::-1])) == [1]
    assert len(integrable(0 * leaning, force)) == 0  # without weight a push at the pole cannot be met
    assert list(integrable(leaning, np.eye(2))) == [0, 1]
    assert len(integrable(leaning, np.array([[1.0, 2.0], [-1.0, -2.0]]))) == 1  # two motors on one joint


@pytest.mark.slow
def test_integral_action_on_a_cart_pole_keeps_the_cart_in_place_where_the_pole_is_read_wrong():
    plan, reference = optimal("cart-pole-swing-up"), reference_of("cart-pole-swing-up", PERIOD, 6.0)
    loop = ControlLoop(effort_limit=np.array(plan.problem.limits.effort))
    wrong = Imperfections(sensors=Sensors(offset=np.array([0.0, np.radians(0.1)])))
    off = {}
    for kind in ("lqr", "lqi"):
        law = tracker_of(kind, "cart-pole-swing-up", PERIOD, 6.0)
        followed = run_machines(plan.problem.mechanism, reference, law, loop, [wrong])
        off[kind] = float(np.abs(followed.pose[-1, 0, 0] - reference.position_rad[-1, 0]))
    assert off["lqr"] > 1e-3
    assert off["lqi"] < 1e-2 * off["lqr"]


# MPC.


def test_mpc_without_an_active_limit_is_lqr():
    for k in (0, 50, 100):
        position, velocity = states_about("knee-reach", k, 5, 1e-3)
        np.testing.assert_allclose(
            asked("mpc", k, position, velocity), asked("lqr", k, position, velocity), rtol=1e-9, atol=ROUNDING
        )


def test_mpc_keeps_the_limits_that_lqr_goes_beyond():
    position, velocity = states_about("knee-reach", 60, 12, 0.2)
    beyond = np.abs(asked("lqr", 60, position, velocity)[:, 0]) > 100
    assert beyond.sum() > 5
    assert np.all(np.abs(asked("mpc", 60, position, velocity)) <= 100 * (1 + 1e-6))


def test_mpc_brakes_in_time_where_lqr_does_not():
    """Far behind its reference and slow to stop: at the goal LQR still pushes, MPC already brakes."""
    heavy = {kind: run_of(kind, "knee-sprint", mass_factor=1.2, delay=1, duration_s=0.25) for kind in ("lqr", "mpc")}
    worst = {kind: float(np.degrees(np.abs(one.error_rad).max())) for kind, one in heavy.items()}
    assert worst["lqr"] > 5
    assert worst["mpc"] < worst["lqr"]
    assert heavy["mpc"].gap_m.max() < 10e-6


def test_mpc_answers_as_lqr_where_no_motion_ahead_is_predicted():
    """At these speeds Runge-Kutta steps lead beyond all numbers."""
    position, velocity = reference_of("knee-reach").position_rad[60:61], np.full((1, 1), -1e3)
    np.testing.assert_array_equal(asked("mpc", 60, position, velocity), asked("lqr", 60, position, velocity))
    assert np.any(asked("mpc", 60, position, 0.01 * velocity) != asked("lqr", 60, position, 0.01 * velocity))


@pytest.mark.filterwarnings("error")
def test_mpc_answers_as_lqr_where_slopes_along_the_motion_ahead_are_beyond_numbers():
    """Runge-Kutta steps lead beyond the loop's end, there to any number, and slopes at such numbers overflow."""
    law = tracker_of("mpc")
    position, velocity = states_about("knee-reach", 60, 12, 0.2)
    lqr, usual = asked("lqr", 60, position, velocity), asked("mpc", 60, position, velocity)
    assert np.any(usual != lqr)
    given = law.predictor.program.mx_in()
    hessian, *others = law.predictor.program.call(given)
    overflowing = replace(law.predictor, program=ca.Function("program", given, [ca.inf * hessian, *others]))
    found, _ = replace(law, predictor=overflowing).step(60, position, velocity, law.start(12))
    np.testing.assert_array_equal(found, lqr)


@needs_compiler
def test_a_compiled_prediction_gives_the_interpreted_one_s_efforts_to_the_last_bit(monkeypatch, tmp_path):
    monkeypatch.setenv("LINKPLAN_CACHE", str(tmp_path))
    law, mechanism = tracker_of("mpc", "knee-sprint", 1e-4), optimal("knee-sprint").problem.mechanism
    laws = {
        mode: replace(law, predictor=predictor(mechanism, law.kept, HORIZON_BLOCKS, 5e-3, mode))
        for mode in ("always", "never")
    }
    assert laws["always"].predictor.program.class_name() == "External"
    assert laws["never"].predictor.program.class_name() == "MXFunction"
    again = predictor(mechanism, law.kept, HORIZON_BLOCKS, 5e-3)  # found in the cache
    assert again.program.class_name() == "External"
    for k in (100, 600):
        position, velocity = states_about("knee-sprint", k // 10, 6, 0.1)
        (fast, ahead), (slow, interpreted) = (one.step(k, position, velocity, one.start(6)) for one in laws.values())
        assert np.isfinite(ahead).all(axis=1).any()  # programs were solved
        np.testing.assert_array_equal(fast, slow)
        np.testing.assert_array_equal(ahead, interpreted)


def test_mpc_follows_a_plan_with_a_switch_as_modelled():
    assert np.degrees(np.sqrt(np.mean(run_of("mpc", "knee-sprint").error_rad ** 2))) < 0.031


def test_mpc_uses_all_of_the_effort_until_the_switch_where_the_machine_lags():
    """Blocks that hold the switch commanded 33.9 N.m here; LQR asks for more than the limit."""
    reference = reference_of("knee-sprint", 1e-4)
    switch = int(np.argmax(reference.effort[:, 0] < 0)) - 1  # its own period holds the switch
    for k in range(switch - 60, switch, 5):
        position, velocity = (
            reference.position_rad[k, None] - np.radians(0.1),
            reference.velocity_rad_s[k, None] - np.radians(5),
        )
        law = tracker_of("mpc", "knee-sprint", 1e-4)
        effort, _ = law.step(k, position, velocity, law.start(1))
        assert tracker_of("lqr", "knee-sprint", 1e-4).effort(k, position[0], velocity[0]) > 100
        np.testing.assert_allclose(effort, 100, rtol=1e-6)


def test_mpc_corrects_a_vanishing_error_by_a_vanishing_effort_about_a_switch():
    law, reference = tracker_of("mpc", "knee-sprint", 1e-4), reference_of("knee-sprint", 1e-4)
    for k in range(0, reference.n, 10):
        effort, _ = law.step(k, reference.position_rad[k, None] - 1e-7, reference.velocity_rad_s[k, None], law.start(1))
        np.testing.assert_allclose(effort[0], reference.effort[k], atol=0.1)
