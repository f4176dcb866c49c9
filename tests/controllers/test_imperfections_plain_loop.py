"""Each imperfection in MuJoCo against a plain loop of mj_step that a reader can check line by line."""

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np
import pytest

from linkplan.controllers.imperfections.imperfections import Clock, Drives, Imperfections, Machine, Push, Sensors, Start
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.rollout import ControlLoop
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.payload import Payload
from tests.support.machines import run_machines

# A rod on a hinge with a load welded to it, and a motor of 30 N.m; one simulator step per control period.
T, N = 1e-3, 120
ROD_KG, LOAD_KG, COM_M, LOAD_M, INERTIA = 1.5, 0.8, 0.2, 0.5, 0.02
LIMIT, KP, KD = 30.0, 120.0, 9.0
# Rounding of N steps.
SAME = {"rtol": 1e-9, "atol": 1e-12}


def mjcf(*, length: float = 1.0, mass: float = 1.0, shift: float = 0.0, damping: float = 0.0, friction: str = "") -> str:
    """Return the rod with its load as MuJoCo's own text, the imperfections of its bodies written in."""
    load = f"{LOAD_M * length + shift} 0 0"
    return f"""<mujoco><option timestep="{T}" gravity="0 0 -9.81"/><worldbody><body name="rod">
<joint name="J" axis="0 1 0" damping="{0.1 + damping}" {friction}/>
<inertial pos="{COM_M * length} 0 0" mass="{ROD_KG}" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
<body name="load"><inertial pos="{load}" mass="{LOAD_KG * mass}"
 diaginertia="{mass * INERTIA} {mass * INERTIA} {mass * INERTIA}"/></body></body></worldbody>
<actuator><motor name="motor" joint="J" ctrlrange="-{LIMIT} {LIMIT}"/></actuator></mujoco>"""


def machine() -> Mechanism:
    """Return the same rod as a mechanism with a payload."""
    rod = mjcf().split('<body name="load">')[0] + "</body></worldbody>" + mjcf().split("</worldbody>")[1]
    load = Payload(body="rod", mass_kg=LOAD_KG, com_m=np.array([LOAD_M, 0, 0]), inertia_kgm2=np.full(3, INERTIA))
    return load_mechanism(rod, payload=load)


MACHINE = machine()
TIME = T * np.arange(N)
WAY, RATE, FEEDFORWARD = 0.4 * (1 - np.cos(9 * TIME)), 3.6 * np.sin(9 * TIME), 12.0 * np.cos(11 * TIME) - 6.0


class Law:
    """PD with feedforward."""

    name = "law"

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return the effort at instant k."""
        return FEEDFORWARD[k] + KP * (WAY[k] - position) + KD * (RATE[k] - velocity)


def simulated(imperfect: Imperfections) -> np.ndarray:
    """Return the positions (N,) of the machine in linkplan's simulator."""
    reference = SampledReference(
        period_s=T, time_s=TIME, pose_rad=WAY[:, None], position_rad=WAY[:, None], velocity_rad_s=RATE[:, None],
        effort=FEEDFORWARD[:, None], cycle=None,
    )  # fmt: skip
    found = run_machines(MACHINE, reference, Law(), ControlLoop(effort_limit=np.array([[-LIMIT, LIMIT]])), [imperfect])
    assert found.failure == (None,)
    return found.pose[:, 0, 0]


@dataclass
class Plain:
    """What a plain loop does differently: the model, its start, what is measured, and what becomes of a command."""

    text: str = field(default_factory=mjcf)
    step_s: float = T
    start: tuple[float, float] = (0.0, 0.0)
    measured: Callable[[int, float, float], tuple[float, float]] = lambda _k, s, v: (s, v)
    driven: Callable[[int, float], float] = lambda _k, u: u
    pushed: Callable[[int, mujoco.MjData], None] = lambda _k, _data: None
    ranged: float = LIMIT

    def run(self) -> np.ndarray:
        """Return the positions (N,)."""
        model = mujoco.MjModel.from_xml_string(self.text)
        model.opt.timestep, model.actuator_ctrlrange[:] = self.step_s, (-self.ranged, self.ranged)
        data, positions = mujoco.MjData(model), np.empty(N)
        data.qpos[0], data.qvel[0] = self.start
        for k in range(N):
            positions[k] = data.qpos[0]
            s, v = self.measured(k, data.qpos[0], data.qvel[0])
            command = FEEDFORWARD[k] + KP * (WAY[k] - s) + KD * (RATE[k] - v)
            data.ctrl[0] = self.driven(k, min(max(command, -LIMIT), LIMIT))
            self.pushed(k, data)
            mujoco.mj_step(model, data)
        return positions


