"""Which files of a result folder are linkplan's: those that its manifest lists, and no others.

`write_whole` writes the manifest, `.linkplan.json`, with every result. A folder without one was written by an earlier
version or is the user's: it counts as ours where it holds only files that the earlier versions wrote.
"""

import json
import re
import stat
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from linkplan.models.errors import PlanFileError

MANIFEST = ".linkplan.json"
_FORMAT = 1
# A manifest of 10,000 cases is about a megabyte; anything larger than this is none.
_LARGEST_BYTES, _MOST_FILES = 64 << 20, 100_000
_PLAN = r"(plan\.json|trajectory\.(npz|csv)|plan\.png)"
_BODE = r"(bode\.json|(bode|nyquist|sensitivity|margins)(-[^/]+)?\.png|(map|large|along)\.png)"
# What versions without manifests wrote beside each record, and a key that the record has.
_EARLIER = {
    "plan.json": (_PLAN, "problem"),
    "track.json": (r"track\.(json|png)", "tracker"),
    "compare.json": (r"compare\.(json|png)|desired_and_actual\.png", "plan"),
    "bode.json": (_BODE, "points"),
    "tune.json": (r"tune\.(json|png)|tracking\.toml", "found"),
    "check.json": (r"check\.json|mechanism\.png|loop-\d+\.png", "problems"),
    "demo.json": (
        r"demo\.json|report\.html|stability_map\.png|desired_and_actual\.png|check/[^/]+/(check\.json|mechanism\.png)"
        rf"|plans/[^/]+/{_PLAN}|compare/[^/]+/compare\.(json|png)|bode/[^/]+/{_BODE}",
        "versions",
    ),
    "experiment.json": (r"experiment\.(json|png)|results\.parquet", "experiment"),
    "decompose.json": (r"decompose\.(json|png)", "decomposition"),
    "batch.json": (rf"batch\.json|[^/]+/{_PLAN}", "cases"),
}
# A folder that holds one of these is a result.
RECORDS = tuple(_EARLIER)


@dataclass(frozen=True, kw_only=True, slots=True)
class Manifest:
    """What linkplan wrote into a folder: the record's name, every file's path from there, and which writing it was."""

    record: str
    files: frozenset[str]
    identity: str


def files_in(folder: Path, below: str = "") -> Iterator[str]:
    """Yield the path from a folder of everything in it that is not itself a folder; links are not followed."""
    for entry in sorted((folder / below).iterdir()):
        name = f"{below}/{entry.name}" if below else entry.name
        if entry.is_dir() and not entry.is_symlink():
            yield from files_in(folder, name)
        else:
            yield name


def write_manifest(folder: Path, record: str, identity: str) -> frozenset[str]:
    """List a new result's files in its manifest and return them."""
    files = frozenset(files_in(folder))
    said = {
        "format": _FORMAT,
        "about": "files that linkplan wrote here; a newer result replaces these and nothing else",
        "record": record,
        "identity": identity,
        "files": sorted(files),
    }
    (folder / MANIFEST).write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")
    return files


def read_manifest(folder: Path) -> Manifest | None:
    """Return a folder's manifest, or None where there is none.

    Raises:
        PlanFileError: when there is one that cannot be read, or that is not ours.
    """
    path = folder / MANIFEST
    try:
        found = path.lstat()
        if not stat.S_ISREG(found.st_mode) or found.st_size > _LARGEST_BYTES:
            raise ValueError
        said = json.loads(path.read_text(encoding="utf-8"))
        files, record, identity = said["files"], said["record"], said["identity"]
        if len(files) > _MOST_FILES or said["format"] != _FORMAT or record not in RECORDS or not isinstance(identity, str):
            raise ValueError
        if not all(isinstance(name, str) and _stays_inside(name) for name in files):
            raise ValueError
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise PlanFileError(
            f"'{folder}' has a damaged {MANIFEST}, so that it cannot be told which files are linkplan's; name a new folder"
        ) from error
    return Manifest(record=record, files=frozenset(files), identity=identity)


def with_inner(folder: Path, files: frozenset[str]) -> frozenset[str]:
    """Return a result's files and those of results that were since written into folders of it, a batch's case say.

    What has become a folder since is no file of ours.
    """
    found = set(files)
    for below in {str(parent) for name in files for parent in PurePosixPath(name).parents} - {"."}:
        try:
            inner = read_manifest(folder / below)
        except PlanFileError:  # the user's, then
            inner = None
        if inner is not None:
            found |= {f"{below}/{name}" for name in (*inner.files, MANIFEST)}
    return frozenset(name for name in found if (folder / name).is_symlink() or not (folder / name).is_dir())


def _stays_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return bool(name) and "\0" not in name and not path.is_absolute() and ".." not in path.parts and str(path) == name


def replaceable(folder: Path, record: str) -> frozenset[str]:
    """Return the files in an existing folder that a new result may replace.

    Raises:
        PlanFileError: when the folder holds another kind of result, or is not empty and not a result.
    """
    manifest = read_manifest(folder)
    if manifest is not None:
        if manifest.record != record:
            raise PlanFileError(f"'{folder}' holds another result ({manifest.record}); name a new or an empty folder")
        return with_inner(folder, manifest.files)
    if not any(folder.iterdir()):
        return frozenset()
    if not (folder / record).is_file():
        other = [name for name in RECORDS if (folder / name).is_file()]
        held = f"another result ({', '.join(other)})" if other else "files that are not linkplan's"
        raise PlanFileError(f"'{folder}' holds {held}; name a new or an empty folder")
    files = earlier_files(folder, record)
    if files is None:
        raise PlanFileError(
            f"'{folder}' holds a {record} and files that are not linkplan's, without a {MANIFEST} to tell them apart;"
            " name a new or an empty folder"
        )
    return files


def earlier_files(folder: Path, record: str) -> frozenset[str] | None:
    """Return the files of a result without a manifest, or None where something in its folder is not such a result's."""
    pattern, key = _EARLIER[record]
    path = folder / record
    try:
        if path.is_symlink() or path.stat().st_size > _LARGEST_BYTES:
            return None
        said = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(said, dict) or key not in said:
        return None
    files = set()
    for name in files_in(folder):
        if not re.fullmatch(pattern, name) or (folder / name).is_symlink():
            return None
        files.add(name)
    # A folder in which there is nothing is not ours either.
    folders = {str(parent) for name in files for parent in PurePosixPath(name).parents}
    return frozenset(files) if all(_folders(folder, folders)) else None


def _folders(folder: Path, known: Iterable[str], below: str = "") -> Iterator[bool]:
    for entry in (folder / below).iterdir():
        if entry.is_dir():
            name = f"{below}/{entry.name}" if below else entry.name
            yield name in known
            yield from _folders(folder, known, name)
