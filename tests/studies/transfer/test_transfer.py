"""`linkplan transfer` and `linkplan.transfer`: files with units, the same numbers everywhere, exit codes, refusals."""

import csv
import json

import numpy as np
import pyarrow.parquet
import pytest

import linkplan
from linkplan.cli.main import main
from linkplan.studies.handover.transfer.columns import columns_of
from tests.support import parallel_ankle
from tests.support.refusals import assert_refused

ANKLE = ["ankle_pitch", "ankle_roll"]


@pytest.fixture(scope="module")
def ankle():
    """Return a coarse table of the ankle, with gains and speeds to carry across."""
    return linkplan.transfer(
        linkplan.load_mechanism(parallel_ankle.ankle_text()),
        ANKLE,
        tolerance=0.02,
        motor_speed=12.0,
        joint_kp=[100, 60],
        motor_kd=0.5,
    )


def ask(capsys, *words: str) -> tuple[int, str, str]:
    code = main(list(words))
    return code, *capsys.readouterr()


def test_every_head_has_a_unit_and_every_column_is_of_the_arrays(ankle):
    columns = columns_of(ankle.transfer)
    assert all(head.endswith("]") and " [" in head for head in columns)
    assert sum(np.prod(value.shape[1:], dtype=int) for value in ankle.arrays.values()) >= len(columns)
    G = ankle.arrays["ratio"]
    np.testing.assert_array_equal(columns["G_right_ankle_roll [rad/rad]"], G[:, 1, 1])
    np.testing.assert_array_equal(columns["inertia_ankle_pitch_ankle_roll [kg m2]"], ankle.arrays["inertia"][:, 0, 1])
    np.testing.assert_array_equal(columns["motor_kp_left_right [N.m/rad]"], ankle.arrays["motor_kp"][:, 0, 1])
    np.testing.assert_array_equal(columns["speed_box_ankle_roll [rad/s]"], ankle.arrays["speed_box"][:, 1])


def test_units_follow_a_slide():
    table = linkplan.transfer(linkplan.load_mechanism("slider-crank", home_deg={"O": 60}), ["B"], tolerance=0.05)
    heads = list(columns_of(table.transfer))
    assert heads[:3] == ["joint_position_B [m]", "motor_position_act_O [rad]", "G_act_O_B [rad/m]"]
    assert {"inertia_B_B [kg]", "gravity_B [N]", "effort_largest_B [N]"} <= set(heads)


def test_gains_carried_there_are_the_gains_asked_for(ankle):
    home, found = ankle.to_dict()["home"], ankle.transfer.home.ratio[0]
    np.testing.assert_allclose(found.T @ np.array(home["motor_kp"]) @ found, np.diag([100.0, 60.0]), atol=1e-9)
    np.testing.assert_allclose(home["joint_kd"], 0.5 * found.T @ found)


def test_a_table_in_any_coordinates_is_the_same():
    again = linkplan.load_mechanism(parallel_ankle.ankle_text(), independent=ANKLE)
    tables = [
        linkplan.transfer(one, ANKLE, tolerance=0.05)
        for one in (again, linkplan.load_mechanism(parallel_ankle.ankle_text()))
    ]
    np.testing.assert_allclose(tables[0].arrays["ratio"], tables[1].arrays["ratio"], atol=1e-9)


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_figures")
def test_files_hold_the_same_numbers_with_units(ankle, tmp_path):
    ankle.save(tmp_path / "tables", parquet=True)
    place = tmp_path / "tables"
    with (place / "table.csv").open(newline="") as file:
        head, *rows = list(csv.reader(file))
    columns = columns_of(ankle.transfer)
    assert head == list(columns)
    np.testing.assert_allclose(np.array(rows, dtype=float), np.column_stack(list(columns.values())), rtol=1e-11)
    table = pyarrow.parquet.read_table(place / "table.parquet")
    assert table.schema.field("G_left_ankle_pitch [rad/rad]").metadata[b"unit"] == b"rad/rad"
    np.testing.assert_array_equal(table["gravity_ankle_pitch [N.m]"].to_numpy(), columns["gravity_ankle_pitch [N.m]"])
    arrays = np.load(place / "table.npz")
    about = json.loads(str(arrays["about"]))
    assert about["motors"] == ["left", "right"]
    assert arrays["ratio"].shape == (len(arrays["axis_0"]), len(arrays["axis_1"]), 2, 2)
    assert json.loads((place / "transfer.json").read_text())["kept"] is True
    assert (place / "inverse.csv").stat().st_size > 1000
    assert (place / "transfer.png").stat().st_size > 10_000