HOLDING = -9.81 * (ROD_KG * COM_M + LOAD_KG * LOAD_M)  # effort that holds the start, where the rod is level


def rounded(step: float, filter_hz: float | None = None):
    """Return a measurement of an encoder with a step, whose differences are the velocity."""
    before, estimate = [step * round((WAY[0] - T * RATE[0]) / step)], [RATE[0]]

    def measured(_k: int, s: float, _v: float) -> tuple[float, float]:
        read = step * round(s / step)
        pole = 0.0 if filter_hz is None else np.exp(-2 * np.pi * filter_hz * T)
        estimate[0] = pole * estimate[0] + (1 - pole) * (read - before[0]) / T
        before[0] = read
        return read, estimate[0]

    return measured


def noisy(position: float, velocity: float):
    """Return a measurement with white noise of the seed 5."""
    drawn = np.random.default_rng(np.random.SeedSequence((5,))).standard_normal((256, 2))
    return lambda k, s, v: (s + position * drawn[k, 0], v + velocity * drawn[k, 1])


def lagged(bandwidth_hz: float):
    """Return a first-order lag that begins at the holding effort; its mean over a step acts."""
    output, x = [HOLDING], 2 * np.pi * bandwidth_hz * T

    def driven(_k: int, command: float) -> float:
        mean = command + (output[0] - command) * (1 - np.exp(-x)) / x
        output[0] = command + (output[0] - command) * np.exp(-x)
        return mean

    return driven


def limited(rate: float):
    """Return a rate limit that begins at the holding effort; the mean over a step acts where it limits."""
    output = [HOLDING]

    def driven(_k: int, command: float) -> float:
        before, output[0] = output[0], min(max(command, output[0] - rate * T), output[0] + rate * T)
        return command if output[0] == command else 0.5 * (before + output[0])

    return driven


def delayed(periods: float):
    """Return a delay between one and two periods; the first command acts from the start."""
    known: list[float] = []

    def driven(_k: int, command: float) -> float:
        known.append(command)
        share = periods - 1.0
        return (1 - share) * known[max(len(known) - 2, 0)] + share * known[max(len(known) - 3, 0)]

    return driven


def push_force(k: int, data: mujoco.MjData) -> None:
    """Push the rod down with 20 N from 10 to 25.5 ms."""
    data.xfrc_applied[1, 2] = -20.0 * min(max(25.5 - k, 0.0), 1.0) * (k >= 10)


def push_effort(k: int, data: mujoco.MjData) -> None:
    """Push the joint with 4 N.m from 10 to 25.5 ms."""
    data.qfrc_applied[0] = 4.0 * min(max(25.5 - k, 0.0), 1.0) * (k >= 10)


