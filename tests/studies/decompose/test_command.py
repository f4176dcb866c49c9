"""The command `decompose` and `linkplan.decompose`: the same answer in a table, a record, a folder and a report."""

import json

import pytest

import linkplan
from linkplan.studies.variations.decompose.ladder import CAUSES
from tests.support.tolerances_planner import SAME_FIGURE

SHORT = ("--set", "tracking.duration_s=0.005", "--trackers", "pd+ff")
HEAVY = ("--set", "imperfections.payload_mass_factor=1.2")


@pytest.mark.usefixtures("drawn_figures")
def test_the_command_says_writes_and_reports_the_same_parts(ask_json, ask, tmp_path):
    folder = tmp_path / "parts"
    code, said = ask_json("decompose", "knee-reach", *SHORT, *HEAVY, "-o", str(folder))
    assert code == 0
    assert json.loads((folder / "decompose.json").read_text()) == said
    assert (folder / "decompose.png").stat().st_size > 10_000
    found = said["trackers"]["pd+ff"]["deg"]
    assert list(found["parts"]) == list(CAUSES) == list(said["parts"])
    assert sum(found["parts"].values()) == pytest.approx(found["rms_error"], rel=SAME_FIGURE)
    code, _, _ = ask("report", str(folder), "-o", str(tmp_path / "page.html"))
    assert code == 0
    assert "discretisation of the plan" in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--trackers", "pdd"], 2, "unknown tracker 'pdd'"),
        (["--samples", "0"], 2, "samples is a whole number from 1 to 1000, got 0"),
        (["--set", "imperfections.payload_mass=1"], 2, "unknown key 'imperfections.payload_mass'"),
        (["--set", "motion.duration_s=0.01"], 1, "knee-reach"),
    ],
)
def test_what_cannot_be_is_one_line(ask, words, code, said):
    got, out, err = ask("decompose", "knee-reach", *words)
    assert got == code
    line = out if code == 1 else err
    assert said in line
    assert "Traceback" not in out + err


def test_a_loop_that_is_lost_is_exit_code_one(ask):
    code, out, _ = ask("decompose", "knee-reach", *SHORT, *HEAVY, "--set", "tracking.kd=1e6")
    assert code == 1
    assert "left out" in out


@pytest.fixture(scope="module")
def plan():
    problem = linkplan.Problem.from_file("knee-reach", {"tracking.duration_s": 0.005})
    return linkplan.plan(problem).require()


def test_python_has_the_same_study(plan, tmp_path):
    found = linkplan.decompose(plan, ["pd", "lqr"], imperfections={"delay_periods": 3})
    parts = found.to_dict()["trackers"]["pd"]["deg"]
    assert sum(parts["parts"].values()) == pytest.approx(parts["rms_error"], rel=SAME_FIGURE)
    assert found.to_dict()["imperfections"] == {"delay_periods": 3}
    assert "sampling and delay" in str(found)
    found.plot(tmp_path / "parts.png")
    assert (tmp_path / "parts.png").is_file()


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"trackers": "pd"}, "a list of names"),
        ({"imperfections": {"dealy_periods": 1}}, "did you mean 'delay_periods'"),
        ({"samples": 1.5}, "samples is a whole number"),
        ({"seed": -1}, "seed is a whole number"),
    ],
)
def test_what_makes_no_sense_is_refused(plan, asked, said):
    with pytest.raises(linkplan.LinkplanError, match=said):
        linkplan.decompose(plan, **asked)
