"""The cache of compiled functions is code that is run: nobody else's, never half of one, and it costs no more than speed."""

import os
import sys
import tempfile
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from linkplan.models.compiled import functions as module
from linkplan.models.compiled.cache import cache_folder, evict, find_entry, keep_entry, mark_used, trusted_folder
from linkplan.models.compiled.functions import cached, compiled, compiler
from linkplan.models.deadline import Deadline
from linkplan.models.mechanism import load_mechanism
from linkplan.models.work_folders import work_folder
from linkplan.planner.closed_chain.mechanics import NodeTerms, mechanism_system
from linkplan.planner.transcription.system import NodeFunctions, build_node

needs_compiler = pytest.mark.skipif(compiler() is None, reason="this machine has no C compiler")
needs_owners = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system's files have no owners")
LIBRARY = bytes(range(256)) * 20


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("LINKPLAN_CACHE", str(tmp_path / "cache"))
    return trusted_folder(make=True)


def kept(folder: Path, key: str = "k1") -> Path:
    """Return the library of an entry that is none, put into the cache as a compiled one is."""
    with work_folder(folder) as work:
        (work / f"{key}.so").write_bytes(LIBRARY)
        return keep_entry(work / f"{key}.so", {"n": 3}, folder, key)


def key_of(number: int) -> str:
    return f"k{number:032x}"


def entries(folder: Path, count: int) -> int:
    """Put entries into the cache, the first the one that was not used for the longest time; return the bytes of one."""
    for number in range(count):
        kept(folder, key_of(number))
        for path in folder.glob(f"{key_of(number)}.*"):
            os.utime(path, (1000.0 + number, 1000.0 + number))
    return sum(path.stat().st_size for path in folder.glob(f"{key_of(0)}.*"))


def left(folder: Path, count: int) -> list[int]:
    return [number for number in range(count) if find_entry(folder, key_of(number)) is not None]


def test_beyond_its_bound_the_cache_loses_what_was_not_used_for_the_longest_time(folder, monkeypatch):
    one = entries(folder, 6)
    others = [folder / "notes.json", folder / "kernel.so", folder / "k1.so"]
    for path in others:
        path.write_bytes(LIBRARY)
    evict(folder, key_of(5))
    assert left(folder, 6) == [0, 1, 2, 3, 4, 5]  # six small ones are none too many
    mark_used(folder, key_of(0))
    monkeypatch.setenv("LINKPLAN_CACHE_MB", str(3.5 * one / 2**20))
    evict(folder, key_of(5))
    assert left(folder, 6) == [0, 4, 5]
    assert len(list(folder.iterdir())) == 6 + len(others)  # both files of an entry go, and nothing that is none


def test_the_entry_that_was_made_now_stays_however_small_the_bound(folder, monkeypatch):
    entries(folder, 3)
    monkeypatch.setenv("LINKPLAN_CACHE_MB", "0")
    evict(folder, key_of(1))
    assert left(folder, 3) == [1]


@pytest.mark.parametrize("given", ["many", "-1", "nan"])
def test_a_bound_that_is_none_is_said_and_the_default_holds(given, folder, monkeypatch):
    entries(folder, 2)
    monkeypatch.setenv("LINKPLAN_CACHE_MB", given)
    with pytest.warns(RuntimeWarning, match=f"at least 0, got '{given}'; 2048 are kept"):
        evict(folder, key_of(1))
    assert left(folder, 2) == [0, 1]


@needs_compiler
def test_functions_that_are_loaded_outlive_their_entry(folder, monkeypatch):
    functions = compiled(key_of(1), NodeFunctions, built)
    size = functions.node_value.size1_in(0), functions.node_value.size1_in(1)
    before = np.array(functions.node_value(*(np.full(n, 0.3) for n in size)))
    os.utime(folder / f"{key_of(1)}.json", (1000.0, 1000.0))
    os.utime(folder / f"{key_of(1)}.so", (1000.0, 1000.0))
    assert cached(key_of(1), NodeFunctions) is not None
    assert (folder / f"{key_of(1)}.json").stat().st_mtime > 1e6  # use is noted
    monkeypatch.setenv("LINKPLAN_CACHE_MB", "0")
    compiled(key_of(2), NodeFunctions, built)
    assert cached(key_of(1), NodeFunctions) is None
    assert cached(key_of(2), NodeFunctions) is not None
    assert np.array(functions.node_value(*(np.full(n, 0.3) for n in size))) == pytest.approx(before, nan_ok=True)


