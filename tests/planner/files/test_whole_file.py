"""A single file is written whole or not at all, and never over one that is not linkplan's."""

import os

import pytest

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.single_file import MADE_BY, check_file_target, write_file_whole

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
    with pytest.raises(PlanFileError, match="not linkplan's"):
        check_file_target(target, KINDS)
    assert target.read_bytes() == b"holidays"


def test_the_mark_is_found_wherever_it_stands_in_a_large_file(tmp_path):
    target = tmp_path / "film.mp4"
    edge = (1 << 20) - len(MADE_BY) // 2
    target.write_bytes(b"\0" * edge + MADE_BY.encode() + b"\0" * 9)
    check_file_target(target, KINDS)
    target.write_bytes(b"\0" * (edge + 99))
    with pytest.raises(PlanFileError):
        check_file_target(target, KINDS)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("film.avi", "'.avi'"),
        ("film", "ends in .mp4 or .png"),
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
    with pytest.raises(PlanFileError, match="no permission"):
        check_file_target(closed / "film.mp4", KINDS)
