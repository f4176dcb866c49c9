"""Commands that are ended at random moments: a sample of `python -m tests.bench.kills`, and that it can find something."""

import os

import pytest

from linkplan.planner.files.folders import write_json, write_whole
from tests.bench import kills

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="commands are run in forked processes"),
    pytest.mark.usefixtures("default_signals"),
]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plan", "batch"])
def test_a_command_that_is_ended_leaves_the_earlier_result_or_the_new_one(name):
    found = kills.ended(name, kills.WAYS, 1, 5)
    assert [outcome.wrong for outcome in found] == [""] * len(kills.WAYS)
    assert any(not outcome.new for outcome in found)  # ended in the midst of it, some of them


@pytest.fixture
def earlier(tmp_path):
    write_whole(tmp_path / "out", lambda new: write_json(new / "plan.json", {"problem": "old"}))
    return tmp_path / "out", kills.content(tmp_path / "out")


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        (lambda out: (out / "plan.json").write_text("{}"), "plan.json has changed"),
        (lambda out: (out / "plan.json").unlink(), "plan.json has changed"),
        (lambda out: out.rename(out.with_name("elsewhere")), "the result is gone"),
    ],
)
def test_what_is_lost_is_found(damage, fault, earlier):
    out, before = earlier
    damage(out)
    assert fault in kills.faults(out, before, "plan.json")
