"""Batches: every case has the answer that it has alone; blocks are kept, resumed and refused where they are damaged."""

import json
import re
import tempfile
from pathlib import Path

import pytest
from msgspec.structs import replace

from linkplan.cli.main import main
from linkplan.models.errors import PlanFileError, ProblemError
from linkplan.planner.plan.folder import write_plan
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.batch import check_batch, plan_cases
from linkplan.planner.search.batch_file import read_batch
from linkplan.planner.search.planning import plan_motion, silent
from linkplan.studies.report.reading import folder_report
from linkplan.studies.variations.batch import study
from linkplan.studies.variations.batch.batch_blocks import case_row
from linkplan.studies.variations.batch.study import Planned, case_blocks, packed, run_batch, unpacked
from linkplan.studies.variations.tasks.engine import processes
from linkplan.studies.variations.tasks.unfinished import PARTS, unfinished
from tests.support.batches import same_plans, swept
from tests.support.plans import optimal
from tests.support.refusals import assert_refused
from tests.support.tolerances_planner import SAME_FIGURE


@pytest.mark.parametrize("n", [1, 8, 9, 160, 500, 10_000])
def test_blocks_hold_every_case_once_in_order(n):
    held = [case for cases in case_blocks(n) for case in cases]
    assert held == list(range(n))
    assert max(map(len, case_blocks(n))) <= 64


@pytest.mark.slow
def test_two_processes_make_the_plans_of_one(tmp_path):
    outcome = run_batch(swept(9), tmp_path / "one", silent)
    run_batch(swept(9), tmp_path / "two", silent, engine=processes(2))
    same_plans(tmp_path / "one", tmp_path / "two", 9)
    assert [row.name for row in outcome.rows] == [str(i) for i in range(9)]
    assert [text[:3] for text in outcome.failures] == ["1: "]


@pytest.mark.slow
def test_what_is_planned_is_not_planned_again_and_another_batch_is_refused(tmp_path, monkeypatch):
    real, ran = study.plan_block, []

    def stopping(batch, block, *more):
        if len(ran) == 1:
            raise KeyboardInterrupt
        ran.append(block)
        return real(batch, block, *more)

    monkeypatch.setattr(study, "plan_block", stopping)
    with pytest.raises(KeyboardInterrupt):
        run_batch(swept(9), tmp_path / "x", silent)
    assert not (tmp_path / "x").exists()
    assert [path.name for path in (unfinished(tmp_path / "x") / PARTS).iterdir()] == ["part-00000.msgpack"]
    with pytest.raises(PlanFileError, match=r"has parts of a batch with other settings .*; name a new folder"):
        run_batch(swept(10), tmp_path / "x", silent)
    monkeypatch.setattr(study, "plan_block", lambda *given: (ran.append(given[1]), real(*given))[1])
    run_batch(swept(9), tmp_path / "x", silent)
    assert ran == [0, 1]
    assert not unfinished(tmp_path / "x").exists()


CASES = swept(3).case[:1]


@pytest.fixture
def answer():
    """Return the answer of the first case, with a plan's files."""
    with tempfile.TemporaryDirectory() as place:
        write_plan(optimal("knee-reach"), Path(place))
        files = {path.name: path.read_bytes() for path in Path(place).iterdir()}
    return Planned(name="0", row=case_row(CASES[0], optimal("knee-reach")), record={}, failure=None, files=files)


def test_a_block_is_read_as_it_was_written(answer, tmp_path):
    (tmp_path / "part.msgpack").write_bytes(packed([answer]))
    assert [one.name for one in unpacked(tmp_path / "part.msgpack", CASES, tmp_path)] == ["0"]
    assert (tmp_path / "0" / "plan.json").read_bytes() == answer.files["plan.json"]


def without(name):
    return lambda answer: replace(answer, files={key: data for key, data in answer.files.items() if key != name})


def with_file(name, data):
    return lambda answer: replace(answer, files={**answer.files, name: data})


DAMAGED = {
    "of another case": (lambda answer: replace(answer, name="1"), "its cases are not those of the batch"),
    "with a row of numbers": (lambda answer: replace(answer, row=[1]), "Expected `object`, got `array`"),
    "with a record of lists": (lambda answer: replace(answer, record=[]), "got `array`"),
    "without a plan": (without("plan.json"), "it has no plan.json"),
    "without a motion": (without("trajectory.npz"), "trajectory.npz"),
    "with a plan cut short": (with_file("plan.json", b"{"), "truncated or not JSON"),
    "with a motion cut short": (with_file("trajectory.npz", b"PK"), "truncated or not a trajectory"),
    "with a file of somebody's": (with_file("mine.txt", b"mine"), "'0/mine.txt' is not a file of its plans"),
    "with a file above it": (with_file("../../mine.txt", b"mine"), "is not a file of its plans"),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_a_damaged_block_is_refused(case, answer, tmp_path):
    change, words = DAMAGED[case]
    (tmp_path / "part.msgpack").write_bytes(packed([change(answer)]))
    (tmp_path / "new").mkdir()
    with pytest.raises(PlanFileError, match=re.escape(words)) as raised:
        unpacked(tmp_path / "part.msgpack", CASES, tmp_path / "new")
    assert "part.msgpack' is damaged" in str(raised.value)
    assert not (tmp_path / "mine.txt").exists()


@pytest.mark.parametrize("content", [b"", b"\x91", b"no answers"])
def test_a_block_of_other_bytes_is_refused(content, tmp_path):
    (tmp_path / "part.msgpack").write_bytes(content)
    with pytest.raises(PlanFileError, match=r"part\.msgpack' is damaged: .* remove it and run the same command again"):
        unpacked(tmp_path / "part.msgpack", CASES, tmp_path)


SWEEP = """problem = "knee-reach"
set = ["motion.duration_s=0.2"]
[sweep]
motion.goal_deg.O = [45, 50]
"mechanism.payload.mass_kg" = [4.0, 5.0]
"""
CASE_TABLES = """problem = "knee-reach"
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
    code = main(["batch", str(batch_file(CASE_TABLES)), "-o", str(tmp_path / "out"), "--json"])
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
    assert [head for head, _ in cases.columns[:3]] == ["case", "motion.duration_s", "status"]
    assert [row[:3] for row in cases.rows] == [
        ["slow", 0.25, "optimal"],
        ["impossible", 0.1, "infeasible"],
        ["case-3", 0.24, "optimal"],
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
        ('problem = "knee-reach"', ["[[case]]", "[sweep]", "either [[case]] tables or a [sweep] table"]),
        (f"{CASE_TABLES}[sweep]\nx = [1]", ["either [[case]] tables or a [sweep] table"]),
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
    assert_refused(lambda: check_batch(read_batch(batch_file(text))), *words, kind=ProblemError)
