"""What disks refuse, and what stands in a result's place: the earlier result stays, and what is said of it is true."""

import json
import os
from pathlib import Path

import pytest

from linkplan.models import work_folders
from linkplan.models.errors import PlanFileError
from linkplan.planner.files import folders
from linkplan.planner.files.folders import check_target, write_json, write_whole
from linkplan.planner.files.single_file import check_file_target, write_file_whole
from linkplan.planner.plan.folder import read_plan
from linkplan.studies.output.report_file import PAGE_MARK
from tests.support.refusals import assert_refused


def result(text: str):
    return lambda folder: write_json(folder / "plan.json", {"problem": text})


def refuse(*_, **__) -> None:
    raise OSError(28, "No space left on device")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_work_folder_whose_process_is_gone_is_removed(tmp_path):
    (tmp_path / ".linkplan-work-0123456789abcdef").mkdir()
    (tmp_path / ".linkplan-work-0123456789abcdef" / "half").write_text("half")
    (tmp_path / ".linkplan-work-of-mine").mkdir()
    check_target(tmp_path / "run")
    assert names(tmp_path) == [".linkplan-work-of-mine"]


def test_a_work_folder_that_is_removed_before_it_is_locked_is_made_again(tmp_path, monkeypatch):
    lock, gone = work_folders._lock, []

    def swept_first(path: Path, *, wait: bool) -> int | None:
        if not gone:
            gone.append(path)
            path.rmdir()
        return lock(path, wait=wait)

    monkeypatch.setattr(work_folders, "_lock", swept_first)
    write_whole(tmp_path / "run", result("new"))
    assert gone
    assert names(tmp_path) == ["run"]


def test_a_result_without_permission_to_change_it_is_refused_before_the_work(tmp_path, monkeypatch):
    place = tmp_path / "run"
    write_whole(place, result("old"))
    may = os.access
    monkeypatch.setattr(folders.os, "access", lambda path, mode: Path(path) != place and may(path, mode))
    assert_refused(lambda: check_target(place), "no permission", kind=PlanFileError)


def test_a_folder_of_the_users_under_a_name_of_ours_is_not_taken_away(tmp_path):
    place = tmp_path / "run"
    write_whole(place, result("old"))
    (place / "plan.json").unlink()
    (place / "plan.json").mkdir()
    (place / "plan.json" / "thesis.tex").write_text("mine")
    assert_refused(lambda: write_whole(place, result("new")), "holds 'plan.json'", kind=PlanFileError)
    assert (place / "plan.json" / "thesis.tex").read_text() == "mine"
    assert names(tmp_path) == ["run"]


def test_a_disk_that_refuses_in_the_midst_of_a_replacement_loses_nothing(tmp_path, monkeypatch):
    place = tmp_path / "run"
    write_whole(place, result("old"))
    monkeypatch.setattr(os, "replace", refuse)
    assert_refused(lambda: write_whole(place, result("new")), "is only partly replaced: No space left", kind=PlanFileError)
    monkeypatch.undo()
    check_target(place)
    assert json.loads((place / "plan.json").read_text())["problem"] == "new"
    assert names(place) == [folders.MANIFEST, "plan.json"]
    assert names(tmp_path) == ["run"]


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path, monkeypatch):
    (tmp_path / "report.html").write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(PlanFileError, match="No space left"):
        write_file_whole(tmp_path / "report.html", lambda place: place.write_bytes(b"new"), mark="old")
    assert (tmp_path / "report.html").read_bytes() == b"old"
    assert names(tmp_path) == ["report.html"]


def test_a_link_to_an_earlier_file_is_written_through(tmp_path):
    (tmp_path / "report.html").write_bytes(b"old")
    (tmp_path / "link").symlink_to("report.html")
    write_file_whole(tmp_path / "link", lambda place: place.write_bytes(b"new"), mark="old")
    assert os.readlink(tmp_path / "link") == "report.html"
    assert (tmp_path / "report.html").read_bytes() == b"new"


def test_a_file_of_gigabytes_is_no_report_and_is_not_read_to_its_end(tmp_path):
    with (tmp_path / "report.html").open("wb") as file:
        os.truncate(file.fileno(), 10_000_000_000)
    with pytest.raises(PlanFileError, match="not written by linkplan"):
        check_file_target(tmp_path / "report.html", mark=PAGE_MARK)


def changed(folder: Path, **values: object) -> None:
    said = json.loads((folder / "plan.json").read_text()) | values
    (folder / "plan.json").write_text(json.dumps(said))


def test_a_name_that_cannot_be_shown_is_escaped_and_cut(saved):
    changed(saved, name="a\nb\0" + "x" * 1000)
    name = read_plan(saved).problem.name
    assert name.startswith("a\\nb\\x00x")
    assert len(name) <= 200


def test_a_plan_outlives_the_motion_that_it_was_begun_from(saved, tmp_path):
    (tmp_path / "emptied").mkdir()
    changed(
        saved,
        problem=json.loads((saved / "plan.json").read_text())["problem"] | {"guess": {"plan": str(tmp_path / "emptied")}},
    )
    assert read_plan(saved).passed
