"""A result replaces an earlier result whole; a folder with any file of the user's is refused and left as it is."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from linkplan.models import work_folders
from linkplan.models.errors import PlanFileError
from linkplan.planner.files.folders import check_target, restore, write_json, write_whole
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


def test_a_newer_result_replaces_the_whole_folder_with_its_permissions(tmp_path, place):
    place.chmod(0o750)
    write_whole(place, lambda new: write_json(new / "plan.json", {"problem": {}}))
    assert names(place) == [MANIFEST, "plan.json"]
    assert place.stat().st_mode & 0o777 == 0o750
    assert names(tmp_path) == ["run"]


def added(name):
    def add(place: Path) -> None:
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text("mine")

    return add


def replaced_by_a_link(name):
    def replace(place: Path) -> None:
        (place / name).rename(place.parent / "moved")
        (place / name).symlink_to(place.parent / "moved")

    return replace


def unread(place: Path) -> dict:
    """Return what says whether a folder's files were changed; reading one changes its time of access only."""
    stats = {path: (place / path).lstat() for path in files_in(place)}
    return {path: (one.st_ino, one.st_mode, one.st_size, one.st_mtime_ns) for path, one in stats.items()}


def replaced_by_a_folder(place: Path) -> None:
    (place / "plan.json").unlink()
    added("plan.json/thesis.tex")(place)


