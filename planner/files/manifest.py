"""JSON records read back as typed values, and the manifest of a result folder: its files with their contents' hashes.

A file belongs to linkplan as long as it is listed and its content has the listed hash. A file that has changed since, a file
that is not listed, and a folder without a manifest belong to the user.
"""

import hashlib
import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Literal, TypeVar

import msgspec
from msgspec import Struct

from linkplan.models.errors import PlanFileError
from linkplan.models.reading import MAX_FILE_BYTES, read_file, too_deep
from linkplan.planner.files.structs import read_value

# The records of plans, experiments and reports have some hundred kilobytes.
MAX_RECORD_BYTES = 8_000_000
Record = TypeVar("Record")
MANIFEST = ".linkplan.json"
# A manifest of 10,000 cases lists about 40,000 files. The limit protects memory from other files.
_MAX_LISTED_FILES = 400_000


def read_record(path: Path, kind: type[Record], max_bytes: int = MAX_RECORD_BYTES) -> Record:
    """Return the record in a JSON file as a value of one type.

    Args:
        path: the file.
        kind: a msgspec type; keys that it does not name are ignored.
        max_bytes: the file's largest size.

    Raises:
        PlanFileError: when the file is missing, too large, truncated, nested more than a hundred levels deep, or has values
            of
            other types.
    """
    content = read_file(path, f"'{path}'", max_bytes, PlanFileError)
    # In memory, a table takes thirty times its size in JSON. Records have a table or a list for every forty bytes.
    containers, most = content.count(b"{") + content.count(b"["), max_bytes // 20
    if containers > most:
        raise PlanFileError(f"'{path}' has {containers} tables and lists; at most {most} are read")
    try:
        record = msgspec.json.decode(content, type=kind, dec_hook=read_value)
    except msgspec.ValidationError as error:
        raise PlanFileError(f"'{path}' is not a record that linkplan wrote: {error}") from error
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"'{path}' is truncated or not JSON: {error}") from error
    if too_deep(msgspec.structs.asdict(record) if isinstance(record, msgspec.Struct) else record):
        raise PlanFileError(f"'{path}' is nested too deeply")
    return record


class Manifest(Struct, frozen=True):
    """The content of a manifest.

    `record` is the name of the result's record. `files` maps the path of each file in the folder to its SHA-256. `identity`
    is a random word that distinguishes results.
    """

    format: Literal[2]
    record: str
    files: dict[str, str]
    identity: str


def files_in(folder: Path, below: str = "") -> Iterator[str]:
    """Yield the relative path of every entry below a folder that is not a folder; links are not followed."""
    for entry in sorted((folder / below).iterdir()):
        name = f"{below}/{entry.name}" if below else entry.name
        if entry.is_dir() and not entry.is_symlink():
            yield from files_in(folder, name)
        else:
            yield name


def write_manifest(folder: Path, record: str) -> None:
    """Write the manifest of a new result: every file in its folder with its hash."""
    content = {
        "format": 2,
        "about": "the files that linkplan wrote here, with SHA-256; a newer result replaces those that are unchanged",
        "record": record,
        "identity": os.urandom(8).hex(),
        "files": {name: _hash(folder / name) for name in sorted(files_in(folder))},
    }
    (folder / MANIFEST).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_manifest(folder: Path) -> Manifest | None:
    """Return a folder's manifest, or None if it has none.

    Raises:
        PlanFileError: when the manifest cannot be read, or linkplan did not write it.
    """
    path = folder / MANIFEST
    try:
        found = path.lstat()
        if not stat.S_ISREG(found.st_mode) or found.st_size > MAX_FILE_BYTES:
            raise ValueError
        manifest = msgspec.json.decode(path.read_bytes(), type=Manifest)
        if len(manifest.files) > _MAX_LISTED_FILES or not all(map(_stays_inside, manifest.files)):
            raise ValueError
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, RecursionError, msgspec.DecodeError) as error:
        raise PlanFileError(
            f"'{folder}' has a {MANIFEST} that is damaged or that another version wrote; name a new folder"
        ) from error
    return manifest


def identity_at(folder: Path) -> str | None:
    """Return the identity of the result in a folder, or None if no manifest can be read."""
    try:
        manifest = read_manifest(folder)
    except PlanFileError:
        return None
    return None if manifest is None else manifest.identity


def is_unchanged(folder: Path, name: str, manifest: Manifest) -> bool:
    """Check that a file in a folder is unchanged: a regular file, not reached by a link, with the hash of the manifest."""
    path = folder / name
    if any((folder / parent).is_symlink() for parent in PurePosixPath(name).parents):
        return False
    try:
        return stat.S_ISREG(path.lstat().st_mode) and _hash(path) == manifest.files.get(name)
    except (FileNotFoundError, NotADirectoryError):
        return False


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _stays_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return bool(name) and "\0" not in name and not path.is_absolute() and ".." not in path.parts and str(path) == name
