"""Compiled interval functions: C made by CasADi, built by the machine's compiler, kept by the hash of what went in.

CasADi's interpreter takes about ten times as long on these functions as compiled code. The functions are small (one node,
one interval) and serve a mesh of any size, so that one compilation of a second or so serves every later solve of the same
mechanism, transcription and objective. A cached result is found before an interval's derivatives are built: the key hashes
the node's own expressions, the choices, the sources that write an interval from a node, CasADi and the compiler. Files are
moved into place whole, so that processes in parallel at worst compile the same thing twice. Where there is no compiler, the
interpreter serves.
"""

import contextlib
import functools
import hashlib
import json
import os
import shlex
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np

from linkplan.models.errors import one_line
from linkplan.planner.transcription.interval import NAMES, OPEN_END_NAMES, IntervalFunctions, IntervalRows
from linkplan.planner.transcription.schemes import Scheme
from linkplan.planner.transcription.system import System

_FLAGS = ("-O2", "-fPIC", "-shared")
# Sources beyond this many bytes (a leg of thirteen joints makes seven million) take -O2 minutes, and -O0 seconds: their
# code is then three times as fast as the interpreter's in place of ten.
_LARGE_BYTES, _LARGE_FLAGS = 2_000_000, ("-O0", "-fPIC", "-shared")
# A compiler that hangs must not hang the planner; these functions take seconds.
_TIMEOUT_S = 120
# The sources that write an interval's functions from those of a node: this room's.
_SOURCES = sorted(Path(__file__).parent.glob("*.py"))


def cache_folder() -> Path:
    """Return the folder of compiled functions: $LINKPLAN_CACHE, or linkplan in the user's cache folder."""
    own = os.environ.get("LINKPLAN_CACHE")
    if own:
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "linkplan"


@functools.cache
def compiler() -> tuple[str, ...] | None:
    """Return the command of the C compiler ($CC, cc, gcc or clang), or None where there is none."""
    wanted = os.environ.get("CC")
    for candidate in [wanted] if wanted else ["cc", "gcc", "clang"]:
        words: list[str] = []
        with contextlib.suppress(ValueError):  # quotes that do not close are no command
            words = shlex.split(candidate)
        if words and shutil.which(words[0]):
            return tuple(words)
    return None


@functools.cache
def _common_key() -> bytes:
    """Return the hash of what every compiled function depends on: sources, CasADi, the compiler and its flags."""
    digest = hashlib.sha256()
    for path in _SOURCES:
        digest.update(path.read_bytes())
    command = compiler() or ()
    version = b""
    if command:
        with contextlib.suppress(OSError, subprocess.SubprocessError):
            version = subprocess.run([*command, "--version"], capture_output=True, timeout=10, check=False).stdout
    digest.update(repr((ca.__version__, command, _FLAGS, os.uname().machine if hasattr(os, "uname") else "")).encode())
    digest.update(version)
    return digest.digest()


def key_of(system: System, chosen: Scheme, rows: IntervalRows) -> str:
    """Return the cache key of an interval's functions: a hash of the node's expressions and of what makes C of them."""
    digest = hashlib.sha256(_common_key())
    digest.update(system.node.serialize().encode())
    sizes = (system.n_s, system.n_x, system.n_z, system.n_u, system.n_equations, system.n_path, system.kinds)
    digest.update(repr((sizes, chosen.name, chosen.effort_at.tolist(), rows)).encode())
    return f"k{digest.hexdigest()[:32]}"  # a letter first: CasADi makes an identifier of it


def cached(key: str) -> IntervalFunctions | None:
    """Return the compiled functions kept under a key, or None where there are none that can be loaded."""
    folder = cache_folder()
    try:
        said = json.loads((folder / f"{key}.json").read_text(encoding="utf-8"))
        names = (*NAMES, *OPEN_END_NAMES) if said["n_open_ends"] else NAMES
        functions = dict.fromkeys(OPEN_END_NAMES) | {name: ca.external(name, str(folder / f"{key}.so")) for name in names}
        patterns = {name: tuple(np.array(part, dtype=int) for part in said.pop(name)) for name in _PATTERNS}
        return IntervalFunctions(
            **functions,
            **patterns,
            weights=np.array(said.pop("weights")),
            own_kinds=tuple(said.pop("own_kinds")),
            own_items=tuple(said.pop("own_items")),
            node_kinds=tuple(said.pop("node_kinds")),
            open_end_rows=tuple(said.pop("open_end_rows")),
            open_end_z=tuple(said.pop("open_end_z")),
            **said,
        )
    except (OSError, ValueError, KeyError, TypeError, RuntimeError):
        return None


_PATTERNS = ("jacobian_pattern", "hessian_pattern")


def compiled(key: str, build: Callable[[], IntervalFunctions]) -> IntervalFunctions:
    """Return functions from the cache, or built and compiled now, or built and interpreted where that cannot be done."""
    found = cached(key)
    if found is not None:
        return found
    functions = build()
    if compiler() is None:
        return functions
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as work:
            _compile(functions, Path(work), key)
            os.replace(Path(work) / f"{key}.so", folder / f"{key}.so")
            os.replace(Path(work) / f"{key}.json", folder / f"{key}.json")
        return replace(functions, **{name: ca.external(name, str(folder / f"{key}.so")) for name in _names(functions)})
    except (OSError, subprocess.SubprocessError, RuntimeError) as error:
        # A full disk or a broken compiler costs speed and nothing else, but it is said.
        warnings.warn(f"functions are interpreted, compiling them failed: {one_line(error)}", RuntimeWarning, stacklevel=2)
        return functions


def _names(functions: IntervalFunctions) -> tuple[str, ...]:
    return (*NAMES, *OPEN_END_NAMES) if functions.n_open_ends else NAMES


def _compile(functions: IntervalFunctions, work: Path, key: str) -> None:
    generator = ca.CodeGenerator(f"{key}.c")
    for name in _names(functions):
        generator.add(getattr(functions, name))
    generator.generate(f"{work}{os.sep}")
    flags = _FLAGS if (work / f"{key}.c").stat().st_size <= _LARGE_BYTES else _LARGE_FLAGS
    command = [*(compiler() or ()), *flags, f"{key}.c", "-o", f"{key}.so", "-lm"]
    subprocess.run(command, cwd=work, capture_output=True, timeout=_TIMEOUT_S, check=True)
    said = {name: [part.tolist() for part in getattr(functions, name)] for name in _PATTERNS}
    said |= {name: getattr(functions, name) for name in ("n_own", "n_equations", "n_path", "n_nodes", "n_open_ends")}
    said |= {
        "weights": functions.weights.tolist(),
        "own_kinds": list(functions.own_kinds),
        "own_items": list(functions.own_items),
        "node_kinds": list(functions.node_kinds),
        "open_end_rows": list(functions.open_end_rows),
        "open_end_z": list(functions.open_end_z),
    }
    (work / f"{key}.json").write_text(json.dumps(said), encoding="utf-8")
