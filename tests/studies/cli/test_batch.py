"""Batches: every case has the answer that it has alone, solved from the last; a bad case is named before any is planned."""

import json

import pytest

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.batch import check_batch, plan_cases
from linkplan.planner.search.batch_file import read_batch
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.cli.main import main
from linkplan.studies.report.reading import folder_report
from tests.support.tolerances_planner import SAME_FIGURE

SWEEP = """problem = "knee-reach"
set = ["motion.duration_s=0.2"]
[sweep]
motion.goal_deg.O = [45, 50]
"mechanism.payload.mass_kg" = [4.0, 5.0]
"""
CASES = """problem = "knee-reach"
[[case]]
name = "slow"
set = ["motion.duration_s=0.25"]
[[case]]
name = "impossible"
set = ["motion.duration_s=0.1"]
[[case]]
set = ["motion.duration_s=0.24"]
"""


@pytest.fixture
def batch_file(tmp_path):
    def write(text: str):
        path = tmp_path / "batch.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_sweep_has_every_combination_in_order(batch_file):
    batch = read_batch(batch_file(SWEEP))
    assert [case.name for case in batch.case] == ["1", "2", "3", "4"]
    assert batch.case[1].set == ["motion.goal_deg.O=45", "mechanism.payload.mass_kg=5.0"]
    assert batch.set == ["motion.duration_s=0.2"]


@pytest.mark.slow
def test_every_case_has_the_answer_that_it_has_alone_and_only_the_first_is_built(batch_file):
    batch = read_batch(batch_file(SWEEP))
    results = list(plan_cases(batch, batch.case))
    for number, (case, plan) in enumerate(results):
        alone = plan_motion(load_problem("knee-reach", ["motion.duration_s=0.2", *case.set]))
        assert plan.objective == pytest.approx(alone.objective, rel=SAME_FIGURE)
        assert plan.solved_again == (number > 0)


@pytest.mark.slow
def test_a_case_without_a_plan_is_said_and_does_not_spoil_the_next(batch_file, tmp_path, capsys):
    code = main(["batch", str(batch_file(CASES)), "-o", str(tmp_path / "out"), "--json"])
    said = json.loads(capsys.readouterr().out)["cases"]
    assert code == 1
    assert {name: case["status"] for name, case in said.items()} == {
        "slow": "optimal",
        "impossible": "infeasible",
        "case-3": "optimal",
    }
    assert said["case-3"]["history"][-1]["what"] == "solved again"
    files = [".linkplan.json", "batch.json", "case-3", "report.json", "slow"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == files
    (section,) = folder_report(tmp_path / "out").sections
    cases, failure = section.blocks
    assert [row[:3] for row in cases.rows] == [
        ["slow", "motion.duration_s=0.25", "optimal"],
        ["impossible", "motion.duration_s=0.1", "infeasible"],
        ["case-3", "motion.duration_s=0.24", "optimal"],
    ]
    assert failure.text.startswith("impossible: ")


@pytest.mark.slow
def test_a_saved_case_is_a_plan_like_any_other(batch_file, tmp_path, capsys):
    assert main(["batch", str(batch_file(SWEEP)), "-o", str(tmp_path / "out")]) == 0
    assert main(["track", str(tmp_path / "out" / "2"), "--json"]) == 0
    assert '"stable": true' in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["names no problem", "[[case]] or [sweep]"]),
        ('problem = "knee-reach"', ["[[case]]", "[sweep]", "one of the two"]),
        (f"{CASES}[sweep]\nx = [1]", ["one of the two"]),
        ('problem = "knee-reach"\ncases = []', ["'cases'", "did you mean 'case'"]),
        ('problem = "knee-reach"\n[sweep]\nmotion.duration_s = 0.2', ["sweep.motion.duration_s", "one or more values"]),
        (f'problem = "knee-reach"\n[sweep]\na.b = {list(range(200))}\na.c = {list(range(200))}', ["10000", "40000"]),
        ('problem = "knee-reach"\nset = "a.b=1"\n[sweep]\na.b = [1]', ["list of", "a.b=1"]),
        ('problem = "knee-reach"\n[[case]]\nname = "a/b"', ["case.name", "a/b"]),
        ('problem = "knee-reach"\n[[case]]\nname = "a"\n[[case]]\nname = "a"', ["twice: a"]),
        ('problem = "knee-reach"\n[[case]]\nname = "Å"\n[[case]]\nname = "a\u030a"', ["twice: a\u030a, Å"]),
        ('problem = "knee-reach"\n[[case]]\nname = "batch.json"', ["without .json at its end, got 'batch.json'"]),
        ('problem = "knee-reach"\n[[case]]\nname = ".linkplan.json"', ["case.name", "got '.linkplan.json'"]),
        (f'problem = "knee-reach"\n[[case]]\nname = "{"é" * 60}"', ["case.name", "got 'ééé"]),
        ('problem = "knee-reach"\n[[case]]\nset = ["motion.kind=walk"]', ["case 'case-1'", "motion.kind", "walk"]),
        ('problem = "knee-reach"\n[sweep]\nmotion.goal_deg.O = [45, 85]', ["case '2'", "O = 85 deg is beyond reach"]),
    ],
)
def test_a_bad_batch_is_refused_in_one_line(batch_file, text, words):
    with pytest.raises(ProblemError) as refused:
        check_batch(read_batch(batch_file(text)))
    for word in words:
        assert word in str(refused.value)
    assert "\n" not in str(refused.value)
