"""The manifest of a result folder: which files linkplan wrote there, each with the hash of its content.

A file belongs to linkplan while it is listed and its content has the listed hash. A file that has changed since, and a file
that is not listed, belong to the user. A folder without a manifest belongs to the user.
"""

import hashlib
import json
import os
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from linkplan.models.errors import PlanFileError

MANIFEST = ".linkplan.json"
_FORMAT_VERSION = 2
# A manifest of 10,000 cases has about four megabytes; the limits protect memory from a file that is no manifest.
_MAX_MANIFEST_BYTES = 64 << 20
_MAX_LISTED_FILES = 400_000
# The name of the record in each kind of result.
RECORDS = (
    "plan.json",
    "track.json",
    "compare.json",
    "bode.json",
    "tune.json",
    "check.json",
    "demo.json",
    "experiment.json",
    "decompose.json",
    "batch.json",
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Manifest:
    """What linkplan wrote into a folder.

    `record` is the name of the result's record, `files` the SHA-256 of each file by its path from the folder, and `identity`
    a random word that tells one result from the next.
    """

    record: str
    files: Mapping[str, str]
    identity: str


def files_in(folder: Path, below: str = "") -> Iterator[str]:
    """Yield the path, from a folder, of every entry below it that is not a folder; links are not followed."""
    for entry in sorted((folder / below).iterdir()):
        name = f"{below}/{entry.name}" if below else entry.name
        if entry.is_dir() and not entry.is_symlink():
            yield from files_in(folder, name)
        else:
            yield name


def write_manifest(folder: Path, record: str) -> None:
    """Write the manifest of a new result: every file in its folder with its hash."""
    said = {
        "format": _FORMAT_VERSION,
        "about": "the files that linkplan wrote here, with SHA-256; a newer result replaces those that are unchanged",
        "record": record,
        "identity": os.urandom(8).hex(),
        "files": {name: _hash(folder / name) for name in sorted(files_in(folder))},
    }
    (folder / MANIFEST).write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")


def read_manifest(folder: Path) -> Manifest | None:
    """Return a folder's manifest, or None where there is none.

    Raises:
        PlanFileError: when there is one that cannot be read, or that linkplan did not write.
    """
    path = folder / MANIFEST
    try:
        found = path.lstat()
        if not stat.S_ISREG(found.st_mode) or found.st_size > _MAX_MANIFEST_BYTES:
            raise ValueError
        said = json.loads(path.read_text(encoding="utf-8"))
        files, record, identity = said["files"], said["record"], said["identity"]
        if said["format"] != _FORMAT_VERSION or record not in RECORDS or not isinstance(identity, str):
            raise ValueError
        if not isinstance(files, dict) or len(files) > _MAX_LISTED_FILES:
            raise ValueError
        if not all(_stays_inside(name) and isinstance(digest, str) for name, digest in files.items()):
            raise ValueError
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise PlanFileError(
            f"'{folder}' has a {MANIFEST} that is damaged or of another version; name a new folder"
        ) from error
    return Manifest(record=record, files=files, identity=identity)


def identity_at(folder: Path) -> str | None:
    """Return the identity of the result in a folder, or None where there is none that can be read."""
    try:
        manifest = read_manifest(folder)
    except PlanFileError:
        return None
    return None if manifest is None else manifest.identity


def is_unchanged(folder: Path, name: str, manifest: Manifest) -> bool:
    """Return True if a file in a folder is as its manifest lists it: a plain file, below no link, of the same content."""
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
