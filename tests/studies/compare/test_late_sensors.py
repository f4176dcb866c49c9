"""The loop of the source document, whose sensors are one step old."""

import mujoco
import numpy as np

from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import simulate_one
from linkplan.controllers.trackers.pd import pd
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.compare.document import LateSensors

T, INERTIA = 1e-3, 2e-3
ROTOR = f"""<mujoco><option gravity="0 0 0" timestep="{T}"/><worldbody><body><joint name="J" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-50 50"/></actuator>
<sensor><jointpos joint="J"/><jointvel joint="J"/></sensor></mujoco>"""


def logged(kd: float, *, late: bool) -> np.ndarray:
    """Return the angles (n,) [rad] of a step of 0.1 rad, by linkplan."""
    mechanism, n = load_mechanism(ROTOR), 400
    still = np.zeros((n, 1))
    reference = SampledReference(
        period_s=T,
        time_s=T * np.arange(n),
        pose_rad=still,
        position_rad=still,
        velocity_rad_s=still,
        effort=still,
        cycle=None,
    )
    law = pd(mechanism, reference, 20.0, kd)
    aim = SampledReference(
        period_s=T,
        time_s=T * np.arange(n),
        pose_rad=still,
        position_rad=still + 0.1,
        velocity_rad_s=still,
        effort=still,
        cycle=None,
    )
    law = type(law)(reference=aim, gains=law.gains, name="pd")
    plant = MujocoPlant(mechanism=mechanism, loop=ControlLoop(effort_limit=np.array([[-50.0, 50.0]])))
    return simulate_one(plant, LateSensors(law) if late else law, reference).position_rad[:, 0]


def test_a_late_loop_is_that_of_a_script_that_reads_the_sensors_before_its_step():
    model = mujoco.MjModel.from_xml_string(ROTOR)
    data, angles = mujoco.MjData(model), []
    for _ in range(400):
        angles.append(float(data.qpos[0]))
        data.ctrl[0] = 20.0 * (0.1 - data.sensordata[0]) - 1.0 * data.sensordata[1]
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(logged(1.0, late=True), angles, atol=1e-9)


def test_the_largest_damping_of_a_late_loop_is_about_half_as_large():
    """2 J / T is 4 N.m.s/rad, J / T is 2."""
    swings = {(kd, late): np.ptp(logged(kd, late=late)[-50:]) for kd in (1.5, 3.0, 5.0) for late in (False, True)}
    assert [swings[kd, False] < 0.01 for kd in (1.5, 3.0, 5.0)] == [True, True, False]
    assert [swings[kd, True] < 0.01 for kd in (1.5, 3.0, 5.0)] == [True, False, False]
