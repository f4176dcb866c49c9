"""The loop of the source document, whose sensors are one step old."""

import mujoco
import numpy as np
import pytest

from docs.tools.source_document import DOCUMENT_GAINS, LateSensors, document_figure, document_rows, document_runs
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import simulate_one
from linkplan.controllers.trackers.pd import pd
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion, silent
from linkplan.studies.compare.compare import compare
from linkplan.studies.output.figure import figure_of

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


@pytest.mark.hardest
def test_the_document_s_first_gains_track_on_both_models_and_only_the_printed_one_has_contacts():
    """The figures of docs/source-document.md; the corrected model's is that of `compare`."""
    plan = plan_motion(load_problem("knee-sine")).require()
    runs = document_runs(plan, DOCUMENT_GAINS[:1], silent)
    rows = {row["model"]: row for row in document_rows(runs)}
    assert {model: row["contacts"] > 0 for model, row in rows.items()} == {
        "as printed": True, "printed, in time": True, "corrected": False, "corrected, late": False,
    }  # fmt: skip
    assert all(row["stable"] for row in rows.values())
    compared = compare(plan, None, silent, ("pd",)).nominal["pd"]
    assert rows["corrected"]["rms_error_deg"] == pytest.approx(rms_deg(compared.error_rad[:, 0]), rel=1e-6)
    assert rows["as printed"]["rms_error_deg"] == pytest.approx(0.137, rel=0.01)
    panels = figure_of(document_figure(runs)).axes
    assert [panel.get_title().partition(":")[0] for panel in panels] == ["as printed", "corrected"]


def rms_deg(error_rad: np.ndarray) -> float:
    return float(np.degrees(np.sqrt(np.mean(error_rad**2))))
