"""What a user's own tracker is written in: the files that results depend on, and their hash. Nothing is run to find them."""

import ast
import contextlib
import hashlib
import importlib
import os
import socket
import sys
from collections.abc import Iterator, Mapping
from importlib.machinery import PathFinder
from importlib.metadata import entry_points
from pathlib import Path

from linkplan.models.errors import LinkplanError, ProblemError

# Where installed packages say what trackers they have.
ENTRY_POINTS = "linkplan.trackers"
# Folders of installed packages: what stands beside a module there is somebody else's.
_INSTALLED = ("site-packages", "dist-packages")


def module_of(text: str) -> str:
    """Return the module of a tracker "module:object", or of an installed package's tracker of that name."""
    if ":" in text:
        return text.split(":", 1)[0]
    return entry_points(group=ENTRY_POINTS)[text].value.split(":", 1)[0]


def look_here() -> None:
    """Let modules be looked for in the working folder first."""
    here = os.getcwd()
    if sys.path[:1] not in ([here], [""]):
        with contextlib.suppress(ValueError):
            sys.path.remove(here)
        sys.path.insert(0, here)
    importlib.invalidate_caches()


def source_files(module: str) -> dict[str, Path]:
    """Return the files of a module by name: its own, and those of its package or beside it that it imports.

    Raises:
        ProblemError: when there is no such module.
    """
    look_here()
    found: dict[str, Path] = {}
    first = _file_of(module)
    if first is None:
        raise ProblemError(f"module '{module}' of a tracker is no file that Python finds")
    top = module.partition(".")[0]
    beside = None if any(part in _INSTALLED for part in first.parts) else first.parent
    left = [module]
    while left:
        name = left.pop()
        path = _file_of(name)
        if name in found or path is None or not (name.partition(".")[0] == top or path.parent == beside):
            continue
        found[name] = path
        left += _imported(path, name)
    return found


def source_hash(text: str) -> str:
    """Return the hash of all that a tracker is written in."""
    digest = hashlib.sha256(text.encode())
    for name, path in sorted(source_files(module_of(text)).items()):
        digest.update(f"\n{name}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def refuse_other_sources(hashes: Mapping[str, str]) -> None:
    """Refuse to go on where a tracker is not written as it was when an experiment began.

    Raises:
        LinkplanError: naming the first that is not.
    """
    for text, known in hashes.items():
        if source_hash(text) != known:
            raise LinkplanError(
                f"tracker '{text}' has changed since the experiment began, or is another on {socket.gethostname()}"
            )


def _file_of(module: str) -> Path | None:
    """Return where a module would be loaded from now, whatever is loaded under its name; None where it is no file."""
    places, spec = None, None
    for depth in range(1, module.count(".") + 2):
        spec = PathFinder.find_spec(".".join(module.split(".")[:depth]), places)
        if spec is None:
            return None
        places = spec.submodule_search_locations or []
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None


def _imported(path: Path, module: str) -> Iterator[str]:
    """Yield the names of modules that a file may import; none of one that is no Python text."""
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):
        return  # loading it will say why
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
