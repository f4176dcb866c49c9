"""One step of MuJoCo's integrators about rest, with what acts by tendons and servos: the map is the simulator's own."""

import copy

import numpy as np
import pytest

from linkplan.controllers.feedback_loop import states_of
from linkplan.controllers.imperfections.driving import driving
from linkplan.controllers.imperfections.imperfections import Drives
from linkplan.controllers.imperfections.plant import ImperfectPlant, prepare
from linkplan.controllers.integrator import simulator_step
from linkplan.controllers.mujoco_plant import MujocoStepper
from linkplan.models.mechanism import load_mechanism

STEP_S, SMALL = 4e-3, 1e-6
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
        f'<mujoco><option timestep="{STEP_S}" integrator="{integrator}" solver="{solver}"><flag contact="disable"/></option>'
        f"<worldbody>{bodies}</worldbody><tendon><fixed name='t' {tendon}><joint joint='a' coef='1'/><joint joint='b'"
        f" coef='0.6'/></fixed></tendon><actuator>{actuators}</actuator></mujoco>"
    )


def differences(mechanism, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the slopes (4, 6) of MuJoCo's step about a state (q, v) under efforts u, by state and effort."""

    model = copy.copy(mechanism.model)
    prepare(model, mechanism, STEP_S, UNLIMITED)

    def stepped(x: np.ndarray) -> np.ndarray:
        start = ImperfectPlant(model=model, pose=x[:2], rates=x[2:4])
        stepper = MujocoStepper(mechanism, [start], driving([Drives()], [0.0], [STEP_S], 1, UNLIMITED), 1)
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
    A, B = simulator_step(mechanism, q[None], v[None], u[None], STEP_S)
    exact = differences(mechanism, q, v, u)
    both = np.hstack([A[0], B[0]])
    for rows in (slice(0, 2), slice(2, 4)):
        of = np.abs(exact - np.eye(4, 6))[rows].max()
        assert np.abs(both - exact)[rows].max() < AGREES * of
