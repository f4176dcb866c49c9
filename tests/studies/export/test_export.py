"""Exports of plans, read back by the programs that they are for."""

import io
import itertools
import json

import mujoco
import numpy as np
import pyarrow.parquet
import pytest
import scipy.io
import yaml

from linkplan.models.errors import ProblemError
from linkplan.models.library import built_in_text, compile_model
from linkplan.models.payload import BUILT_IN as PAYLOADS
from linkplan.planner.plan.plan import Plan
from linkplan.studies.handover.export.export import exported
from linkplan.studies.handover.export.formats import FORMATS
from linkplan.studies.handover.export.samples import exported_samples
from tests.support.plans import optimal

# What MuJoCo's own soft loops and steps make of a planned motion that is replayed without feedback [deg].
REPLAYED_DEG = 0.05
STEP_S = 1e-5


@pytest.fixture(scope="module")
def plan() -> Plan:
    return optimal("knee-reach")


def with_keyframes(plan: Plan) -> mujoco.MjModel:
    """Return the knee's own model, the exported file included in it."""
    text = built_in_text("optimus-knee").replace("</mujoco>", '<include file="keys.xml"/></mujoco>')
    return mujoco.MjModel.from_xml_string(text, {"keys.xml": exported(plan, "keyframes")})


def replayed(model: mujoco.MjModel, time: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> np.ndarray:
    """Return qpos (n, nq) of MuJoCo at times (n,), driven by ctrl (n, nu) between them and by nothing else."""
    model.opt.timestep = STEP_S
    model.eq_solref[:] = 2 * STEP_S, 1.0
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos[0], qvel[0]
    found = [np.array(data.qpos)]
    for end in time[1:]:
        while data.time < end - STEP_S / 2:
            for j in range(model.nu):
                data.ctrl[j] = np.interp(data.time + STEP_S / 2, time, ctrl[:, j])
            mujoco.mj_step(model, data)
        found.append(np.array(data.qpos))
    return np.array(found)


def test_keyframes_are_the_plan_s_poses_speeds_and_controls(plan):
    model, samples = with_keyframes(plan), exported_samples(plan)
    keys = slice(model.nkey - len(samples.time_s), None)  # the model has one of its own
    np.testing.assert_array_equal(model.key_time[keys], samples.time_s)
    np.testing.assert_array_equal(model.key_qpos[keys], samples.qpos())
    np.testing.assert_array_equal(model.key_qvel[keys], samples.qvel())
    data = mujoco.MjData(model)
    for k in (0, 57, len(samples.time_s) - 1):
        mujoco.mj_resetDataKeyframe(model, data, model.nkey - len(samples.time_s) + k)
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.actuator_force, samples.effort[k], rtol=1e-12)


@pytest.mark.slow
def test_keyframes_replayed_in_mujoco_give_the_same_motion(plan):
    model = mujoco.MjModel.from_xml_string(exported(plan, "mjcf").decode())
    keys = np.flatnonzero(model.key_time > 0)[0] - 1 + np.arange(len(exported_samples(plan).time_s))
    arrays = (model.key_time[keys], model.key_qpos[keys], model.key_qvel[keys], model.key_ctrl[keys])
    assert np.ptp(np.degrees(arrays[1]), axis=0).min() > 10  # it moves
    off = np.degrees(replayed(model, *arrays) - arrays[1])
    assert np.abs(off).max() < REPLAYED_DEG


@pytest.mark.slow
def test_the_table_replayed_in_mujoco_gives_the_same_motion(plan):
    table = np.genfromtxt(io.BytesIO(exported(plan, "csv")), delimiter=",", names=True, deletechars="")
    _, model, _ = compile_model("optimus-knee", PAYLOADS["shank"])
    joints = [model.joint(j).name for j in range(model.njnt)]
    samples = exported_samples(plan)
    q, rates = (np.radians(np.column_stack([table[f"{j}_{unit}"] for j in joints])) for unit in ("deg", "deg_s"))
    np.testing.assert_allclose(q, samples.qpos(), atol=1e-10)
    found = replayed(model, table["time_s"], q, rates, table["act_O_Nm"][:, None])
    assert np.degrees(np.abs(found - q)).max() < REPLAYED_DEG