@pytest.mark.slow
def test_the_command_writes_a_folder_and_a_page(tmp_path, capsys):
    folder = tmp_path / "knee"
    code, out, _ = ask(
        capsys, "transfer", "optimus-knee", "--joints", "C", "--tolerance", "0.02", "--json", "--report", "-o", str(folder)
    )
    said = json.loads(out)
    assert (code, said["joints"], said["motors"]) == (0, ["C"], ["act_O"])
    assert said["ends"]["C"][1]["reason"] == "singular pose"
    assert {"table.csv", "table.npz", "transfer.json", "transfer.png", "serial.xml", "report.html"} <= {
        p.name for p in folder.iterdir()
    }
    assert ask(capsys, "report", str(folder), "-o", str(tmp_path / "page.html"))[0] == 0


def test_a_problem_gives_effort_limits_and_motor_speeds(capsys):
    words = ["transfer", "knee-reach", "--joints", "C", "--tolerance", "0.05", "--json"]
    settings = ["limits.effort={act_O=[-7,7]}", "motors.act_O={stall_effort=10, no_load_speed_deg_s=573}"]
    code, out, err = ask(capsys, *words, *[word for one in settings for word in ("--set", one)])
    assert code == 0, err
    home = json.loads(out)["home"]
    assert home["effort_box"][0][1] == pytest.approx(7 * abs(home["ratio"][0][0]))


def test_a_table_that_misses_its_tolerance_says_so_and_ends_with_1(capsys):
    code, out, _ = ask(capsys, "transfer", "optimus-knee", "--joints", "C", "--tolerance", "1e-9")
    assert code == 1
    assert "above the tolerance of 1e-09" in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--joints", "Q"], ["'Q' is not in mechanism", "O, A, C"]),
        (["--joints", "O,C"], ["degrees of freedom (1)", "got O, C"]),
        (["--joints", "C,C"], ["different joints"]),
        (["--joints", "C", "--tolerance", "0"], ["tolerance", "positive"]),
        (["--joints", "C", "--joint-kp", "1,2"], ["--joint-kp has one value, got 2"]),
        (["--joints", "C", "--joint-kp", "soft"], ["--joint-kp", "'soft'"]),
        (["--joints", "C", "--range-deg", "C=1"], ["JOINT=LOW:HIGH", "'C=1'"]),
        (["--joints", "C", "--range-deg", "O=1:2"], ["'O'", "output joints are C"]),
        (["--joints", "C", "--range-deg", "C=-300:2"], ["range of C is inside", "singular pose"]),
    ],
)
def test_bad_input_is_refused_in_one_line(words, said, capsys):
    code, out, err = ask(capsys, "transfer", "optimus-knee", *words)
    assert (code, out) == (2, "")
    line = err.strip().splitlines()[-1]
    assert all(part in line for part in said), line


def test_a_joint_at_its_dead_centre_is_no_output(capsys):
    code, _, err = ask(capsys, "transfer", "slider-crank", "--joints", "B")
    assert code == 2
    assert "singular at home" in err


@pytest.mark.parametrize("arguments", [{"joints": "C"}, {"joints": [1]}, {"joints": ["C"], "motor_kp": "x"},
                                       {"joints": ["C"], "range_deg": {"C": [1]}}])  # fmt: skip
def test_bad_values_are_refused(arguments):
    assert_refused(lambda: linkplan.transfer("optimus-knee", **arguments))


def test_a_quantity_is_interpolated_and_an_unknown_one_refused(ankle):
    (ratio,) = ankle.at("ratio", [[-0.2, 0.1]])
    np.testing.assert_allclose(ratio, parallel_ankle.ratio(-0.2, 0.1), atol=0.02)
    assert_refused(lambda: ankle.at("torque", [[0, 0]]), "unknown quantity 'torque'")
