"""JSON records read back as typed values, and the manifest of a result folder: its files with their contents' hashes.

A result folder belongs to linkplan as long as all its files are listed and have the listed hashes.
"""

import hashlib
import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path
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
# Files that desktops write into every folder that they show.
_OF_DESKTOPS = (".DS_Store", "Thumbs.db", "desktop.ini")


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
        "about": "the files of this result with SHA-256; a newer result replaces the folder if it has no other files",
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
    if not os.path.lexists(path):
        return None
    try:
        return read_record(path, Manifest, MAX_FILE_BYTES)
    except PlanFileError as error:
        raise PlanFileError(
            f"'{folder}' has a {MANIFEST} that is damaged or that another version wrote; name a new folder"
        ) from error


def identity_at(folder: Path) -> str | None:
    """Return the identity of the result in a folder, or None if no manifest can be read."""
    try:
        manifest = read_manifest(folder)
    except PlanFileError:
        return None
    return None if manifest is None else manifest.identity


def foreign_file(folder: Path, manifest: Manifest) -> str | None:
    """Return the first file of a result's folder that linkplan did not write or that has changed since, or None."""
    names = (name for name in files_in(folder) if name != MANIFEST and Path(name).name not in _OF_DESKTOPS)
    return next((name for name in names if _hash(folder / name) != manifest.files.get(name, "")), None)


def _hash(path: Path) -> str | None:
    """Return a file's SHA-256; None for links, pipes and devices."""
    if not stat.S_ISREG(path.lstat().st_mode):
        return None
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
