"""A folder of the user's is never lost: whatever stands in it, however it is named, wherever a run is killed."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from linkplan.models import work_folders
from linkplan.models.errors import PlanFileError
from linkplan.planner.files.folders import check_target, write_json, write_whole
from linkplan.planner.files.manifest import MANIFEST, files_in
from tests.support.refusals import assert_refused


def result(text):
    def write(folder: Path) -> None:
        (folder / "plan.json").write_text(json.dumps({"problem": text}))
        (folder / "case").mkdir()
        (folder / "case" / "plan.json").write_text(text)

    return write


@pytest.fixture
def place(tmp_path):
    """Return the folder of an earlier result."""
    write_whole(tmp_path / "run", result("old"))
    return tmp_path / "run"


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_files_of_the_users_in_a_result_survive_a_newer_one(tmp_path, place):
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


def test_a_file_that_only_the_older_result_had_goes_with_it(place):
    write_whole(place, lambda new: write_json(new / "plan.json", {"problem": {}}))
    assert names(place) == [MANIFEST, "plan.json"]


@pytest.mark.parametrize("record", ["plan.json", "experiment.json"])
@pytest.mark.parametrize("beside", [None, "thesis.tex", "sub/plan.json"])
def test_a_folder_without_a_manifest_is_never_replaced(record, beside, tmp_path):
    keys = ("problem", "tracker", "plan", "points", "found", "problems", "versions", "experiment", "decomposition", "cases")
    content = json.dumps(dict.fromkeys(keys, "my thesis"))
    for name in filter(None, (record, beside)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content)
    for act in (lambda: check_target(tmp_path, record), lambda: write_whole(tmp_path, result("new"), record)):
        with pytest.raises(PlanFileError, match=f"{record} without the .linkplan.json of a result"):
            act()
    assert (tmp_path / record).read_text() == content
    assert beside is None or (tmp_path / beside).read_text() == content


@pytest.mark.parametrize("name", ["plan.json", "case/plan.json"])
def test_a_file_that_has_changed_since_belongs_to_the_user(name, place):
    (place / name).write_text("my own words")
    for act in (lambda: check_target(place), lambda: write_whole(place, result("new"))):
        with pytest.raises(PlanFileError, match=f"'{name}', which has changed since linkplan wrote it"):
            act()
    assert (place / name).read_text() == "my own words"


@pytest.mark.parametrize("linked", ["case/plan.json", "case"])
def test_a_link_in_the_place_of_a_file_or_folder_of_a_result_belongs_to_the_user(linked, tmp_path, place):
    (place / linked).rename(tmp_path / "moved")
    (place / linked).symlink_to(tmp_path / "moved")
    assert_refused(lambda: check_target(place), "has changed since", kind=PlanFileError)
    assert (place / linked).is_symlink()


def test_a_manifest_of_another_version_is_refused(place):
    said = json.loads((place / MANIFEST).read_text())
    (place / MANIFEST).write_text(json.dumps(said | {"format": 1, "files": list(said["files"])}))
    assert_refused(lambda: check_target(place), "another version wrote", kind=PlanFileError)


@pytest.mark.skipif(shutil.which("chattr") is None, reason="needs chattr")
@pytest.mark.parametrize("name", ["plan.json", "case", "case/plan.json", "."])
def test_an_immutable_part_of_a_result_is_a_refusal_before_the_work(name, place):
    if subprocess.run(["chattr", "+i", str(place / name)], check=False, capture_output=True).returncode:
        pytest.skip("this file system or user has no immutable files")
    try:
        with pytest.raises(PlanFileError, match=r"cannot be changed|no permission"):
            check_target(place)
    finally:
        subprocess.run(["chattr", "-i", str(place / name)], check=True)
    check_target(place)


MOUNTED = """
import subprocess, sys
from pathlib import Path
from linkplan.models.errors import PlanFileError
from linkplan.planner.files.folders import check_target
other, inside, place = sys.argv[1:]
subprocess.run(["mount", "--bind", other, inside], check=True)
try:
    check_target(Path(place))
except PlanFileError as error:
    print(error)
