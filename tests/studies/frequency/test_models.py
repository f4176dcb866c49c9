"""Loops on models with closed forms: predictions to rounding, the simulator's steps reproduced, measurement beside both."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkplan.controllers.integrator import simulator_step
from linkplan.controllers.sampling import Sampling, augmented, sampling, simulated
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.feedback.frequency.feedback_loops import CONTINUOUS, SIMULATED, feedback_loop, operating_point
from linkplan.studies.feedback.frequency.sinestream import measure
from linkplan.studies.feedback.frequency.stability_map import pd_loop
from tests.support.oscillators import inertia_alone, mass_on_a_spring, pendulum
from tests.support.tolerances_loops import MEASURED_DB, MEASURED_DEG, SHORT_HOLD, STEPPED, WHOLE_PERIODS

# Closed forms, relative: only rounding, times the loop's condition. Measured 4e-13.
CLOSED_FORM = 1e-9
# One step of MuJoCo differenced with steps of 1e-4, relative. Measured 1e-9.
DIFFERENCED = 1e-7

KP, KD = 40.0, 3.0
MODELS = {"mass on a spring": mass_on_a_spring, "pendulum": pendulum}
FREQUENCIES = np.geomspace(0.3, 100.0, 40)
T = 1e-3


def loop_of(oscillator, kind, timing=None, kp=KP, kd=KD):
    """Return the PD loop about the oscillator's operating point, gains in its joint's units."""
    mechanism = load_mechanism(oscillator.mjcf)
    point = operating_point(mechanism, np.array([oscillator.position]))
    gear = mechanism.actuators[0].gear
    gain = np.array([[kp, kd]]) / gear
    return feedback_loop(point, gain, Sampling(period_s=T) if timing is None else timing, kind), gear


def closed_forms(oscillator, kind, f):
    """Return position and velocity responses of the joint's effort."""
    if kind == CONTINUOUS:
        return oscillator.plant(f), 2j * np.pi * f * oscillator.plant(f)
    return oscillator.stepped(f, T)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("kind", [CONTINUOUS, SIMULATED])
def test_predicted_responses_are_the_closed_forms(model, kind):
    oscillator = MODELS[model]()
    loop, gear = loop_of(oscillator, kind)
    position, velocity = closed_forms(oscillator, kind, FREQUENCIES)
    L = KP * position + KD * velocity
    w = 2j * np.pi * FREQUENCIES
    expected = {
        "plant": gear * position,
        "loop": L,
        "sensitivity": 1 / (1 + L),
        "complementary": L / (1 + L),
        "control": (KP + KD * w) / gear / (1 + L),
        "reference": position * (KP + KD * w) / (1 + L),
    }
    for name, value in expected.items():
        assert np.abs(loop.gains(name, FREQUENCIES) / value - 1).max() < CLOSED_FORM, name


@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    mass=st.floats(0.1, 5.0),
    ratio=st.floats(0.02, 0.9),
    natural_hz=st.floats(0.2, 20.0),
    kp=st.floats(0.0, 500.0),
    kd=st.floats(0.01, 20.0),
)
def test_any_oscillators_sampled_loop_is_its_closed_form(mass, ratio, natural_hz, kp, kd):
    w = 2 * np.pi * natural_hz
    made = mass_on_a_spring(gear=1.0, mass=mass, damping=2 * ratio * mass * w, stiffness=mass * w**2)
    made = replace(made, position=0.0)  # at rest, where no spring is too stiff to be held
    loop, _ = loop_of(made, SIMULATED, kp=kp, kd=kd)
    position, velocity = closed_forms(made, SIMULATED, FREQUENCIES)
    expected = kp * position + kd * velocity
    assert np.abs(loop.gains("loop", FREQUENCIES) / expected - 1).max() < CLOSED_FORM


@pytest.mark.parametrize("model", MODELS)
def test_feedforward_makes_the_continuous_loop_follow_exactly_and_leads_a_sampled_one_by_half_a_period(model):
    oscillator = MODELS[model]()
    loop, _ = loop_of(oscillator, CONTINUOUS)
    assert np.abs(loop.gains("reference+ff", FREQUENCIES) - 1).max() < CLOSED_FORM
    sampled, _ = loop_of(oscillator, SIMULATED)
    position, velocity = oscillator.stepped(FREQUENCIES, T)
    w = 2j * np.pi * FREQUENCIES
    need = oscillator.stiffness + oscillator.mass * w**2 + oscillator.damping * w
    expected = position * (KP + KD * w + need * np.exp(w * T / 2)) / (1 + KP * position + KD * velocity)
    assert np.abs(sampled.gains("reference+ff", FREQUENCIES) / expected - 1).max() < CLOSED_FORM


@pytest.mark.parametrize("delay", [1, 2])
def test_a_whole_delay_turns_the_sampled_loop_by_its_own_phase(delay):
    oscillator = mass_on_a_spring()
    late, _ = loop_of(oscillator, SIMULATED, sampling(load_mechanism(oscillator.mjcf), T, delay))
    prompt, _ = loop_of(oscillator, SIMULATED)
    turn = np.exp(-2j * np.pi * FREQUENCIES * T * delay)
    assert np.abs(late.gains("loop", FREQUENCIES) / (prompt.gains("loop", FREQUENCIES) * turn) - 1).max() < CLOSED_FORM