def test_the_whole_model_has_the_payload_and_moves_as_planned(plan):
    model = mujoco.MjModel.from_xml_string(exported(plan, "mjcf").decode())
    mechanism = plan.problem.mechanism
    assert model.body_mass.sum() == pytest.approx(mechanism.model.body_mass.sum(), rel=1e-6)
    assert model.body_mass.sum() > 4.0
    np.testing.assert_allclose(model.eq_solref, mechanism.model.eq_solref)


def test_ros_reads_radians_rates_and_the_effort_on_the_joint(plan):
    said, samples = yaml.safe_load(exported(plan, "ros")), exported_samples(plan)
    assert said["joint_names"] == ["O"]
    assert set(said) == {"header", "joint_names", "points"}
    points = said["points"]
    assert len(points) == len(samples.time_s)
    time = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
    assert all(a < b for a, b in itertools.pairwise(time))
    np.testing.assert_allclose(time, samples.time_s, atol=1e-9)
    for key, values in (("positions", samples.position), ("velocities", samples.velocity)):
        np.testing.assert_array_equal([p[key] for p in points], values)
    np.testing.assert_array_equal([p["accelerations"] for p in points], samples.acceleration)
    np.testing.assert_allclose([p["effort"] for p in points], samples.effort)  # the motor sits on the joint


def test_ros_effort_of_a_linear_drive_is_its_force_on_the_coordinate():
    plan = optimal("knee-linear-reach")
    said, samples = yaml.safe_load(exported(plan, "ros")), exported_samples(plan)
    (name,) = said["joint_names"]
    assert name == plan.problem.mechanism.independent_joints[0].name
    effort = np.array([point["effort"] for point in said["points"]])
    matrices = [np.array(plan.problem.mechanism.dynamics.effort_matrix(q)) for q in samples.q]  # B (n_q, n_u)
    speeds = [B.T @ rates for B, rates in zip(matrices, samples.rates, strict=True)]
    power = np.sum(np.array(speeds) * samples.effort, axis=1)
    assert np.abs(power).max() > 1
    np.testing.assert_allclose(np.sum(effort * samples.velocity, axis=1), power, rtol=1e-8, atol=1e-8)


def test_ros_on_another_joint_has_its_motion_and_the_power_of_the_motor(plan):
    said, samples = yaml.safe_load(exported(plan, "ros", joints=["C"])), exported_samples(plan)
    assert said["joint_names"] == ["C"]
    found = {
        key: np.array([p[key] for p in said["points"]])[:, 0]
        for key in ("positions", "velocities", "accelerations", "effort")
    }
    c = plan.problem.mechanism.joint_index("C")
    np.testing.assert_array_equal(found["positions"], samples.q[:, c])
    power = samples.effort[:, 0] * samples.velocity[:, 0]  # the motor sits on O
    assert np.abs(power).max() > 100
    assert np.abs(found["effort"] * found["velocities"] - power).max() < 1e-12 * np.abs(power).max()
    inside = slice(10, -10)
    slope = np.gradient(found["velocities"], samples.time_s)[inside]
    assert np.median(np.abs(slope - found["accelerations"][inside])) < 1e-2 * np.abs(slope).max()


@pytest.mark.parametrize(
    ("to", "joints", "said"),
    [("ros", ["O", "C"], "joints must be 1"), ("csv", ["C"], "the format ros only"), ("ros", ["Q"], "'Q'")],
)
def test_output_joints_that_cannot_be_are_refused(plan, to, joints, said):
    with pytest.raises(ProblemError, match=said):
        exported(plan, to, joints=joints)


def test_matlab_has_each_quantity_and_its_unit_in_structs_of_one_shape(plan):
    said = scipy.io.loadmat(io.BytesIO(exported(plan, "mat")), simplify_cells=True)
    table = exported_samples(plan).table
    np.testing.assert_array_equal(said["time_s"], table.time_s)
    for group, values in (("position", table.position_deg), ("speed", table.speed_deg_s), ("effort", table.effort)):
        assert set(said[group]) == set(said["units"][group]) == set(values)
        for name, value in values.items():
            np.testing.assert_array_equal(said[group][name], value)
    assert said["units"]["position"]["A"] == "deg"
    assert said["units"]["acceleration"]["O"] == "deg/s2"
    assert said["units"]["effort"]["act_O"] == "N.m"