"""


@pytest.mark.parametrize("inside", ["case", "case/plan.json", "mine, and yours"])
def test_a_mount_inside_a_result_is_a_refusal_before_the_work(inside, tmp_path, place):
    other = tmp_path / "other"
    if inside == "case/plan.json":
        other.write_text("a file")
    else:
        other.mkdir()
        (place / inside).mkdir(exist_ok=True)
    spaces = ["unshare", "--user", "--map-root-user", "--mount"]
    if shutil.which("unshare") is None or subprocess.run([*spaces, "true"], check=False, capture_output=True).returncode:
        pytest.skip("this system has no mount spaces for users")
    words = [*spaces, sys.executable, "-c", MOUNTED, str(other), str(place / inside), str(place)]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert f"mounted at '{place / inside}'" in said


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
    assert_refused(lambda: check_target(Path(target).expanduser()), "folder or above it", kind=PlanFileError)


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

    assert_refused(lambda: write_whole(place, write), "not linkplan's", kind=PlanFileError)
    assert names(place) == ["thesis.tex"]
    assert names(tmp_path) == ["run"]


def test_a_file_of_the_users_under_a_name_of_ours_is_not_replaced(tmp_path):
    place = tmp_path / "run"
    write_whole(place, lambda new: write_json(new / "plan.json", {"problem": {}}))
    (place / "case").write_text("mine")
    assert_refused(lambda: write_whole(place, result("new")), "'case', which linkplan needs to write", kind=PlanFileError)
    assert (place / "case").read_text() == "mine"


@pytest.mark.parametrize(
    "files",
    [
        {"../thesis.tex": ""},
        {"/etc/passwd": ""},
        {"a": 1},
        ["plan.json"],
        {"a/../../b": ""},
        {f"{k}": "" for k in range(400_001)},
    ],
    ids=["climbs", "absolute", "no hash", "no hashes", "climbs later", "too many"],
)
def test_a_manifest_that_leads_outside_or_lists_without_end_is_refused(files, tmp_path, place):
    (tmp_path / "thesis.tex").write_text("mine")
    said = json.loads((place / MANIFEST).read_text()) | {"files": files}
    (place / MANIFEST).write_text(json.dumps(said))
    assert_refused(lambda: write_whole(place, result("new")), "damaged", kind=PlanFileError)
    assert (tmp_path / "thesis.tex").read_text() == "mine"


KILLED = """
import os, signal, sys
from pathlib import Path
from linkplan.planner.files import folders
point, place = sys.argv[1], Path(sys.argv[2])
def kill():
    os.kill(os.getpid(), signal.SIGKILL)
def write(new):
    (new / "far").mkdir()
    for name in ("plan.json", "far/plan.png"):
        (new / name).write_text('{"problem": "new"}')
    if point == "writing":
        kill()
rename, replace = Path.rename, os.replace
def renamed(self, other):
    if point == "before the rename":
        kill()
    rename(self, other)
    if point == "after the rename":
        kill()
def replaced(source, target):
    if Path(target).name == point:
        kill()
    replace(source, target)
    if point == "at the end" and Path(target).name == folders.MANIFEST:
        kill()
Path.rename, os.replace = renamed, replaced
folders.write_whole(place, write)
"""


@pytest.mark.parametrize(
    ("point", "counts"),
    [
        ("writing", "old"),
        ("before the rename", "old"),
        ("after the rename", "new"),
        ("plan.json", "new"),
        ("plan.png", "new"),
        (MANIFEST, "new"),
        ("at the end", "new"),
    ],
)
def test_a_kill_at_any_moment_leaves_old_or_new_and_the_next_run_puts_the_rest_in_order(point, counts, tmp_path, place):
    (place / "notes.txt").write_text("mine")
    (place / "mine").mkdir()
    (place / "mine" / "thesis.tex").write_text("all my work")
    ended = subprocess.run([sys.executable, "-c", KILLED, point, str(place)], check=False)
    assert ended.returncode == -9
    assert len(list(tmp_path.rglob(".linkplan-*"))) == 1  # the effect is there: something is left over
    check_target(place)
    assert names(tmp_path) == ["run"]
    assert json.loads((place / "plan.json").read_text())["problem"] == counts
    written = {"case/plan.json", "plan.json"} if counts == "old" else {"far/plan.png", "plan.json"}
    assert set(files_in(place)) == {MANIFEST, "mine/thesis.tex", "notes.txt", *written}
    assert (place / "mine" / "thesis.tex").read_text() == "all my work"


def test_a_file_that_changed_after_a_kill_is_not_replaced(place):
    subprocess.run([sys.executable, "-c", KILLED, "after the rename", str(place)], check=False)
    (place / "plan.json").write_text("my own words")
    assert_refused(lambda: check_target(place), "'plan.json', which changed while it was being replaced", kind=PlanFileError)
    assert (place / "plan.json").read_text() == "my own words"


def test_a_work_folder_that_is_in_use_is_left_alone(tmp_path):
    def write(new: Path) -> None:
        result("new")(new)
        work_folders.sweep(tmp_path)
        assert (new / "plan.json").is_file()

    write_whole(tmp_path / "run", write)
    assert (tmp_path / "run" / "plan.json").is_file()


def test_a_disk_that_refuses_to_sync_keeps_the_earlier_result(tmp_path, monkeypatch, place):

    def refuse(descriptor: int) -> None:
        raise OSError(28, f"No space left on device, descriptor {descriptor}")

    monkeypatch.setattr(os, "fsync", refuse)
    assert_refused(lambda: write_whole(place, result("new")), "No space left", kind=PlanFileError)
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


def test_a_folder_inside_a_result_is_no_place_for_another_result(place):
    """A case of a batch has no manifest of its own."""
    assert_refused(lambda: write_whole(place / "case", result("alone")), "without the .linkplan.json", kind=PlanFileError)
    assert (place / "case" / "plan.json").read_text() == "old"


@pytest.mark.parametrize("target", ["~/run", "~"])
def test_a_home_that_no_shell_put_in_is_refused(target, tmp_path, monkeypatch):
    """A folder called ~ is one that somebody removes with `rm -r ~`."""
    monkeypatch.chdir(tmp_path)
    assert_refused(lambda: check_target(Path(target)), "no shell", kind=PlanFileError)