def built():
    mechanism = load_mechanism("optimus-knee", payload="shank")
    return build_node(mechanism_system(mechanism, NodeTerms()))


@needs_owners
def test_the_cache_is_made_for_its_user_alone(folder):
    assert folder.stat().st_mode & 0o777 == 0o700
    assert {path.stat().st_mode & 0o777 for path in (kept(folder), folder / "k1.json")} == {0o600}


@pytest.mark.parametrize("at", [0, 100, len(LIBRARY) - 1])
@pytest.mark.parametrize("damage", ["cut", "flipped", "longer"])
def test_a_damaged_library_counts_as_none(damage, at, folder):
    library = kept(folder)
    changed = {"cut": LIBRARY[:at], "flipped": LIBRARY[:at] + b"!" + LIBRARY[at + 1 :], "longer": LIBRARY + b"x"}[damage]
    assert changed != LIBRARY
    library.write_bytes(changed)
    assert find_entry(folder, "k1") is None


def test_a_record_with_any_byte_altered_counts_as_none(folder):
    kept(folder)
    record = folder / "k1.json"
    whole = record.read_bytes()
    for at in range(len(whole)):
        record.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        assert find_entry(folder, "k1") is None
    record.write_bytes(whole)
    assert find_entry(folder, "k1") is not None


@needs_owners
def test_somebody_elses_folder_is_not_used(folder, monkeypatch):
    kept(folder)
    other = os.geteuid() + 1
    monkeypatch.setattr(os, "geteuid", lambda: other)
    with pytest.raises(PermissionError, match="belongs to somebody else"):
        trusted_folder(make=True)
    assert cached("k1", NodeFunctions) is None


@needs_owners
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o1777])
def test_a_folder_that_others_may_write_is_not_used_and_left_as_it_is(mode, folder):
    folder.chmod(mode)
    with pytest.raises(PermissionError, match="may be written by others"):
        trusted_folder(make=True)
    assert folder.stat().st_mode & 0o7777 == mode


@needs_owners
@pytest.mark.parametrize("mode", [0o777, 0o775, 0o770, 0o757])
@pytest.mark.parametrize("levels", [1, 2])
def test_a_folder_that_others_can_replace_is_not_used(folder, levels, mode, monkeypatch):
    inner = folder.joinpath(*["inner"] * (levels - 1), "cache")
    monkeypatch.setenv("LINKPLAN_CACHE", str(inner))
    assert trusted_folder(make=True) == inner
    folder.chmod(mode)
    with pytest.raises(PermissionError, match=f"lies in '{folder}', which others may write"):
        trusted_folder(make=True)
    folder.chmod(0o1000 | mode)  # in a sticky folder only its owner and theirs move things
    assert trusted_folder(make=True) == inner


@needs_owners
def test_a_folder_behind_a_link_that_others_can_replace_is_not_used(folder, tmp_path, monkeypatch):
    (tmp_path / "open").mkdir()
    (tmp_path / "open" / "link").symlink_to(folder)
    for named in ("open/link", "open/link/cache"):
        (tmp_path / "open").chmod(0o700)
        monkeypatch.setenv("LINKPLAN_CACHE", str(tmp_path / named))
        assert trusted_folder(make=True).is_relative_to(folder)
        (tmp_path / "open").chmod(0o777)
        with pytest.raises(PermissionError, match="open', which others may write"):
            trusted_folder(make=True)


@needs_owners
@pytest.mark.skipif(os.name == "posix" and os.geteuid() != 0, reason="only the superuser gives folders away")
def test_a_folder_in_somebody_else_s_is_not_used(folder, monkeypatch):
    monkeypatch.setenv("LINKPLAN_CACHE", str(folder / "cache"))
    trusted_folder(make=True)
    os.chown(folder, 65534, -1)
    with pytest.raises(PermissionError, match="which belongs to somebody else"):
        trusted_folder(make=True)


