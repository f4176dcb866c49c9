"""Batches: the same plans whatever ran them and however often they were killed; refused when something else is asked."""

import time

import pytest

from linkplan.models.errors import PlanFileError
from linkplan.planner.planning import silent
from linkplan.studies.batch import study
from linkplan.studies.batch.block import Planned, block_count, cases_of, packed, unpacked
from linkplan.studies.batch.study import run_batch
from linkplan.studies.tasks.engine import processes
from linkplan.studies.tasks.unfinished import PARTS, unfinished
from tests.support.batches import same_plans, swept


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


def test_a_block_is_kept_whatever_year_its_clock_stands_in(tmp_path, monkeypatch):
    answer = Planned(name="a", row=(), record={}, failure=None, files={"plan.json": b"{}"})
    monkeypatch.setattr(time, "time", lambda: 0.0)  # archives know no date before 1980
    (tmp_path / "part.zip").write_bytes(packed([answer]))
    assert [one.name for one in unpacked(tmp_path / "part.zip", tmp_path)] == ["a"]
    assert (tmp_path / "a" / "plan.json").read_bytes() == b"{}"
