"""The source files of a user's tracker, on which results depend, and their hash. The files are not executed."""

import ast
import contextlib
import hashlib
import importlib
import inspect
import os
import pickle
import socket
import sys
from collections.abc import Iterator, Mapping
from importlib.machinery import PathFinder
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from linkplan.models.errors import LinkplanError, ProblemError

# The entry point group of trackers in installed packages.
ENTRY_POINTS = "linkplan.trackers"
# Folders of installed packages: other modules in these folders do not belong to the tracker.
_INSTALLED = ("site-packages", "dist-packages")


def module_of(text: str) -> str:
    """Return the module of a tracker "module:object", or of an installed package's tracker with this name."""
    if ":" in text:
        return text.split(":", 1)[0]
    return entry_points(group=ENTRY_POINTS)[text].value.split(":", 1)[0]


def add_cwd_to_path() -> None:
    """Put the working folder first on Python's module search path."""
    here = os.getcwd()
    if sys.path[:1] not in ([here], [""]):
        with contextlib.suppress(ValueError):
            sys.path.remove(here)
        sys.path.insert(0, here)
    importlib.invalidate_caches()


def source_files(module: str) -> dict[str, Path]:
    """Return the files of a module by module name: its own, and imported ones from its package or folder.

    Raises:
        ProblemError: if Python does not find the module.
    """
    add_cwd_to_path()
    found: dict[str, Path] = {}
    first = _file_of(module)
    if first is None:
        raise ProblemError(f"Python does not find the module '{module}' of a tracker")
    top = module.partition(".")[0]
    folder = None if any(part in _INSTALLED for part in first.parts) else first.parent
    left = [module]
    while left:
        name = left.pop()
        path = _file_of(name)
        if name in found or path is None or not (name.partition(".")[0] == top or path.parent == folder):
            continue
        found[name] = path
        left += _imported(path, name)
    return found


def source_hash(text: str) -> str:
    """Return the hash of a tracker's source files."""
    digest = hashlib.sha256(text.encode())
    for name, path in sorted(source_files(module_of(text)).items()):
        digest.update(f"\n{name}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def object_hash(given: object) -> str:
    """Return the hash of a tracker given as an object: of its source text, its values, or its name if both are unknown.

    It detects a changed tracker when an unfinished experiment is continued, as far as Python can tell.
    """
    digest = hashlib.sha256()
    for look in (lambda: inspect.getsource(_maker_of(given)), lambda: pickle.dumps(given), lambda: repr(_maker_of(given))):
        with contextlib.suppress(Exception):  # a user's object may raise any error
            text = look()
            digest.update(text if isinstance(text, bytes) else text.encode())
    return digest.hexdigest()


def _maker_of(given: object) -> Any:
    """Return a class or function itself, or the class of an object."""
    return given if isinstance(given, type) or inspect.isroutine(given) else type(given)


def refuse_other_sources(hashes: Mapping[str, str]) -> None:
    """Refuse trackers whose source has changed since an experiment began.

    Raises:
        LinkplanError: with the name of the first changed tracker.
    """
    for text, known in hashes.items():
        if source_hash(text) != known:
            raise LinkplanError(
                f"tracker '{text}' has changed since the experiment began, or its file on {socket.gethostname()} differs"
            )


def _file_of(module: str) -> Path | None:
    """Return the file from which a module would be imported now, or None if there is none."""
    places, spec = None, None
    for depth in range(1, module.count(".") + 2):
        spec = PathFinder.find_spec(".".join(module.split(".")[:depth]), places)
        if spec is None:
            return None
        places = spec.submodule_search_locations or []
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None


def _imported(path: Path, module: str) -> Iterator[str]:
    """Yield the names of modules that a Python file may import."""
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):
        return  # the import reports the error
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parent = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parent, *([base] if base else [])])
            if base:
                yield base
                yield from (f"{base}.{alias.name}" for alias in node.names)
