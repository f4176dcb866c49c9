"""A folder of the user's is never lost: whatever stands in it, however it is named, wherever a run is killed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from linkplan.models.errors import PlanFileError
from linkplan.planner.files import work_folders
from linkplan.planner.files.folders import MANIFEST, check_target, write_json, write_whole


def result(text):
    def write(folder: Path) -> None:
        (folder / "plan.json").write_text(json.dumps({"problem": text}))
        (folder / "case").mkdir()
        (folder / "case" / "plan.json").write_text(text)

    return write


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_files_of_the_users_in_a_result_survive_a_newer_one(tmp_path):
    place = tmp_path / "run"
    write_whole(place, result("old"))
    (place / "notes.txt").write_text("mine")
    (place / "case" / "notes.txt").write_text("mine too")
    (place / ".git" / "objects").mkdir(parents=True)
    (place / ".git" / "objects" / "1").write_text("history")
    (place / "link").symlink_to("notes.txt")
    write_whole(place, result("new"))
    assert json.loads((place / "plan.json").read_text())["problem"] == "new"
    assert (place / "case" / "plan.json").read_text() == "new"
    assert (place / "notes.txt").read_text() == "mine"
    assert (place / "case" / "notes.txt").read_text() == "mine too"
    assert (place / ".git" / "objects" / "1").read_text() == "history"
    assert os.readlink(place / "link") == "notes.txt"
    assert names(tmp_path) == ["run"]


def test_a_file_that_only_the_older_result_had_goes_with_it(tmp_path):
    place = tmp_path / "run"
    write_whole(place, result("old"))
    write_whole(place, lambda new: write_json(new / "plan.json", {"problem": {}}))
    assert names(place) == [MANIFEST, "plan.json"]


@pytest.mark.parametrize("content", ["{}", "[1]", "my plan", '{"problem": {}}'])
def test_a_folder_with_a_plan_json_and_other_files_is_not_ours(content, tmp_path):
    (tmp_path / "plan.json").write_text(content)
    (tmp_path / "thesis.tex").write_text("all my work")
    with pytest.raises(PlanFileError, match="not linkplan's"):
        write_whole(tmp_path, result("new"))
    assert (tmp_path / "thesis.tex").read_text() == "all my work"
    assert (tmp_path / "plan.json").read_text() == content


def test_a_plan_json_of_somebody_elses_is_not_ours(tmp_path):
    (tmp_path / "plan.json").write_text('{"holiday": "in May"}')
    with pytest.raises(PlanFileError, match="not linkplan's"):
        check_target(tmp_path)


def test_a_path_is_resolved_before_it_is_judged(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.tex").write_text("all my work")
    with pytest.raises(PlanFileError, match="not linkplan's"):
        write_whole(tmp_path / "run7" / ".." / "thesis", result("new"))
    assert (tmp_path / "thesis" / "thesis.tex").read_text() == "all my work"
    assert names(tmp_path) == ["thesis"]


@pytest.mark.parametrize("target", [".", "..", "/", "~", "below/.."])
def test_the_working_the_home_and_the_root_folder_are_refused(target, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    (tmp_path / "home").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    with pytest.raises(PlanFileError, match="folder or above it"):
        check_target(Path(target).expanduser())


def test_a_link_is_written_through(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    write_whole(tmp_path / "link", result("new"))
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / "plan.json").is_file()


def test_a_folder_is_judged_again_when_it_is_written(tmp_path):
    place = tmp_path / "run"

    def write(new: Path) -> None:
        result("new")(new)
        place.mkdir()
        (place / "thesis.tex").write_text("written meanwhile")

    with pytest.raises(PlanFileError, match="not linkplan's"):
        write_whole(place, write)
    assert names(place) == ["thesis.tex"]
    assert names(tmp_path) == ["run"]


def test_a_file_of_the_users_under_a_name_of_ours_is_not_replaced(tmp_path):
    place = tmp_path / "run"
    write_whole(place, lambda new: write_json(new / "plan.json", {"problem": {}}))
    (place / "case").write_text("mine")
    with pytest.raises(PlanFileError, match="'case', which linkplan would now write"):
        write_whole(place, result("new"))
    assert (place / "case").read_text() == "mine"


def test_a_folder_of_the_users_that_may_not_be_moved_is_a_refusal_before_the_work(tmp_path, monkeypatch):
    place = tmp_path / "run"
    write_whole(place, result("old"))
    (place / "mine").mkdir()
    (place / "mine" / "thesis.tex").write_text("all my work")
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "mine" or mode != os.W_OK)
    with pytest.raises(PlanFileError, match="'mine', which cannot be moved"):
        check_target(place)
    assert (place / "mine" / "thesis.tex").read_text() == "all my work"
    assert names(tmp_path) == ["run"]


@pytest.mark.parametrize("files", [["../thesis.tex"], ["/etc/passwd"], [1], "plan.json", ["a/../../b"], list("ab") * 50_001])
def test_a_manifest_that_leads_outside_or_lists_without_end_is_refused(files, tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    place = tmp_path / "run"
    write_whole(place, result("old"))
    said = json.loads((place / MANIFEST).read_text()) | {"files": files}
    (place / MANIFEST).write_text(json.dumps(said))
    if files != "plan.json":
        with pytest.raises(PlanFileError, match="damaged"):
            write_whole(place, result("new"))
    assert (tmp_path / "thesis.tex").read_text() == "mine"


KILLED = """
import os, signal, sys
from pathlib import Path
from linkplan.planner.files import work_folders, folders
point, place = sys.argv[1], Path(sys.argv[2])
def kill(*_):
    os.kill(os.getpid(), signal.SIGKILL)
