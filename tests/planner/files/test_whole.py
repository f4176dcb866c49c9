"""Results and single files are written whole or not at all, whatever a disk refuses, and never over somebody else's."""

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest

from linkplan.models import work_folders
from linkplan.models.errors import PlanFileError
from linkplan.planner.files import folders
from linkplan.planner.files.folders import check_target, write_json, write_whole
from linkplan.planner.files.single_file import MADE_BY, check_file_target, write_file_whole
from linkplan.planner.plan.folder import read_plan, write_plan
from linkplan.planner.plan.verdict import failed
from linkplan.studies.output.report_file import PAGE_MARK
from tests.support.plans import optimal, planned
from tests.support.refusals import assert_refused


def fails(folder: Path) -> None:
    (folder / "plan.json").write_text("half")
    raise RuntimeError("in the middle")


def out_of_disk(folder: Path) -> None:
    (folder / "plan.json").write_text("half")
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize(("write", "error"), [(fails, RuntimeError), (out_of_disk, PlanFileError)])
def test_a_write_that_fails_leaves_nothing_behind(write, error, tmp_path):
    with pytest.raises(error):
        write_whole(tmp_path / "plan", write)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("write", "error"), [(fails, RuntimeError), (out_of_disk, PlanFileError)])
def test_a_write_that_fails_keeps_the_earlier_result(write, error, saved):
    before = {path.name: path.read_bytes() for path in saved.iterdir()}
    with pytest.raises(error):
        write_whole(saved, write)
    assert {path.name: path.read_bytes() for path in saved.iterdir()} == before
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


def test_missing_parents_are_made(tmp_path):
    write_whole(tmp_path / "a" / "b" / "plan", lambda new: write_plan(optimal("knee-reach"), new))
    assert read_plan(tmp_path / "a" / "b" / "plan").status == "optimal"


def test_an_empty_folder_may_be_filled(tmp_path):
    (tmp_path / "plan").mkdir()
    write_whole(tmp_path / "plan", lambda new: write_json(new / "plan.json", {}))
    assert (tmp_path / "plan" / "plan.json").is_file()


def test_a_result_is_replaced_by_its_own_kind_only(tmp_path):
    write_whole(tmp_path / "run", lambda new: write_json(new / "tune.json", {}), "tune.json")
    check_target(tmp_path / "run", "tune.json")
    with pytest.raises(PlanFileError, match=r"another result \(tune.json\)"):
        check_target(tmp_path / "run", "bode.json")


def test_a_file_in_the_way_is_not_overwritten(tmp_path):
    (tmp_path / "plan").write_text("mine")
    with pytest.raises(PlanFileError, match="is a file"):
        write_whole(tmp_path / "plan", lambda new: write_json(new / "plan.json", {}))
    assert_refused(lambda: check_target(tmp_path / "plan" / "below"), "is a file", kind=PlanFileError)
    assert (tmp_path / "plan").read_text() == "mine"


def test_a_plan_whose_certificate_fails_can_still_be_saved_and_says_so(tmp_path):
    plan = planned("knee-reach")
    broken = replace(plan, verdict=failed("on purpose"))
    write_whole(tmp_path / "plan", lambda new: write_plan(broken, new))
    assert read_plan(tmp_path / "plan", anyway=True).status == "failed"


KINDS = (".mp4", ".png")
OURS = b"\x89 " + MADE_BY.encode() + b" rest"


def test_a_failure_leaves_the_earlier_file_and_nothing_else(tmp_path):
    target = tmp_path / "film.mp4"
    target.write_bytes(OURS)

    def fails(path) -> None:
        path.write_bytes(b"half")
        raise RuntimeError("the encoder fails")

    with pytest.raises(RuntimeError):
        write_file_whole(target, fails, KINDS)
    assert target.read_bytes() == OURS
    assert list(tmp_path.iterdir()) == [target]


def test_an_interrupt_while_writing_leaves_nothing(tmp_path):
    def interrupted(path) -> None:
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_file_whole(tmp_path / "film.mp4", interrupted, KINDS)
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_linkplans_own_is_written_over_and_anothers_is_not(tmp_path):
    target = tmp_path / "film.mp4"
    target.write_bytes(OURS)
    write_file_whole(target, lambda path: path.write_bytes(OURS + b"2"), KINDS)
    assert target.read_bytes() == OURS + b"2"
    target.write_bytes(b"holidays")
    assert_refused(lambda: check_file_target(target, KINDS), "not written by linkplan", kind=PlanFileError)
    assert target.read_bytes() == b"holidays"


def test_the_mark_is_found_wherever_it_stands_in_a_large_file(tmp_path):
    target = tmp_path / "film.mp4"
    edge = (1 << 20) - len(MADE_BY) // 2
    target.write_bytes(b"\0" * edge + MADE_BY.encode() + b"\0" * 9)
    check_file_target(target, KINDS)
    target.write_bytes(b"\0" * (edge + 99))
    assert_refused(lambda: check_file_target(target, KINDS), kind=PlanFileError)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("film.avi", "'.avi'"),
        ("film", "must end in .mp4 or .png"),
        ("there/film.mp4", "no folder"),
        ("folder.mp4", "is a folder"),
    ],
)
def test_a_place_where_no_such_file_can_be_is_refused_in_a_line(name, words, tmp_path):
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(PlanFileError, match=words):
        check_file_target(tmp_path / name, KINDS)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="to root every folder is open")
def test_a_folder_that_may_not_be_written_is_refused(tmp_path):
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    assert_refused(lambda: check_file_target(closed / "film.mp4", KINDS), "no permission", kind=PlanFileError)


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


def test_a_disk_that_refuses_in_the_midst_of_a_replacement_loses_nothing(tmp_path, monkeypatch):
    place, rename = tmp_path / "run", Path.rename
    write_whole(place, result("old"))
    monkeypatch.setattr(Path, "rename", lambda path, to: refuse() if "work" in path.name else rename(path, to))
    assert_refused(lambda: write_whole(place, result("new")), "No space left", kind=PlanFileError)
    assert json.loads((place / "plan.json").read_text())["problem"] == "old"
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