def test_a_broken_delay_turns_the_loop_by_its_own_phase_where_the_hold_is_short():
    oscillator = mass_on_a_spring()
    late, _ = loop_of(oscillator, SIMULATED, sampling(load_mechanism(oscillator.mjcf), T, 2.5))
    prompt, _ = loop_of(oscillator, SIMULATED, Sampling(period_s=T, substeps=2))
    slow = np.geomspace(0.3, 5.0, 9)
    turned = np.unwrap(np.angle(late.gains("loop", slow) / prompt.gains("loop", slow)))
    assert turned == pytest.approx(-2 * np.pi * slow * 2.5 * T, rel=SHORT_HOLD)


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast", "discrete", "RK4"])
@pytest.mark.parametrize("model", MODELS)
def test_one_step_of_every_integrator_is_reproduced(model, integrator):
    oscillator = MODELS[model](integrator)
    mechanism = load_mechanism(oscillator.mjcf)
    point = operating_point(mechanism, np.array([oscillator.position]))
    A, B = simulator_step(mechanism, point.pose[None], point.velocity[None], point.hold[None], T)

    def step(x, u):
        data = mujoco.MjData(mechanism.model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = x[0], x[1], u / mechanism.actuators[0].gain
        mujoco.mj_step(mechanism.model, data)
        return np.array([data.qpos[0], data.qvel[0]])

    e, x, u = 1e-4, point.state, point.hold[0]
    columns = [(step(x + e * d, u) - step(x - e * d, u)) / (2 * e) for d in np.eye(2)]
    assert np.abs(A[0] - np.stack(columns, axis=1)).max() < DIFFERENCED
    by_effort = (step(x, u + e) - step(x, u - e)) / (2 * e)
    assert np.abs(B[0, :, 0] - by_effort).max() < DIFFERENCED * np.abs(by_effort).max()


def test_a_period_of_several_steps_with_a_late_command_is_what_mujoco_does():
    oscillator = pendulum()
    mechanism = load_mechanism(oscillator.mjcf)
    point = operating_point(mechanism, np.array([oscillator.position]))
    timing = Sampling(period_s=5 * T, substeps=5, delay_steps=12)
    matrices = simulated(mechanism, point.pose[None], point.velocity[None], point.hold[None], timing)
    A, B = augmented(*(matrix[0] for matrix in matrices), timing)
    rng = np.random.default_rng(3)
    commands = 1e-4 * rng.normal(size=30)
    state = np.zeros(len(A))
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = point.pose
    for k in range(30):
        state = A @ state + B[:, 0] * commands[k]
        for step in range(5):
            at = 5 * k + step - 12
            data.ctrl[0] = point.hold[0] + (commands[at // 5] if at >= 0 else 0.0)
            mujoco.mj_step(mechanism.model, data)
        off = np.array([data.qpos[0] - point.pose[0], data.qvel[0]])
        assert np.abs(off - state[:2]).max() < STEPPED * max(np.abs(state[:2]).max(), 1e-5)
    assert np.abs(state[:2]).max() > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("delay", [0, 1.5])
def test_measured_responses_are_the_sampled_prediction(model, delay):
    oscillator = MODELS[model]()
    mechanism = load_mechanism(oscillator.mjcf)
    loop, _ = loop_of(oscillator, SIMULATED, sampling(mechanism, T, delay))
    asked = np.geomspace(1.0, 100.0, 7)
    taken = measure([loop], asked, mechanism.effort_limit)
    for name, response in taken.responses[0].items():
        db, deg = response.against(loop.response(name, response.frequency_hz))
        assert np.abs(db).max() < MEASURED_DB, name
        assert np.abs(deg).max() < MEASURED_DEG, name
        assert response.coherence.min() > 0.999
        assert response.saturated.max() == 0
    # A tenth of the sampling rate is reached, and a prediction without the simulator's steps would not do there.
    other, _ = loop_of(oscillator, CONTINUOUS)
    measured = taken.responses[0]["loop"]
    assert measured.frequency_hz[-1] == pytest.approx(0.1 / T, rel=WHOLE_PERIODS)
    assert np.abs(measured.against(other.response("loop", measured.frequency_hz))[1]).max() > 5


@pytest.mark.slow
def test_a_measurement_of_long_control_periods_says_how_far_it_is():
    mechanism, said = load_mechanism(inertia_alone().replace('timestep="1e-3"', 'timestep="1e-4"')), []
    loop = pd_loop(operating_point(mechanism, np.zeros(1)), 5.0, 0.5, sampling(mechanism, 0.05))
    taken = measure([loop], np.array([0.5, 1.0]), mechanism.effort_limit, say=said.append)
    assert 1 < len(said) <= 2 + taken.simulated_steps // 1_000_000