# MuJoCo's stiffest dry friction at this timestep: a time constant of two steps, and an impedance next to one.
DRY = 'frictionloss="1.2" solreffriction="0.002 1" solimpfriction="{} {} {} {} {}"'
CASES = {
    "period_factor": (Imperfections(clock=Clock(period_factor=1.1)), lambda: Plain(step_s=1.1 * T)),
    "delay_periods": (Imperfections(clock=Clock(delay_periods=1.3)), lambda: Plain(driven=delayed(1.3))),
    "encoder_resolution": (Imperfections(sensors=Sensors(resolution=2e-3)), lambda: Plain(measured=rounded(2e-3))),
    "velocity_filter": (
        Imperfections(sensors=Sensors(resolution=1e-4, velocity_filter_hz=80.0)),
        lambda: Plain(measured=rounded(1e-4, 80.0)),
    ),
    "encoder_offset": (Imperfections(sensors=Sensors(offset=0.01)), lambda: Plain(measured=lambda _k, s, v: (s + 0.01, v))),
    "position_noise": (
        Imperfections(sensors=Sensors(noise=1e-3, noise_seed=(5,))),
        lambda: Plain(measured=noisy(1e-3, 0.0)),
    ),
    "velocity_noise": (
        Imperfections(sensors=Sensors(velocity_noise=0.1, noise_seed=(5,))),
        lambda: Plain(measured=noisy(0.0, 0.1)),
    ),
    "torque_resolution": (
        Imperfections(drives=Drives(resolution=0.5)),
        lambda: Plain(driven=lambda _k, u: 0.5 * round(u / 0.5)),
    ),
    "torque_bandwidth": (Imperfections(drives=Drives(bandwidth_hz=60.0)), lambda: Plain(driven=lagged(60.0))),
    "torque_rate": (Imperfections(drives=Drives(rate_limit=900.0)), lambda: Plain(driven=limited(900.0))),
    "torque_constant": (
        Imperfections(drives=Drives(constant_factor=1.2)),
        lambda: Plain(driven=lambda _k, u: 1.2 * u, ranged=1.2 * LIMIT),
    ),
    "viscous_friction": (Imperfections(machine=Machine(viscous=0.7)), lambda: Plain(text=mjcf(damping=0.7))),
    "payload_mass": (Imperfections(machine=Machine(mass_factor=1.3)), lambda: Plain(text=mjcf(mass=1.3))),
    "payload_com": (
        Imperfections(machine=Machine(com_shift_m=np.array([0.03, 0, 0]))),
        lambda: Plain(text=mjcf(shift=0.03)),
    ),
    "link_length": (Imperfections(machine=Machine(length_factor={"rod": 1.05})), lambda: Plain(text=mjcf(length=1.05))),
    "start_error": (Imperfections(start=Start(position_error=0.02, velocity_error=-0.3)), lambda: Plain(start=(0.02, -0.3))),
    "push_force": (
        Imperfections(pushes=(Push(start_s=0.01, duration_s=0.0155, body="rod", force=np.array([0, 0, -20.0])),)),
        lambda: Plain(pushed=push_force),
    ),
    "push_effort": (
        Imperfections(pushes=(Push(start_s=0.01, duration_s=0.0155, joint="J", effort=4.0),)),
        lambda: Plain(pushed=push_effort),
    ),
}


def test_without_imperfections_the_machine_is_the_plain_loop():
    np.testing.assert_allclose(simulated(Imperfections()), Plain().run(), **SAME)


@pytest.mark.parametrize("name", CASES)
def test_a_machine_with_one_imperfection_is_the_plain_loop_with_it(name):
    imperfect, plain = CASES[name]
    found, perfect = simulated(imperfect), Plain().run()
    assert np.abs(found - perfect).max() > 1e-5  # the effect is there
    np.testing.assert_allclose(found, plain().run(), **SAME)


def test_a_late_phase_starts_the_machine_on_the_path_between_two_samples():
    found = simulated(Imperfections(clock=Clock(phase_periods=0.25)))
    cubic = np.array([[0, 0, 0, 1], [0, 0, 1, 0], [1, 1, 1, 1], [3, 2, 1, 0]], dtype=float)
    a = np.linalg.solve(cubic, [WAY[0], T * RATE[0], WAY[1], T * RATE[1]])
    start = float(np.polyval(a, 0.25)), float(np.polyval(np.polyder(a), 0.25)) / T
    np.testing.assert_allclose(found, Plain(start=start).run(), **SAME)


def test_dry_friction_is_mujoco_s_stiffest():
    from linkplan.models.kinematics import STIFF_SOLIMP

    plain = Plain(text=mjcf(friction=DRY.format(*STIFF_SOLIMP))).run()
    found = simulated(Imperfections(machine=Machine(coulomb=1.2)))
    assert np.abs(found - Plain().run()).max() > 1e-3
    np.testing.assert_allclose(found, plain, **SAME)
