"""Misspelled files and names: refused in one line with the nearest word."""

import pytest

from linkplan.models.errors import closest
from linkplan.studies.cli.main import main

# command line, the word that is meant
MISSPELLED = [
    (["plan", "knee-reach", "--set", "motion.goal_deg.o=10"], "O"),
    (["plan", "{folder}/leg.tmol"], "{folder}/leg.toml"),
    (["check", "{folder}/leg.xlm"], "{folder}/leg.xml"),
    (["track", "{folder}/plannd"], "{folder}/planned"),
    (["batch", "{folder}/lge.toml"], "{folder}/leg.toml"),
]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "leg.xml").write_text("", encoding="utf-8")
    (tmp_path / "leg.toml").write_text("", encoding="utf-8")
    (tmp_path / "planned").mkdir()
    return tmp_path


@pytest.mark.parametrize(("argv", "meant"), MISSPELLED, ids=[" ".join(argv) for argv, _ in MISSPELLED])
def test_the_nearest_word_is_suggested(argv, meant, folder, capsys):
    code = main([word.format(folder=folder) for word in argv])
    out, err = capsys.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"did you mean '{meant.format(folder=folder)}'?" in err


def test_what_is_close_to_nothing_is_refused_with_what_there_is(ask):
    code, _, err = ask("plan", "/no/such/folder/anywhere.toml")
    assert code == 2
    assert "did you mean" not in err


def test_a_folder_in_common_makes_no_name_close(tmp_path, ask):
    (tmp_path / "leg.toml").write_text("", encoding="utf-8")
    assert "did you mean" not in ask("plan", str(tmp_path / "spider.xyz"))[2]


def test_beginnings_of_options_and_negative_values_are_taken_as_before(ask):
    code, out, _ = ask("check", "optimus-knee", "--at-d", "-3")
    assert code == 0
    assert "-3" in out
    assert "'o' is not in mechanism" in ask("check", "optimus-knee", "--at-deg", "o=3")[2]  # a value, and not -o
    assert "--kd is a number of at least 0, got -1" in ask("bode", "optimus-knee", "--kd", "-1")[2]


def test_capitals_do_not_make_a_name_far():
    assert closest("o", ["A", "O", "C"]) == "O"
    assert closest("ACT_O", ["act_O", "act_B_to_D"]) == "act_O"
    assert closest("zz", ["A", "O", "C"]) is None