def write(new):
    (new / "plan.json").write_text('{"problem": "new"}')
    if point == "write":
        kill()
exchanged, handed, rename = work_folders._exchanged, work_folders.hand_over, Path.rename
if point.startswith("two"):
    work_folders._exchanged = lambda a, b: False
if point == "before":
    work_folders._exchanged = kill
if point == "after":
    work_folders._exchanged = lambda a, b: exchanged(a, b) and kill()
if point == "two renames":
    def once(self, other):
        rename(self, other)
        if Path(other).name == "old":
            kill()
    Path.rename = once
if point in ("settling", "two, settling"):
    def half(earlier, place):
        (earlier / "plan.json").unlink()
        kill()
    work_folders.hand_over = half
folders.write_whole(place, write)
"""


@pytest.mark.parametrize("point", ["write", "before", "after", "two renames", "settling", "two, settling"])
def test_a_kill_at_any_moment_leaves_old_or_new_and_the_next_run_puts_the_rest_in_order(point, tmp_path):
    place = tmp_path / "run"
    write_whole(place, lambda new: write_json(new / "plan.json", {"problem": "old"}))
    (place / "notes.txt").write_text("mine")
    (place / "mine").mkdir()
    (place / "mine" / "thesis.tex").write_text("all my work")
    ended = subprocess.run([sys.executable, "-c", KILLED, point, str(place)], check=False)
    assert ended.returncode == -9
    assert len(names(tmp_path)) == (1 if point == "two renames" else 2)  # the effect is there: something is left over
    check_target(place)
    assert names(tmp_path) == ["run"]
    assert json.loads((place / "plan.json").read_text())["problem"] in ("old", "new")
    assert names(place) == [MANIFEST, "mine", "notes.txt", "plan.json"]
    assert (place / "mine" / "thesis.tex").read_text() == "all my work"


def test_a_work_folder_that_is_in_use_is_left_alone(tmp_path):
    def write(new: Path) -> None:
        result("new")(new)
        work_folders.sweep(tmp_path)
        assert (new / "plan.json").is_file()

    write_whole(tmp_path / "run", write)
    assert (tmp_path / "run" / "plan.json").is_file()


def test_without_an_exchange_two_renames_serve(tmp_path, monkeypatch):
    place = tmp_path / "run"
    write_whole(place, result("old"))
    (place / "notes.txt").write_text("mine")
    monkeypatch.setattr(work_folders, "_exchanged", lambda *_: False)
    write_whole(place, result("new"))
    assert (place / "case" / "plan.json").read_text() == "new"
    assert (place / "notes.txt").read_text() == "mine"
    assert names(tmp_path) == ["run"]


def test_a_disk_that_refuses_to_sync_keeps_the_earlier_result(tmp_path, monkeypatch):
    place = tmp_path / "run"
    write_whole(place, result("old"))

    def refuse(descriptor: int) -> None:
        raise OSError(28, f"No space left on device, descriptor {descriptor}")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(PlanFileError, match="No space left"):
        write_whole(place, result("new"))
    assert (place / "case" / "plan.json").read_text() == "old"
    assert names(tmp_path) == ["run"]


def test_an_interrupt_while_it_is_written_leaves_the_earlier_result(tmp_path):
    place = tmp_path / "a" / "run"

    def write(new: Path) -> None:
        result("new")(new)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(place, write)
    assert names(tmp_path) == []


def test_a_result_that_was_written_into_a_folder_of_another_is_replaced_with_it(tmp_path):
    """A case of a batch that was planned again by itself: its figure is not left beside the batch's newer plan."""
    place = tmp_path / "run"
    write_whole(place, result(json.dumps({"problem": "old"})))
    write_whole(place / "case", lambda new: [(new / name).write_text("alone") for name in ("plan.json", "plan.png")])
    (place / "case" / "notes.txt").write_text("mine")
    assert names(place / "case") == [MANIFEST, "notes.txt", "plan.json", "plan.png"]
    write_whole(place, result("new"))
    assert names(place / "case") == ["notes.txt", "plan.json"]
    assert (place / "case" / "plan.json").read_text() == "new"
    assert (place / "case" / "notes.txt").read_text() == "mine"
    assert names(tmp_path) == ["run"]


def test_a_result_of_its_own_below_another_stays(tmp_path):
    place = tmp_path / "run"
    write_whole(place, result("old"))
    write_whole(place / "compared", result("mine"))
    write_whole(place, result("new"))
    assert (place / "compared" / "case" / "plan.json").read_text() == "mine"
    assert names(place / "compared") == [MANIFEST, "case", "plan.json"]


@pytest.mark.parametrize("target", ["~/run", "~"])
def test_a_home_that_no_shell_put_in_is_refused(target, tmp_path, monkeypatch):
    """A folder called ~ is one that somebody removes with `rm -r ~`."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PlanFileError, match="no shell"):
        check_target(Path(target))
