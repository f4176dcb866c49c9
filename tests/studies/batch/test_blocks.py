"""Batches: the same plans whatever ran them and however often they were killed; refused when something else is asked."""

import re
import tempfile
from pathlib import Path

import pytest
from msgspec.structs import replace

from linkplan.models.errors import PlanFileError
from linkplan.planner.plan.folder import write_plan
from linkplan.planner.search.planning import silent
from linkplan.studies.variations.batch import study
from linkplan.studies.variations.batch.block import Planned, case_blocks, packed, unpacked
from linkplan.studies.variations.batch.study import run_batch
from linkplan.studies.variations.tasks.engine import processes
from linkplan.studies.variations.tasks.unfinished import PARTS, unfinished
from tests.support.batches import same_plans, swept
from tests.support.plans import optimal


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
    return Planned(name="0", row=["0"], record={}, failure=None, files=files)


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
    "with a row of numbers": (lambda answer: replace(answer, row=[1]), "Expected `str | null`, got `int`"),
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
    with pytest.raises(PlanFileError, match=r"part\.msgpack' is damaged: .* remove it, and the same command plans"):
        unpacked(tmp_path / "part.msgpack", CASES, None)
