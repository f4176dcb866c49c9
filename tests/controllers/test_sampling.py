"""Control periods, delays and sampled states; the map of a simulator step against MuJoCo's own step."""

import copy

import numpy as np
import pytest

from linkplan.controllers.feedback_loop import states_of
from linkplan.controllers.imperfections.driving import driving
from linkplan.controllers.imperfections.imperfections import Drives
from linkplan.controllers.imperfections.plant import ImperfectPlant, prepare
from linkplan.controllers.integrator import simulator_step
from linkplan.controllers.mujoco_plant import MujocoStepper
from linkplan.controllers.sampling import Sampling, augmented, closed, sampling, simulated, spectral_radius
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism, load_mechanism
from tests.support.bodies import HINGE, HINGE_INERTIA

STEP_S = 0.002  # of the hinge's model
# A system of two states and one input; `EARLY` and `LATE` are the effects of the new and the previous command.
A = np.array([[1.0, 0.1], [-0.2, 0.9]])
EARLY, LATE = np.array([[0.3], [1.0]]), np.array([[0.05], [0.7]])


def hinge() -> Mechanism:
    return load_mechanism(HINGE)


@pytest.mark.parametrize(
    ("period_steps", "delay", "substeps", "delay_steps"),
    [
        (1, 0.0, 1, 0),
        (1, 1.0, 1, 1),
        (2.5, 0.0, 3, 0),
        (2.5, 0.5, 4, 2),
        (3, 0.3, 10, 3),
        (5, 1.2, 5, 6),
        (0.1, 0.05, 20, 1),
    ],
)
def test_a_period_has_the_fewest_steps_that_the_model_and_the_delay_allow(period_steps, delay, substeps, delay_steps):
    found = sampling(hinge(), period_steps * STEP_S, delay)
    assert (found.substeps, found.delay_steps) == (substeps, delay_steps)
    assert found.timestep_s <= STEP_S * (1 + 1e-9)
    assert found.delay_s == pytest.approx(delay * found.period_s)


def test_a_delay_is_whole_periods_and_steps_of_the_next():
    found = Sampling(period_s=0.01, substeps=4, delay_steps=11)
    assert (found.whole, found.late, found.memory) == (2, 3, 3)
    assert Sampling(period_s=0.01, substeps=4, delay_steps=8).memory == 2
    assert found.delay_s == pytest.approx(0.0275)
    assert found.nyquist_hz == pytest.approx(50.0)


@pytest.mark.parametrize(("beyond", "accepted"), [(3e-7, True), (3e-6, False), (0.0246, False)])
def test_a_delay_between_two_steps_is_refused_unless_by_rounding(beyond, accepted):
    for sign in (1, -1):
        delay = 0.5 + 0.5 * sign * beyond
        if accepted:
            assert sampling(hinge(), STEP_S, delay).delay_steps == 1
        else:
            with pytest.raises(LinkplanError, match="not a whole number of simulator steps"):
                sampling(hinge(), STEP_S, delay)


def test_a_period_of_a_hundred_thousand_steps_is_the_longest():
    assert sampling(hinge(), 1e5 * STEP_S).substeps == 100_000
    with pytest.raises(LinkplanError, match="at most 100000 are run"):
        sampling(hinge(), 1.01e5 * STEP_S)


@pytest.mark.parametrize("delay_steps", [0, 1, 2, 3, 4, 7])
def test_the_state_with_past_commands_moves_as_the_delayed_commands_say(delay_steps):
    timing = Sampling(period_s=1.0, substeps=2, delay_steps=delay_steps)
    late = LATE if timing.late else 0 * LATE
    command = np.random.default_rng(0).normal(size=20)
    whole, memory = delay_steps // 2, timing.memory
    wide_A, wide_B = augmented(A, EARLY, late, timing)
    x, wide = np.zeros(2), np.zeros(2 + memory)
    for k, u in enumerate(command):
        acting = [command[i] if i >= 0 else 0.0 for i in (k - whole, k - whole - 1)]
        x = A @ x + EARLY[:, 0] * acting[0] + late[:, 0] * acting[1]
        wide = wide_A @ wide + wide_B[:, 0] * u
        assert wide[:2] == pytest.approx(x, abs=1e-12)
        assert wide[2:] == pytest.approx([command[k - i] if k >= i else 0.0 for i in range(memory)], abs=1e-12)


def test_a_command_that_comes_late_moves_an_inertia_by_both_commands_shares():
    """J s'' = u over a period T, u the old command until c and then the new one: v = (c u_old + (T - c) u_new) / J."""
    timing = Sampling(period_s=0.01, substeps=4, delay_steps=1)
    T, c, J = 0.01, 0.0025, HINGE_INERTIA
    state = np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1))
    motion, new, old = (of_all[0] for of_all in simulated(hinge(), *state, timing))
    assert motion == pytest.approx(np.array([[1.0, T], [0.0, 1.0]]))
    assert new[1, 0] == pytest.approx((T - c) / J)
    assert old[1, 0] == pytest.approx(c / J)


def test_a_closed_loop_feeds_back_the_measured_state_only():
    timing = Sampling(period_s=1.0, delay_steps=1)
    wide_A, wide_B = augmented(A, EARLY, 0 * EARLY, timing)
    gain = np.array([[0.4, 0.2]])
    loop = closed(wide_A, wide_B, gain)
    state = np.array([1.0, -2.0, 0.5])
    assert loop @ state == pytest.approx([*(A @ state[:2] + EARLY[:, 0] * 0.5), -(gain @ state[:2])[0]])