def test_parquet_has_the_csv_s_columns_exactly_and_their_units(plan):
    read = pyarrow.parquet.read_table(io.BytesIO(exported(plan, "parquet")))
    columns = exported_samples(plan).table.columns()
    assert read.column_names == list(columns)
    for head, values in columns.items():
        np.testing.assert_array_equal(read[head].to_numpy(), values)
    units = {field.name: field.metadata[b"unit"].decode() for field in read.schema}
    assert units == {
        "time_s": "s", "O_deg": "deg", "O_deg_s": "deg/s", "A_deg": "deg", "A_deg_s": "deg/s", "C_deg": "deg",
        "C_deg_s": "deg/s", "act_O_Nm": "N.m", **{f"{pin}_force_N": "N" for pin in "BOAC"},
        **{f"{name}_deg_s{order}": f"deg/s{order}" for name in "OAC" for order in (2, 3)},
        **{f"frame_force_{axis}_N": "N" for axis in "xyz"}, **{f"frame_moment_{axis}_Nm": "N.m" for axis in "xyz"},
    }  # fmt: skip
    assert read.schema.metadata[b"plan"] == b"knee-reach"


def test_samples_stand_as_far_apart_as_asked_and_at_the_end(plan):
    time = exported_samples(plan, 0.03).time_s
    np.testing.assert_allclose(time, [0.0, 0.03, 0.06, 0.09, 0.12, 0.15, 0.16], atol=1e-12)
    np.testing.assert_allclose(exported_samples(plan, 0.04).time_s, [0.0, 0.04, 0.08, 0.12, 0.16], atol=1e-12)


@pytest.mark.parametrize("every", [0.0, -1.0, float("nan"), float("inf"), 0.2, 1e-9])
def test_a_time_between_samples_that_is_none_is_refused(plan, every):
    with pytest.raises(ProblemError, match="every_s"):
        exported_samples(plan, every)


@pytest.mark.parametrize("to", FORMATS)
def test_export_writes_one_file_and_never_overwrites(to, saved_reach, tmp_path, ask):
    target = tmp_path / "out"
    code, out, _ = ask("export", str(saved_reach), "--to", to, "-o", str(target), "--every-s", "0.01")
    assert (code, out.count("\n")) == (0, 1)
    before = target.read_bytes()
    assert before
    code, out, err = ask("export", str(saved_reach), "--to", to, "-o", str(target))
    assert (code, out) == (2, "")
    assert "already exists" in err
    assert target.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["knee-reach", "out"]


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["--to", "keyfrmes", "-o", "x"], "did you mean 'keyframes'?"),
        (["--to", "ros"], "-o/--output"),
        (["--to", "ros", "-o", "no/such/folder/x"], "there is no folder"),
        (["--to", "ros", "-o", ""], "empty name"),
        (["--to", "ros", "-o", "x", "--every-s", "0"], "above 0"),
    ],
)
def test_what_cannot_be_exported_is_refused_in_one_line(argv, said, saved_reach, tmp_path, ask, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = ask("export", str(saved_reach), *argv)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err


def test_results_have_parquet_beside_csv_where_it_is_asked_for(saved_reach, tmp_path, ask):
    code, _, _ = ask("track", str(saved_reach), "-o", str(tmp_path / "tracked"), "--parquet")
    assert code == 0
    read = pyarrow.parquet.read_table(tmp_path / "tracked" / "nominal-pd+ff.parquet")
    with np.load(tmp_path / "tracked" / "nominal-pd+ff.npz") as arrays:
        assert read.column_names == list(arrays)
        for head in arrays:
            np.testing.assert_array_equal(read[head].to_numpy(), arrays[head])
    listed = json.loads((tmp_path / "tracked" / ".linkplan.json").read_text(encoding="utf-8"))
    assert "nominal-pd+ff.parquet" in json.dumps(listed)
