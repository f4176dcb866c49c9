"""The serial equivalent in `transfer`: its file, its errors along a plan and along samples, refusals."""

import json

import mujoco
import numpy as np
import pytest
import scipy.interpolate

import linkplan
from linkplan.models.errors import LinkplanError
from linkplan.models.transfer.rest import OutputMotion
from linkplan.studies.cli.main import main
from linkplan.studies.handover.transfer.serial_study import motion_of_plan
from tests.support import parallel_ankle
from tests.support.plans import optimal

ANKLE = ["ankle_pitch", "ankle_roll"]


@pytest.fixture(scope="module")
def ankle():
    return linkplan.transfer(linkplan.load_mechanism(parallel_ankle.ankle_text()), ANKLE, tolerance=0.02)


@pytest.fixture(scope="module")
def knee():
    plan = optimal("knee-reach")
    return linkplan.transfer(plan.problem, ["C"], tolerance=0.01, along=plan)


def test_the_serial_equivalent_is_a_model_without_loops_with_the_outputs(ankle):
    model = mujoco.MjModel.from_xml_string(ankle.serial_mjcf)
    assert (model.neq, model.nu, [model.joint(j).name for j in range(model.njnt)]) == (0, 2, ANKLE)
    record = ankle.to_dict()["serial"]
    assert record["welded"][0] == "motor_left"
    assert record["errors"] is None
    np.testing.assert_allclose(model.dof_armature, record["armature"], rtol=1e-5)


def test_errors_along_samples_shrink_from_the_static_map_to_the_table(ankle):
    time = np.linspace(0, 1, 400)
    path = np.column_stack([0.3 * np.sin(6 * time), 0.2 * np.cos(5 * time)])
    errors = ankle.errors_along(time, path)
    rms = {name: np.sqrt(np.mean(off**2, axis=0)) for name, off in errors.items()}
    assert rms["static map"][0] > 2 * rms["serial equivalent"][0]  # of roll, dry friction of both motors cancels in part
    assert np.all(rms["serial equivalent"] > 5 * rms["serial with table"])


def test_the_rest_is_what_the_errors_with_and_without_the_table_differ_by(ankle):
    time = np.linspace(0, 1, 200)
    path = np.column_stack([0.3 * np.sin(6 * time), 0.2 * np.cos(5 * time)])
    errors = ankle.errors_along(time, path)
    spline = scipy.interpolate.make_interp_spline(time, path, k=5)
    rest = ankle.rest_effort(path, spline.derivative(1)(time), spline.derivative(2)(time))
    np.testing.assert_allclose(errors["serial equivalent"] - rest, errors["serial with table"], atol=1e-12)
    with pytest.raises(LinkplanError, match=r"are \(n, 2\)"):
        ankle.rest_effort(path, path, path[:, :1])


def test_a_plan_s_motion_of_the_output_has_the_slopes_of_its_positions(knee):
    motion = motion_of_plan(optimal("knee-reach"), knee.found.outputs)
    assert isinstance(motion, OutputMotion)
    inside = slice(20, -20)
    velocity = np.gradient(motion.position[:, 0], motion.time_s)
    assert np.abs(velocity - motion.velocity[:, 0])[inside].max() < 1e-2 * np.abs(velocity).max()
    slope = np.gradient(motion.velocity[:, 0], motion.time_s)
    assert np.median(np.abs(slope - motion.acceleration[:, 0])[inside]) < 1e-2 * np.abs(slope).max()


def test_the_effort_needed_along_a_plan_is_the_plan_s_effort_carried_across(knee):
    plan = optimal("knee-reach")
    motion = knee.found.serial.errors
    u = np.array([plan.trajectory.effort_at(np.array([t]))[0, 0] for t in motion.motion.time_s])
    q = np.degrees(motion.motion.position[:, 0])
    (G,) = np.array([knee.found.table.grid.at("ratio", motion.motion.position)[:, 0, 0]])
    assert np.ptp(q) > 30
    off = np.abs(motion.effort[:, 0] - G * u)
    assert np.median(off) < 1e-2 * np.abs(motion.effort).max()  # the table's interpolation; efforts jump at switches


@pytest.mark.slow
def test_the_command_states_the_errors_along_a_plan(saved_reach, tmp_path, capsys):
    words = ["transfer", "knee-reach", "--joints", "C", "--tolerance", "0.02", "--along", str(saved_reach), "--json"]
    assert main([*words, "-o", str(tmp_path / "out")]) == 0
    errors = json.loads(capsys.readouterr().out)["serial"]["errors"]
    assert 0 < errors["serial with table"]["max"]["C"] < 0.05 * errors["static map"]["max"]["C"]
    assert errors["largest_effort"]["C"] > 100
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"serial.xml", "along.csv"} <= names


def test_a_plan_of_another_payload_is_refused(saved_reach, capsys):
    assert main(["transfer", "optimus-knee", "--joints", "C", "--along", str(saved_reach)]) == 2
    assert "has another model or payload than the table" in capsys.readouterr().err.strip().splitlines()[-1]


def test_a_linkage_without_a_serial_equivalent_says_why():
    found = linkplan.transfer("five-bar", ["O1", "P"], tolerance=0.5, range_deg={"O1": [-110, -70], "P": [35, 60]})
    with pytest.raises(LinkplanError, match="joint P moves on a part of the linkage"):
        assert found.serial_mjcf
    assert found.to_dict()["serial"] is None


@pytest.mark.parametrize(
    ("time", "path", "said"),
    [
        (np.linspace(0, 1, 20), np.full((20, 2), 3.0), "the table goes"),
        (np.linspace(0, 1, 5), np.zeros((5, 2)), "n at least 10"),
        (np.zeros(20), np.zeros((20, 2)), "times increase"),
        (np.linspace(0, 1, 20), np.zeros((20, 3)), r"positions \(n, 2\)"),
    ],
)
def test_a_motion_that_cannot_be_followed_is_refused(ankle, time, path, said):
    with pytest.raises(LinkplanError, match=said):
        ankle.errors_along(time, path)
