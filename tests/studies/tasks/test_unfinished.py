"""Parts of a result that are removed when it is whole, whatever ends the removal."""

import itertools
from pathlib import Path

import pytest

from linkplan.planner.files.folders import write_json, write_whole
from linkplan.studies.variations.tasks.unfinished import PLAN, part, remove, remove_left, working

REQUEST = {"format": 1}


class KilledError(BaseException):
    """What no handler of the program catches, as a kill."""


def folder_of_parts(place: Path) -> Path:
    folder = place / "out.unfinished"
    with working(folder, REQUEST, "a test"):
        write_whole(folder / PLAN, lambda new: write_json(new / "plan.json", {}))
        part(folder, 0, "json").write_text("{}", encoding="utf-8")
    return folder


@pytest.mark.parametrize("kind", ["unlink", "rmdir"])
def test_parts_whose_removal_was_killed_anywhere_are_removed_by_the_next_run(kind, tmp_path, monkeypatch):
    kills = 0
    for step in itertools.count():
        folder = folder_of_parts(tmp_path)
        counter, real = itertools.count(), getattr(Path, kind)

        def stopped(path, *given, counter=counter, real=real, step=step, **more):
            if next(counter) == step:
                raise KilledError
            return real(path, *given, **more)

        with monkeypatch.context() as patch:
            patch.setattr(Path, kind, stopped)
            try:
                remove(folder)
            except KilledError:
                kills += 1
            else:
                break
        remove_left(folder, REQUEST)
        assert not folder.exists(), f"killed at {kind} {step}"
    assert kills >= 3