FOREIGN = {
    "a file beside the record": (added("notes.txt"), "notes.txt"),
    "a file in a folder of the result": (added("case/notes.txt"), "case/notes.txt"),
    "a hidden folder": (added(".git/objects/1"), ".git/objects/1"),
    "a changed record": (added("plan.json"), "plan.json"),
    "a changed file further down": (added("case/plan.json"), "case/plan.json"),
    "a link to a file": (replaced_by_a_link("case/plan.json"), "case/plan.json"),
    "a link to a folder": (replaced_by_a_link("case"), "case"),
    "a folder with a file's name": (replaced_by_a_folder, "plan.json/thesis.tex"),
    "a pipe": (lambda place: os.mkfifo(place / "pipe"), "pipe"),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_a_result_with_a_file_of_the_users_is_refused_by_that_file(case, tmp_path, place):
    change, name = FOREIGN[case]
    change(place)
    before = unread(place)
    assert_refused(lambda: check_target(place), f"'{name}', which is not as linkplan wrote", kind=PlanFileError)
    assert_refused(lambda: write_whole(place, result("new")), f"'{name}'", kind=PlanFileError)
    assert unread(place) == before
    assert not list(tmp_path.glob(".linkplan-*"))


def test_files_that_are_deleted_or_written_by_a_desktop_are_no_reason_to_refuse(place):
    (place / "case" / "plan.json").unlink()
    for name in (".DS_Store", "case/Thumbs.db"):
        added(name)(place)
    write_whole(place, result("new"))
    assert (place / "case" / "plan.json").read_text() == "new"


@pytest.mark.parametrize("name", ["plan.json", "thesis.tex", "sub/plan.json"])
def test_a_folder_without_a_manifest_is_never_replaced(name, tmp_path):
    added(name)(tmp_path)
    assert_refused(lambda: write_whole(tmp_path, result("new")), "no .linkplan.json of a result", kind=PlanFileError)
    assert (tmp_path / name).read_text() == "mine"


@pytest.mark.parametrize("change", [{"format": 1}, {"files": ["plan.json"]}, {"files": {"a": 1}}])
def test_a_manifest_that_this_version_did_not_write_is_refused(change, place):
    content = json.loads((place / MANIFEST).read_text())
    (place / MANIFEST).write_text(json.dumps(content | change))
    assert_refused(lambda: check_target(place), "damaged or that another version wrote", kind=PlanFileError)


def test_a_mount_point_is_refused_before_the_work(place, monkeypatch):
    monkeypatch.setattr(os.path, "ismount", lambda path: Path(path) == place)
    assert_refused(lambda: check_target(place), "mount point", kind=PlanFileError)


def test_a_path_is_resolved_before_it_is_judged(tmp_path):
    added("thesis/thesis.tex")(tmp_path)
    with pytest.raises(PlanFileError, match="has files"):
        write_whole(tmp_path / "run7" / ".." / "thesis", result("new"))
    assert (tmp_path / "thesis" / "thesis.tex").read_text() == "mine"
    assert names(tmp_path) == ["thesis"]


@pytest.mark.parametrize("target", [".", "..", "/", "~", "below/.."])
def test_the_working_the_home_and_the_root_folder_are_refused(target, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    (tmp_path / "home").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert_refused(lambda: check_target(Path(target).expanduser()), "folder or above it", kind=PlanFileError)


@pytest.mark.parametrize("target", ["~/run", "~"])
def test_a_home_that_no_shell_put_in_is_refused(target, tmp_path, monkeypatch):
    """A folder called ~ is one that somebody removes with `rm -r ~`."""
    monkeypatch.chdir(tmp_path)
    assert_refused(lambda: check_target(Path(target)), "no shell", kind=PlanFileError)


def test_a_link_to_a_folder_stays_a_link_when_its_result_is_replaced(tmp_path, place):
    (tmp_path / "link").symlink_to("run")
    write_whole(tmp_path / "link", result("new"))
    assert (tmp_path / "link").is_symlink()
    assert json.loads((place / "plan.json").read_text())["problem"] == "new"


def test_a_folder_is_judged_again_when_it_is_written(tmp_path):
    def write(new: Path) -> None:
        result("new")(new)
        added("run/thesis.tex")(tmp_path)

    assert_refused(lambda: write_whole(tmp_path / "run", write), "has files", kind=PlanFileError)
    assert names(tmp_path / "run") == ["thesis.tex"]
    assert names(tmp_path) == ["run"]


KILLED = """
import os, signal, sys
from pathlib import Path
from linkplan.planner.files import folders
point, place, renamed = sys.argv[1], Path(sys.argv[2]), []
def kill():
    os.kill(os.getpid(), signal.SIGKILL)
def write(new):
    (new / "far").mkdir()
    for name in ("plan.json", "far/plan.png"):
        (new / name).write_text('{"problem": "new"}')
    if point == "writing":
        kill()
rename = Path.rename
def rename_and_kill(self, other):
    if point == f"before rename {len(renamed)}":
        kill()
    rename(self, other)
    renamed.append(self)
def removed(*_, **__):
    if Path(_[0]).name == ".linkplan-old-run":
        kill()
Path.rename, folders.shutil.rmtree = rename_and_kill, removed
folders.write_whole(place, write)
"""


@pytest.mark.parametrize("again", [check_target, restore], ids=["written", "read"])
@pytest.mark.parametrize(
    ("point", "counts"),
    [("writing", "old"), ("before rename 0", "old"), ("before rename 1", "old"), ("before the removal", "new")],
)
def test_a_kill_at_any_moment_leaves_old_or_new_and_the_next_command_puts_it_in_order(point, counts, again, tmp_path, place):
    ended = subprocess.run([sys.executable, "-c", KILLED, point, str(place)], check=False)
    assert ended.returncode == -9
    assert list(tmp_path.rglob(".linkplan-*-*"))  # the effect is there: something is left over
    again(place)
    assert json.loads((place / "plan.json").read_text())["problem"] == counts
    written = {"case/plan.json", "plan.json"} if counts == "old" else {"far/plan.png", "plan.json"}
    assert set(files_in(place)) == {MANIFEST, *written}
    check_target(place)
    assert names(tmp_path) == ["run"]


def test_an_earlier_result_is_not_put_over_files_of_the_users(tmp_path, place):
    place.rename(tmp_path / ".linkplan-old-run")
    added("run/thesis.tex")(tmp_path)
    assert_refused(lambda: check_target(place), "the earlier result in", "cannot be moved", kind=PlanFileError)
    assert names(place) == ["thesis.tex"]
    assert (tmp_path / ".linkplan-old-run" / "plan.json").is_file()


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
    def write(new: Path) -> None:
        result("new")(new)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "a" / "run", write)
    assert names(tmp_path) == []


def test_a_folder_inside_a_result_is_no_place_for_another_result(place):
    """A case of a batch has no manifest of its own."""
    assert_refused(lambda: write_whole(place / "case", result("alone")), "no .linkplan.json", kind=PlanFileError)
    assert (place / "case" / "plan.json").read_text() == "old"