@needs_owners
@needs_compiler
def test_without_a_folder_to_trust_the_interpreter_serves_and_it_is_said(folder):
    folder.chmod(0o777)
    with pytest.warns(RuntimeWarning, match="may be written by others"):
        functions = compiled("k1", NodeFunctions, built)
    assert "External" not in functions.node_value.class_name()
    assert list(folder.iterdir()) == []


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("damage", ["cut", "flipped"])
def test_a_damaged_entry_is_compiled_again(damage, folder):
    """In processes of their own: loading such a library ended them."""
    compiled("k1", NodeFunctions, built)
    library = folder / "k1.so"
    whole = library.read_bytes()
    middle = len(whole) // 2
    altered = bytearray(whole)
    altered[middle:] = bytes(len(whole) - middle) if damage == "flipped" else b""
    library.write_bytes(altered)
    assert cached("k1", NodeFunctions) is None
    again = compiled("k1", NodeFunctions, built)
    assert {field.name for field in fields(again)} >= {"node_value"}
    assert "External" in again.node_value.class_name()
    assert cached("k1", NodeFunctions) is not None


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script for a compiler")
def test_a_compiler_that_hangs_ends_with_its_children(folder, tmp_path, monkeypatch):
    script = tmp_path / "compiler"
    script.write_text(f'#!/bin/sh\nsleep 600 & echo $! > "{tmp_path}/child"\nwait\n', encoding="utf-8")
    script.chmod(0o700)
    monkeypatch.setattr(module, "compiler", lambda: (str(script),))
    monkeypatch.setattr(module, "_COMPILER_TIMEOUT_S", 0.5)
    with pytest.warns(RuntimeWarning, match="timed out"):
        compiled("k1", NodeFunctions, built)
    assert list(folder.iterdir()) == []
    # One that ended but that nobody has asked after has no command line any more. A killed process ends a little later.
    line = Path(f"/proc/{int((tmp_path / 'child').read_text())}/cmdline")
    until = time.monotonic() + 10
    while line.exists() and line.read_bytes() and time.monotonic() < until:
        time.sleep(0.01)
    assert not line.exists() or not line.read_bytes()


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script for a compiler")
def test_a_compiler_ends_before_the_planner_s_deadline_and_the_interpreter_serves_without_a_word(
    folder, tmp_path, monkeypatch, recwarn
):
    script = tmp_path / "compiler"
    script.write_text(f'#!/bin/sh\necho begun > "{tmp_path}/begun"\nsleep 600\n', encoding="utf-8")
    script.chmod(0o700)
    monkeypatch.setattr(module, "compiler", lambda: (str(script),))
    functions = compiled("k1", NodeFunctions, built, Deadline().within(4.0))
    assert (tmp_path / "begun").exists()
    assert "External" not in functions.node_value.class_name()
    (tmp_path / "begun").unlink()
    compiled("k1", NodeFunctions, built, Deadline().within(-1.0))  # no time left: not even begun
    assert not (tmp_path / "begun").exists()
    assert not recwarn.list
    assert list(folder.iterdir()) == []


@needs_compiler
def test_what_a_kill_left_in_the_cache_is_removed_by_the_next_compilation(folder):
    left = folder / ".linkplan-work-0123456789abcdef"
    left.mkdir()
    (left / "k1.c").write_text("int", encoding="utf-8")
    with work_folder(folder) as used:
        (used / "k2.c").write_text("int", encoding="utf-8")
        compiled(key_of(1), NodeFunctions, built)
        assert (used / "k2.c").is_file()  # may be in use, and so left alone
    assert not left.exists()


def test_users_without_a_home_have_a_temporary_cache(tmp_path, monkeypatch):
    def nobody() -> Path:
        raise RuntimeError("could not determine home directory")

    for name in ("LINKPLAN_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", nobody)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert cache_folder().parent == tmp_path
    assert find_entry(trusted_folder(make=True), "k1") is None
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "missing")
    assert cache_folder().parent == tmp_path
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    assert cache_folder() == tmp_path / "caches" / "linkplan"


@needs_owners
def test_an_earlier_versions_own_folder_is_closed_to_others_and_loses_what_they_may_have_put_there(tmp_path, monkeypatch):
    monkeypatch.delenv("LINKPLAN_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "linkplan").mkdir()
    (tmp_path / "linkplan" / f"k{'0' * 32}.so").touch()
    (tmp_path / "linkplan" / "note.txt").touch()
    (tmp_path / "linkplan").chmod(0o775)
    assert trusted_folder(make=False).stat().st_mode & 0o777 == 0o700
    assert [path.name for path in (tmp_path / "linkplan").iterdir()] == ["note.txt"]
