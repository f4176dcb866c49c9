"""A plan in phases as a result: its text, its folder, which is read back, its page, and its command."""

import json

import numpy as np
import pytest

import linkplan
from linkplan.cli.main import main
from linkplan.models.errors import PlanError

ARM = """<mujoco model="arm"><option gravity="0 0 0"/><worldbody><body name="arm"><joint name="J" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
<actuator><motor name="J" joint="J" ctrlrange="{} {}" ctrllimited="true"/></actuator></mujoco>"""
LOAD = {"body": "arm", "mass_kg": 3.0, "com_m": [1.0, 0.0, 0.0]}
PHASES = [
    linkplan.Phase("approach", start_deg={"J": 0.0}, goal_deg={"J": float(np.degrees(1.0))}),
    linkplan.Phase("carry", payload=LOAD, goal_deg={"J": float(np.degrees(2.0))}),
]


def problem(effort=1000, **motion):
    return linkplan.Problem.phases(ARM.format(-effort, effort), PHASES, motion={"duration_s": 1.0, **motion}, name="pick")


@pytest.fixture(scope="module")
def plan():
    return linkplan.plan(problem())


def test_a_plan_in_phases_is_read_back_as_it_was_saved(plan, tmp_path):
    folder = plan.save(tmp_path / "picked", report=True)
    assert {path.name for path in folder.iterdir()} >= {"1-approach", "2-carry", "phases.json", "report.html"}
    assert json.loads((folder / "phases.json").read_text()) == plan.to_dict()
    again = linkplan.read_plan(folder)
    assert again.to_dict() == plan.to_dict()
    assert [one.objective for one in again.plans] == pytest.approx([one.objective for one in plan.plans], rel=1e-12)
    assert "Plan: pick-carry" in (folder / "report.html").read_text()


def test_its_text_names_the_phases_and_what_happens_between_them(plan):
    text = str(plan)
    assert "Locally effort-optimal motion of 1 s in 2 phases" in text
    assert "energy lost [J]" in text
    assert "14.1407" in text


def test_a_problem_in_phases_is_the_same_from_its_own_text():
    asked = problem()
    again = linkplan.PhasedProblem.from_file(asked.to_toml())
    assert again.to_dict() == asked.to_dict()
    assert asked.replace("motion.duration_s", 2.0).sections.motion.duration_s == 2.0


def test_the_command_plans_phases_and_others_name_the_folder_of_one(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pick.toml").write_text(problem().to_toml())
    assert main(["plan", "pick.toml", "-o", "picked", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["phases"][1]["name"] == "carry"
    assert main(["prove", "picked/2-carry"]) == 0
    capsys.readouterr()
    for words, said in (
        (["experiment", "pick.toml"], "has phases"),
        (["prove", "picked"], "name the folder of one phase, of 'picked/1-approach', 'picked/2-carry'"),
        (["track", "pick.toml"], "the same payload and closures"),
    ):
        assert main(words) == 2
        assert said in capsys.readouterr().err


def test_phases_that_no_effort_joins_in_time_have_a_verdict_and_no_motion():
    plan = linkplan.plan(problem(effort=1))
    assert not plan.passed
    with pytest.raises(PlanError, match="approach, carry"):
        plan.require()
