"""The command `prove`: exit codes, its lists in JSON, spoilt folders, and proofs that plans and reports keep."""

import json
from pathlib import Path

import numpy as np
import pytest

from linkplan.studies.cli.main import main
from tests.support.plans import saved_plan


@pytest.fixture
def folder(tmp_path) -> Path:
    return saved_plan("knee-reach", tmp_path)


def spoil(folder: Path, name: str, at: tuple, by: float) -> None:
    path = folder / "trajectory.npz"
    arrays = dict(np.load(path))
    arrays[name][at] += by
    np.savez(path, **arrays)


def proved(capsys, *arguments: str) -> tuple[int, dict]:
    """Return the exit code and the printed object."""
    code = main(["prove", *arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_a_saved_plan_is_proved_and_json_has_the_four_lists(folder, capsys):
    code, said = proved(capsys, str(folder))
    assert (code, said["verdict"], said["refuted"], said["undecided"]) == (0, "proved", [], [])
    assert {"name", "bound", "margin", "boxes", "unit", "mark", "time_s", "reason"} <= set(said["proved"][0])
    (effort,) = [one for one in said["proved"] if one["name"] == "effort of act_O by inverse dynamics"]
    assert 86.3240 < effort["bound"] < 86.3242
    assert effort["boxes"] >= 40
    assert [one["name"] for one in said["sampled"]] == ["contacts between geoms"]
    own = [one for one in said["proved"] if "own motion" in one["name"]]
    assert [one["unit"] for one in own] == ["deg", "deg/s"]
    assert all(0 < one["bound"] < one["mark"] for one in own)


@pytest.mark.parametrize(
    ("name", "at", "by"),
    [
        ("position", (2, 0, 0), 2e-9),
        ("position", (slice(None), slice(30, None), 0), 1e-5),
        ("position", (2, 10, 0), 3.0),  # beyond the reach of the loop
        ("effort", (0, 0, 0), 20.0),
        ("start_pose", (2,), 0.1),
        ("breaks_s", (20,), 1e-4),
    ],
)
def test_a_spoilt_folder_is_refuted_with_exit_code_1(folder, capsys, name, at, by):
    spoil(folder, name, at, by)
    code, said = proved(capsys, str(folder))
    assert (code, said["verdict"]) == (1, "refuted")
    assert all(one["reason"] for one in said["refuted"])


def test_a_record_that_claims_a_proof_is_not_believed(folder, capsys):
    spoil(folder, "effort", (0, 0, 0), 20.0)
    record = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    record["proof"] = {"complete": True, "refuted": []}
    (folder / "plan.json").write_text(json.dumps(record), encoding="utf-8")
    assert proved(capsys, str(folder))[0] == 1


def test_the_text_names_what_is_proved_and_what_is_sampled(folder, capsys):
    assert main(["prove", str(folder)]) == 0
    text = capsys.readouterr().out
    assert "proof: proved" in text
    assert text.index("Proved at every instant") < text.index("Sampled, not proved") < text.index("contacts between geoms")


def test_a_saved_plan_cannot_be_changed_by_set_and_what_is_no_plan_is_refused(folder, tmp_path, capsys):
    assert main(["prove", str(folder), "--set", "limits.reserve=0.1"]) == 2
    assert main(["prove", str(tmp_path / "nothing")]) == 2
    (tmp_path / "empty").mkdir()
    assert main(["prove", str(tmp_path / "empty")]) == 2
    said = capsys.readouterr()
    assert len(said.err.strip().splitlines()) == 3
    assert said.out == ""


@pytest.mark.slow
def test_a_plan_keeps_its_proof_and_its_report_shows_it(tmp_path, capsys):
    target = tmp_path / "reach"
    assert main(["plan", "knee-reach", "--prove", "-o", str(target), "--report"]) == 0
    assert "proof: proved" in capsys.readouterr().out
    assert json.loads((target / "plan.json").read_text(encoding="utf-8"))["proof"]["complete"]
    page = tmp_path / "report.html"
    assert main(["report", str(target), "-o", str(page)]) == 0
    for path in (page, target / "report.html"):
        assert "Sampled, not proved" in path.read_text(encoding="utf-8")


def test_a_problem_is_planned_and_proved(capsys):
    code, said = proved(capsys, "cart-pole-swing-up")
    assert (code, said["plan"]) == (0, "cart-pole-swing-up")
