"""Plans on disk: what is written is read back, what is broken is said, and nothing is left half done."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from linkplan.models.errors import CertificateError, PlanFileError, ProblemError
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.planner.files.folders import to_json_types, write_json, write_whole
from linkplan.planner.files.tables import read_tables
from linkplan.planner.plan.folder import read_plan, record_of, write_plan
from linkplan.planner.plan.plan import motion_table
from linkplan.planner.plan.record import PLAN_FORMAT
from linkplan.planner.problem.problem import Problem
from tests.support.fourbar import KNEE_PROBLEMS
from tests.support.plans import optimal, planned, saved_plan
from tests.support.refusals import assert_refused
from tests.support.tolerances_planner import CSV, PRINTED_NM

ARRAYS = ("breaks_s", "position", "velocity", "effort", "start_pose")
every_plan = pytest.mark.parametrize("name", KNEE_PROBLEMS)


def stored(path: Path) -> dict[str, np.ndarray]:
    with np.load(path / "trajectory.npz", allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


# What is written is read back.


@pytest.mark.slow
@every_plan
def test_a_plan_that_is_read_back_has_the_same_motion_and_says_the_same(name, tmp_path):
    plan, again = optimal(name), read_plan(saved_plan(name, tmp_path))
    for array in ARRAYS:
        np.testing.assert_array_equal(getattr(again.trajectory, array), getattr(plan.trajectory, array))
    assert again.trajectory.periodic == plan.trajectory.periodic
    assert (again.status, again.message, again.objective) == (plan.status, plan.message, plan.objective)
    assert again.details == plan.details
    assert again.problem == plan.problem


def test_overrides_outlive_the_folder(tmp_path):
    plan = optimal("knee-reach", "limits.effort.act_O=[-95, 96]", "mechanism.payload.mass_kg=3.9")
    write_whole(tmp_path / "plan", lambda new: write_plan(plan, new))
    problem = read_plan(tmp_path / "plan").problem
    np.testing.assert_array_equal(problem.limits.effort, [[-95, 96]])
    assert problem.mechanism.payload.mass_kg == 3.9


def test_the_record_is_json_with_its_units_in_its_names(saved):
    said = json.loads((saved / "plan.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert said["format"] == PLAN_FORMAT
    assert said["status"] == "optimal"
    assert said["duration_s"] == pytest.approx(0.16)
    assert said["peak_effort"]["act_O"] == pytest.approx(86.3, abs=PRINTED_NM)
    assert said["effort_unit"] == {"act_O": "N.m"}
    assert said["certificate"]["passed"] is True
    assert set(said["certificate"]["joint_margin_deg"]) == {"O", "A", "C"}
    assert {"linkplan", "mujoco", "casadi", "numpy", "scipy"} <= set(said["versions"])


@pytest.mark.slow
def test_the_record_of_an_infeasible_plan_is_json_too(tmp_path):
    plan = planned("knee-reach", "limits.speed_deg_s.O=500")
    write_json(tmp_path / "plan.json", record_of(plan))
    said = json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert (said["status"], said["certificate"], said["duration_s"]) == ("infeasible", None, None)


@pytest.mark.slow
def test_a_plan_without_a_motion_is_not_saved(tmp_path):
    plan = planned("knee-reach", "limits.speed_deg_s.O=500")
    with pytest.raises(PlanFileError, match="nothing to save: infeasible"):
        write_whole(tmp_path / "plan", lambda new: write_plan(plan, new))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("value", [float("nan"), float("inf"), np.float64("-inf")])
def test_a_number_that_is_not_finite_is_null_in_json(value):
    assert to_json_types({"a": [value, np.array([value])]}) == {"a": [None, [None]]}


# The table.


def table(folder: Path) -> tuple[list[str], np.ndarray]:
    with (folder / "trajectory.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    return rows[0], np.array(rows[1:], dtype=float)


def test_the_table_s_header_has_units(saved):
    header, _ = table(saved)
    joints = [name for joint in "OAC" for name in (f"{joint}_deg", f"{joint}_deg_s")]
    rates = [f"{joint}_deg_s{order}" for order in (2, 3) for joint in "OAC"]
    on_frame = [[f"frame_{what}_{axis}_{unit}" for axis in "xyz"] for what, unit in (("force", "N"), ("moment", "Nm"))]
    forces = [*(f"{pin}_force_N" for pin in "BOAC"), *on_frame[0], *on_frame[1]]  # no moment across a planar pin's axis
    assert header == ["time_s", *joints, *rates, "act_O_Nm", *forces]


@pytest.mark.slow
def test_both_sides_of_a_jump_are_rows_where_they_are_asked_for():
    plan = optimal("knee-sprint")
    single, both = motion_table(plan.problem, plan.trajectory), motion_table(plan.problem, plan.trajectory, jumps=True)
    assert len(both.time_s) == len(single.time_s) + plan.intervals - 1
    step = np.abs(np.diff(both.effort["act_O"]))[np.diff(both.time_s) < 1e-9 * plan.trajectory.duration_s]
    assert step.max() > 100.0  # the sprint pushes in full one way and then the other
    assert np.diff(single.time_s).min() > 0


@pytest.mark.slow
@every_plan
def test_the_table_s_rows_are_the_trajectory(name, tmp_path):
    header, rows = table(saved_plan(name, tmp_path))
    plan = optimal(name)
    trajectory, mechanism = plan.trajectory, plan.problem.mechanism
    time = rows[:, 0]
    assert len(time) == 10 * plan.intervals + 1
    assert np.diff(time).min() > 0  # no instant has two rows
    assert [time[0], time[-1]] == pytest.approx([0.0, trajectory.duration_s], rel=1e-11)
    # twelve digits of time fall on either side of a break, where an effort may jump: look inside the intervals only
    inside = np.abs(time[:, None] - trajectory.breaks_s).min(axis=1) > 1e-6 * trajectory.duration_s
    time, rows = time[inside], rows[inside]
    poses = follow(mechanism, trajectory.position_at(time), trajectory.start_pose)
    rates = joint_rates(mechanism, poses, trajectory.velocity_at(time))
    expected = {"act_O_Nm": trajectory.effort_at(time)[:, 0]}
    expected["O_deg_s2"] = np.degrees(trajectory.acceleration_at(time)[:, 0])
    for index, joint in enumerate("OAC"):
        expected[f"{joint}_deg"], expected[f"{joint}_deg_s"] = np.degrees(poses[:, index]), np.degrees(rates[:, index])
    for column, values in expected.items():
        written = rows[:, header.index(column)]
        # time's own twelve digits move a value by its rate times their rounding
        np.testing.assert_allclose(written, values, rtol=CSV, atol=10 * CSV * np.abs(values).max())


# What is broken is said in one line.


def with_arrays(**changes: np.ndarray | None) -> Callable[[Path], None]:
    """Return a change of the stored arrays; None takes one away."""

    def change(folder: Path) -> None:
        arrays = {name: value for name, value in (dict(stored(folder)) | changes).items() if value is not None}
        np.savez(folder / "trajectory.npz", **arrays)

    return change


def with_record(edit: Callable[[dict], object]) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        said = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
        replaced = edit(said)
        (folder / "plan.json").write_text(json.dumps(said if replaced is None else replaced), encoding="utf-8")

    return change


def content(name: str, data: bytes) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes(data) and None


def cut(name: str, share: float) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(share * len(data))])

    return change


def patched(offset: int, value: int) -> Callable[[Path], None]:
    """Return a change of one byte of the first entry in the npz's central directory."""

    def change(folder: Path) -> None:
        data = bytearray((folder / "trajectory.npz").read_bytes())
        data[data.index(b"PK\x01\x02") + offset] = value
        (folder / "trajectory.npz").write_bytes(bytes(data))

    return change