def test_a_spectral_radius_is_the_largest_size_of_an_eigenvalue():
    assert spectral_radius(np.array([np.diag([0.5, -0.9]), [[0.0, -4.0], [1.0, 0.0]]])) == pytest.approx([0.9, 2.0])


SIMULATOR_STEP_S, SMALL = 4e-3, 1e-6
UNLIMITED = np.tile([-np.inf, np.inf], (2, 1))
# Central differences of a step, relative to its largest entry; terms left out are off by 3e-2 to 0.3.
AGREES = 1e-4
CHAIN = """<body><joint name="a" axis="0 1 0" armature="0.01"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
<body pos="0.3 0 0"><joint name="b" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/></body></body>"""
APART = CHAIN.replace('<body pos="0.3 0 0">', '</body><body pos="0 1 0">').replace("</body></body>", "</body>")
MOTORS = '<motor name="ma" joint="a"/><motor name="mb" joint="b"/>'
GAS = 'gainprm="0" biastype="affine" biasprm="0.3 -20 -1"'
ACTING = {
    "a tendon's damper": (CHAIN, 'damping="0.5"', MOTORS),
    "a tendon's damper across branches": (APART, 'damping="0.5"', MOTORS),
    "a tendon's spring": (CHAIN, 'stiffness="20"', MOTORS),
    "a tendon's spring, pulled": (CHAIN, 'stiffness="20 100 500" springlength="-0.1 0.02"', MOTORS),
    "a tendon's spring, pushed": (CHAIN, 'stiffness="20 100 500" springlength="0.1 0.2"', MOTORS),
    "a tendon's spring, slack": (CHAIN, 'stiffness="20 100 500" springlength="0 0.2"', MOTORS),
    "a joint's spring": (CHAIN.replace('name="b"', 'name="b" stiffness="20" springref="10"'), "", MOTORS),
    "a tendon's motor with damping": (CHAIN, "", '<motor tendon="t" damping="0.3" gear="2"/><motor joint="b"/>'),
    "a servo": (CHAIN, "", '<position joint="a" kp="20" kv="1"/><motor joint="b"/>'),
    "a gas spring": (CHAIN, "", MOTORS + f'<general joint="a" {GAS}/>'),
    "a gas spring on a tendon": (CHAIN, "", MOTORS + f'<general tendon="t" gear="2" {GAS}/>'),
    "a servo on a tendon": (CHAIN, "", '<position tendon="t" kp="20" kv="1"/><motor joint="b"/>'),
}


def loaded(what: str, integrator: str, solver: str = "Newton"):
    bodies, tendon, actuators = ACTING[what]
    return load_mechanism(
        f'<mujoco><option timestep="{SIMULATOR_STEP_S}" integrator="{integrator}" solver="{solver}">'
        '<flag contact="disable"/></option>'
        f"<worldbody>{bodies}</worldbody><tendon><fixed name='t' {tendon}><joint joint='a' coef='1'/><joint joint='b'"
        f" coef='0.6'/></fixed></tendon><actuator>{actuators}</actuator></mujoco>"
    )


def differences(mechanism, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the slopes (4, 6) of MuJoCo's step about a state (q, v) under efforts u, by state and effort."""

    model = copy.copy(mechanism.model)
    prepare(model, mechanism, SIMULATOR_STEP_S, UNLIMITED)

    def stepped(x: np.ndarray) -> np.ndarray:
        start = ImperfectPlant(model=model, pose=x[:2], rates=x[2:4])
        stepper = MujocoStepper(mechanism, [start], driving([Drives()], [0.0], [SIMULATOR_STEP_S], 1, UNLIMITED), 1)
        stepper.hold(x[4:][None], np.empty((1, 2)), np.empty((1, 2)))
        return np.concatenate(states_of(stepper), axis=1)[0]

    at = np.concatenate([q, v, u])
    return np.array([(stepped(at + e) - stepped(at - e)) / (2 * SMALL) for e in SMALL * np.eye(6)]).T


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast", "RK4", "discrete"])
@pytest.mark.parametrize("what", ACTING)
def test_the_map_of_a_step_is_the_simulator_s(what, integrator):
    assert_maps_agree(loaded(what, integrator))


def test_under_the_dual_solver_the_discrete_step_leaves_tendons_and_servos_out():
    for what in ("a tendon's damper", "a servo", "a gas spring"):
        assert_maps_agree(loaded(what, "discrete", solver="PGS"))


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
def test_the_map_of_a_step_at_steady_speed_is_the_simulator_s(integrator):
    """Coriolis terms are in the inertia of a step of "implicit" alone."""
    assert_maps_agree(loaded("a tendon's damper", integrator), speed=4.0)


def assert_maps_agree(mechanism, speed: float = 0.0) -> None:
    q, v, still = np.array([0.3, -0.4]), speed * np.array([1.0, -0.7]), np.zeros(2)
    arms = np.array(mechanism.dynamics.effort_map(q))
    u = np.linalg.solve(arms, np.array(mechanism.dynamics.inverse_dynamics(q, v, still)).ravel())
    A, B = simulator_step(mechanism, q[None], v[None], u[None], SIMULATOR_STEP_S)
    exact = differences(mechanism, q, v, u)
    both = np.hstack([A[0], B[0]])
    for rows in (slice(0, 2), slice(2, 4)):
        of = np.abs(exact - np.eye(4, 6))[rows].max()
        assert np.abs(both - exact)[rows].max() < AGREES * of
