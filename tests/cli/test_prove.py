"""The command `prove`: exit codes, its lists in JSON, spoilt folders, and proofs that plans and reports keep."""

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import linkplan
from linkplan.cli.main import main
from tests.support.plans import optimal, saved_plan


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
    code, said = proved(capsys, str(folder), "--no-existence")
    assert (code, said["verdict"]) == (1, "refuted")
    assert all(one["reason"] for one in said["refuted"])


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


def test_without_existence_the_limits_alone_are_proved(folder, capsys):
    code, said = proved(capsys, str(folder), "--no-existence")
    assert (code, said["verdict"]) == (0, "proved")
    assert not [one for one in said["proved"] if "own motion" in one["name"]]
    (own,) = [one for one in said["sampled"] if "own motion" in one["name"]]
    assert "`linkplan prove` looks for one" in own["reason"]


def test_a_plan_that_a_proof_refutes_is_not_passed_anywhere(folder):
    spoil(folder, "position", (2, 0, 0), 2e-9)
    plan = linkplan.read_plan(folder, anyway=True).with_proof(existence=False)
    assert (plan.proof.verdict, plan.status, plan.passed, plan.certificate.passed) == ("refuted", "failed", False, False)
    assert (plan.duration_s, plan.objective) == (None, None)
    with pytest.raises(linkplan.LinkplanError, match="the planned velocity is not that of the planned position") as refused:
        plan.require()
    assert refused.value.plan is plan
    text = str(plan)
    assert "proof: refuted" in text
    assert "certificate: NOT passed" in text
    assert "certificate: passed" not in text
    record = plan.to_dict()
    assert (record["status"], record["certificate"]["passed"]) == ("failed", False)


def test_a_plan_command_whose_proof_refutes_ends_with_1_and_writes_nothing(monkeypatch, tmp_path, capsys):
    plan = optimal("knee-reach")
    position = np.array(plan.trajectory.position)
    position[2, 0, 0] += 2e-9
    spoilt_plan = replace(plan, trajectory=replace(plan.trajectory, position=position))
    monkeypatch.setattr("linkplan.api.plans.plan_motion", lambda *_: spoilt_plan)
    for words in (["plan", "knee-reach"], ["plan", "knee-reach", "--prove"]):
        assert main([*words, "-o", str(tmp_path / "out")]) == 1
        said = capsys.readouterr()
        assert "knee-reach: failed" in said.out
        assert "nothing written: failed" in said.err
        assert not (tmp_path / "out").exists()


def test_a_limit_of_one_s_own_that_a_folder_does_not_hold_is_not_proved(tmp_path, capsys):
    limit = linkplan.ExtraLimit(name="angle of C", expression=lambda at: at.position_rad["C"], lower=-30.0, unit="rad")
    plan = linkplan.plan(linkplan.Problem.from_file("knee-reach").replace(extra_limits=[limit]))
    folder = plan.save(tmp_path / "plan")
    again = linkplan.read_plan(folder).save(tmp_path / "again")
    for place in (folder, again):
        code, said = proved(capsys, str(place), "--no-existence")
        assert (code, said["verdict"]) == (0, "undecided")
        (found,) = said["undecided"]
        assert found["name"] == "extra limit 'angle of C'"
        assert found["reason"].startswith("not proved: ")
    read = linkplan.read_plan(folder, extra_limits=[limit]).prove(existence=False)
    assert read.verdict == "proved"
    assert "extra limit 'angle of C'" in [finding.name for finding in read.of("proved")]


def test_a_limit_of_one_s_own_that_balls_do_not_enclose_is_not_proved():
    limit = linkplan.ExtraLimit(name="odd", expression=lambda at: ca.erf(at.position_rad["C"]), upper=2.0)
    plan = optimal("knee-reach")
    proof = replace(plan, problem=plan.problem.varied(extra_limits=(limit,))).prove(existence=False)
    assert proof.verdict == "undecided"
    (found,) = proof.of("undecided")
    assert (found.name, found.reason[:12]) == ("extra limit 'odd'", "not proved: ")