def flipped(folder: Path) -> None:
    data = bytearray((folder / "trajectory.npz").read_bytes())
    data[len(data) // 3] ^= 0xFF
    (folder / "trajectory.npz").write_bytes(bytes(data))


def as_folder(folder: Path) -> None:
    (folder / "trajectory.npz").unlink()
    (folder / "trajectory.npz").mkdir()


ONES = np.ones((4, 40, 1))
BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "no plan.json": (lambda folder: (folder / "plan.json").unlink(), "plan.json"),
    "plan.json cut short": (cut("plan.json", 0.5), "truncated or not JSON"),
    "plan.json nested without end": (content("plan.json", b"[" * 100_000), "plan.json"),
    "plan.json of something else": (content("plan.json", b'{"name": "x"}'), "missing required field `format`"),
    "another format": (with_record(lambda said: said.update(format=99)), "has format 99"),
    "no problem": (with_record(lambda said: said.update(problem="x")), "Expected `object`, got `str` - at `$.problem`"),
    "a problem that is malformed": (
        with_record(lambda said: said["problem"]["motion"].update(kind="reech")),
        "cannot be built again: unknown motion.kind",
    ),
    "a problem whose model is gone": (
        with_record(lambda said: said["problem"]["mechanism"].update(model="gone.xml")),
        "cannot be built again: unknown model 'gone.xml'",
    ),
    "an objective that is no number": (with_record(lambda said: said.update(objective=True)), "at `$.objective`"),
    "a figure that is not finite": (with_record(lambda said: said.update(details={"price": np.nan})), "not JSON"),
    "a status that is none": (with_record(lambda said: said.update(status="perfect")), "perfect"),
    "no trajectory": (lambda folder: (folder / "trajectory.npz").unlink(), "trajectory.npz"),
    "a trajectory that is a folder": (as_folder, "trajectory.npz"),
    "a trajectory cut short": (cut("trajectory.npz", 0.7), "truncated or not a trajectory"),
    "a trajectory with a byte flipped": (flipped, "truncated or not a trajectory"),
    "an unknown compression": (patched(10, 97), "trajectory.npz"),
    "an array missing": (with_arrays(effort=None), "lacks an array: effort"),
    "an array of objects": (with_arrays(effort=np.array([{}], dtype=object)), "truncated or not a trajectory"),
    "a value that is not a number": (with_arrays(effort=np.full((3, 40, 1), np.nan)), "not finite"),
    "breaks that run back": (with_arrays(breaks_s=np.linspace(1, 0, 41)), "breaks must increase"),
    "breaks that begin late": (with_arrays(breaks_s=0.06 + np.linspace(0, 0.16, 41)), "its breaks_s begin at 0.06 s"),
    "a single break": (with_arrays(breaks_s=np.array(0.16)), "trajectory.npz"),
    "an interval missing": (with_arrays(effort=ONES[:3, 1:]), "intervals"),
    "two joints": (with_arrays(position=np.ones((5, 40, 2)), velocity=np.ones((4, 40, 2))), "does not fit mechanism"),
    "two actuators": (with_arrays(effort=np.ones((3, 40, 2))), "does not fit mechanism"),
    "a flat position": (with_arrays(position=ONES[:, :, 0]), "trajectory.npz"),
    "no coefficients": (with_arrays(effort=ONES[:0]), "trajectory.npz"),
    "a start pose of another mechanism": (with_arrays(start_pose=np.zeros(5)), "does not fit mechanism"),
    "a motion out of reach": (with_arrays(position=5 + np.ones((5, 40, 1))), "trajectory.npz"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_folder_is_refused_in_one_line(case, saved):
    change, words = BROKEN[case]
    change(saved)
    assert_refused(lambda: read_plan(saved), words, kind=PlanFileError)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"start_pose": np.zeros(0)}, "it has 0 joints in its start pose, the mechanism 3"),
        ({"velocity": np.zeros((4, 40, 0))}, "it has 0 velocities of independent joints, the mechanism 1"),
        ({"effort": np.zeros((3, 40, 2))}, "it has 2 efforts of actuators, the mechanism 1"),
    ],
)
def test_a_guess_of_another_mechanism_is_refused_by_what_differs(changes, said, saved):
    with_arrays(**changes)(saved)
    _, tables, _ = read_tables("knee-sine")
    with pytest.raises(ProblemError, match="the guess does not fit mechanism 'optimus-knee'") as refused:
        Problem.from_tables("guessed", tables | {"guess": {"plan": str(saved)}})
    assert said in str(refused.value)


@pytest.mark.parametrize("what", ["nothing", "an empty folder", "a file"])
def test_what_is_no_plan_is_refused(what, tmp_path):
    path = tmp_path / "plan"
    if what == "an empty folder":
        path.mkdir()
    elif what == "a file":
        path.write_text("{}")
    assert_refused(lambda: read_plan(path), "plan", kind=PlanFileError)


def test_a_solve_without_an_objective_has_one_that_is_not_a_number(saved):
    with_record(lambda said: said["history"][0].update(objective=None))(saved)
    assert np.isnan(read_plan(saved).history[0].objective)


def test_a_plan_that_could_not_be_used_once_it_is_saved_is_not_saved(tmp_path):
    plan = replace(optimal("knee-reach"), objective=2 * optimal("knee-reach").objective)
    with pytest.raises(CertificateError, match=r"not saved.*saved objective is"):
        write_whole(tmp_path / "plan", lambda new: write_plan(plan, new))
    assert list(tmp_path.iterdir()) == []
