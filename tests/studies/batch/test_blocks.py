"""Batches: the same plans whatever ran them and however often they were killed; refused when something else is asked."""

import json

import pytest

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.batch_file import Batch, Case
from linkplan.planner.planning import silent
from linkplan.studies.batch import study
from linkplan.studies.batch.block import block_count, cases_of
from linkplan.studies.batch.study import run_batch
from linkplan.studies.tasks.engine import processes
from linkplan.studies.tasks.unfinished import PARTS, unfinished


def swept(n):
    """A batch of n cases that take a tenth of a second each, one of them impossible."""
    cases = [Case(name=f"{i}", settings=(f"motion.goal_deg.O={-40 + i}",)) for i in range(n)]
    cases[1] = Case(name="1", settings=("motion.duration_s=0.001",))
    return Batch(problem="knee-reach", common=("mesh.intervals=10", "mesh.tolerance_deg=0.01"), cases=tuple(cases))


def same_plans(first, second, n):
    """Fail where two results differ in anything but the seconds that they took."""
    names = [str(i) for i in range(n) if i != 1]
    assert sorted(path.name for path in first.iterdir()) == sorted([".linkplan.json", "batch.json", *names])
    for name in names:
        for file in ("trajectory.npz", "trajectory.csv"):
            assert (first / name / file).read_bytes() == (second / name / file).read_bytes()
    assert untimed(first) == untimed(second)


def untimed(folder):
    record = json.loads((folder / "batch.json").read_text())
    for case in record["cases"].values():
        del case["time_s"]
        for step in case["history"]:
            del step["build_s"], step["solve_s"]
    return record


@pytest.mark.parametrize("n", [1, 8, 9, 160, 500, 10_000])
def test_blocks_hold_every_case_once_in_order(n):
    held = [case for block in range(block_count(n)) for case in cases_of(block, n)]
    assert held == list(range(n))
    assert max(len(cases_of(block, n)) for block in range(block_count(n))) <= 64


@pytest.mark.slow
def test_two_processes_make_the_plans_of_one(tmp_path):
    outcome = run_batch(swept(9), tmp_path / "one", silent)
    run_batch(swept(9), tmp_path / "two", silent, engine=processes(2))
    same_plans(tmp_path / "one", tmp_path / "two", 9)
    assert [row[0] for row in outcome.rows] == [str(i) for i in range(9)]
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
    assert [path.name for path in (unfinished(tmp_path / "x") / PARTS).iterdir()] == ["part-00000.zip"]
    with pytest.raises(PlanFileError, match=r"holds the parts of a batch that was asked otherwise .*; name a new folder"):
        run_batch(swept(10), tmp_path / "x", silent)
    monkeypatch.setattr(study, "plan_block", lambda *given: (ran.append(given[1]), real(*given))[1])
    run_batch(swept(9), tmp_path / "x", silent)
    assert ran == [0, 1]
    assert not unfinished(tmp_path / "x").exists()
