"""Compiled interval functions: CasADi writes C, the machine's compiler builds it, and a cache keeps the library by a hash.

CasADi's interpreter is about ten times slower on these functions than compiled code. The functions are small (one node, one
interval) and serve a mesh of any size. They form two libraries. The node's functions depend only on the structure of the
mechanism and the objective, not on their numbers (`numbers.py`) or the transcription. The chain rule's functions depend on
the transcription and the sizes alone. One compilation of half a second therefore serves every later solve of mechanisms of
one structure, whatever their lengths and masses. A cached library is found before derivatives are built, because the key
hashes only the node's expressions or the sizes, the sources that write C, CasADi and the compiler. Without a usable cache
(`cache.py`) or a compiler, the functions are interpreted.
"""

import contextlib
import functools
import hashlib
import json
import os
import shlex
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import TypeVar

import casadi as ca

from linkplan.models.deadline import NO_DEADLINE, Deadline, waiting_for_child
from linkplan.models.errors import one_line
from linkplan.planner.transcription.cache import (
    detached_work_folder,
    evict,
    find_entry,
    keep_entry,
    mark_used,
    sweep,
    trusted_folder,
    wanted_again,
    work_folder,
)  # fmt: skip
from linkplan.planner.transcription.finish_compiling import run_with_children
from linkplan.planner.transcription.interval import ChainFunctions, IntervalRows, open_end_path
from linkplan.planner.transcription.node import NodeFunctions
from linkplan.planner.transcription.schemes import Scheme
from linkplan.planner.transcription.system import System

# The functions of one library.
Code = NodeFunctions | ChainFunctions
CodeT = TypeVar("CodeT", NodeFunctions, ChainFunctions)
# -O1 compiles in half the time of -O2, and its straight-line code is as fast. Products and sums are not fused, so compiled
# functions give exactly the interpreter's numbers, and a plan does not depend on the state of the cache.
_FLAGS = ("-O1", "-ffp-contract=off", "-fPIC", "-shared")
# Larger sources (a leg of thirteen joints has seven million bytes) take minutes with optimisation and seconds with -O0.
# Their code is then three times as fast as the interpreter's instead of ten.
_LARGE_BYTES, _LARGE_FLAGS = 2_000_000, ("-O0", "-ffp-contract=off", "-fPIC", "-shared")
# Time after which a hanging compiler is ended; these functions compile in seconds.
_COMPILER_TIMEOUT_S = 120.0
# Functions with more instructions do not compile within that time: writing three million takes 27 s.
_MAX_INSTRUCTIONS = 2_000_000
# The sources that determine the compiled code: this package.
_SOURCES = sorted(Path(__file__).parent.glob("*.py"))


@functools.cache
def compiler() -> tuple[str, ...] | None:
    """Return the command of the C compiler ($CC, cc, gcc or clang), or None if no compiler is installed."""
    wanted = os.environ.get("CC")
    for candidate in [wanted] if wanted else ["cc", "gcc", "clang"]:
        words: list[str] = []
        with contextlib.suppress(ValueError):  # unclosed quotes
            words = shlex.split(candidate)
        if words and shutil.which(words[0]):
            return tuple(words)
    return None


@functools.cache
def _common_key() -> bytes:
    """Return a hash of everything that all compiled functions depend on: sources, CasADi, the compiler and its flags."""
    digest = hashlib.sha256()
    for path in _SOURCES:
        digest.update(path.read_bytes())
    command = compiler() or ()
    digest.update(repr((ca.__version__, command, _FLAGS, os.uname().machine if hasattr(os, "uname") else "")).encode())
    for word in command:  # the compiler's file identifies its version without starting a process
        with contextlib.suppress(OSError):
            program = Path(shutil.which(word) or "").resolve()
            if program.is_file():
                found = program.stat()
                digest.update(repr((str(program), found.st_size, found.st_mtime_ns)).encode())
    return digest.digest()


@functools.lru_cache(maxsize=32)
def node_key(system: System, at_open_ends: tuple[int, ...] = ()) -> str:
    """Return the cache key of a node's functions: a hash of its expressions and of the tools that compile them."""
    digest = hashlib.sha256(_common_key())
    digest.update(system.node.serialize().encode())
    digest.update(repr(("node", *_sizes(system), system.n_theta, system.kinds, at_open_ends)).encode())
    return f"k{digest.hexdigest()[:32]}"  # begins with a letter, because CasADi makes an identifier of it


def chain_key(system: System, scheme: Scheme, rows: IntervalRows, node: NodeFunctions) -> str:
    """Return the cache key of the chain rule's functions: a hash of sizes, patterns and constants, without expressions."""
    digest = hashlib.sha256(_common_key())
    digest.update(repr(("chain", *_sizes(system), rows, open_end_path(scheme, rows))).encode())
    digest.update(repr((node.open_end_rows, node.open_end_z, scheme.name, scheme.effort_at.tolist())).encode())
    for field in fields(NodeFunctions):
        if field.name.endswith("pattern"):
            digest.update(repr([part.tolist() for part in getattr(node, field.name)]).encode())
    return f"k{digest.hexdigest()[:32]}"


def _sizes(system: System) -> tuple[int, ...]:
    return (system.n_s, system.n_x, system.n_z, system.n_u, system.n_equations, system.n_path)


def cached(key: str, kind: type[CodeT]) -> CodeT | None:
    """Return the compiled functions kept under a key, or None if they are missing or cannot be loaded."""
    try:
        folder = trusted_folder(make=False)
        sweep(folder)
        found = (folder / f"{key}.so").stat()
        return _loaded(folder, key, kind, (found.st_ino, found.st_size, found.st_mtime_ns))
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, AttributeError):
        return None


@functools.lru_cache(maxsize=64)
def _loaded(folder: Path, key: str, kind: type[CodeT], file: tuple[int, ...]) -> CodeT | None:
    """Return the functions of a library, loaded once as long as its file is unchanged."""
    del file
    entry = find_entry(folder, key)
    if entry is None:
        return None
    mark_used(folder, key)
    library, record = entry
    functions = {name: ca.external(name, str(library)) for name in record.pop("functions")}
    return kind(**functions, **record)


def compiled(key: str, kind: type[CodeT], build: Callable[[], CodeT], deadline: Deadline = NO_DEADLINE) -> CodeT:
    """Return functions from the cache or compile them; if that fails, return interpreted functions.

    The compiler may use half of the time until `deadline`.
    """
    found = cached(key, kind)
    if found is not None:
        return found
    functions = build()
    left = 0.5 * deadline.left_s
    if compiler() is None or left <= 0 or _is_endless(functions):
        return functions
    try:
        folder = trusted_folder(make=True)
        with work_folder(folder) as work:
            record, command = _written(functions, work, key)
            with waiting_for_child():
                run_with_children(command, work, min(_COMPILER_TIMEOUT_S, left))
            library = keep_entry(work / f"{key}.so", record, folder, key)
        evict(folder, key)
        return replace(functions, **{name: ca.external(name, str(library)) for name in _names(functions)})
    except (OSError, subprocess.SubprocessError, RuntimeError) as error:
        if isinstance(error, subprocess.TimeoutExpired) and left < _COMPILER_TIMEOUT_S:  # the deadline ended it
            return functions
        # A full disk or a broken compiler makes the functions slower but not wrong.
        warnings.warn(f"functions are interpreted, compiling them failed: {one_line(error)}", RuntimeWarning, stacklevel=2)
        return functions


def _names(functions: Code) -> tuple[str, ...]:
    return tuple(field.name for field in fields(functions) if isinstance(getattr(functions, field.name), ca.Function))


class _DetachedProcess(subprocess.Popen):
    """A process that nobody waits for: deleting the object while it runs gives no warning."""

    def __del__(self) -> None:
        super().__del__(_warn=lambda *_, **__: None)


def compile_in_background(key: str, functions: Code) -> subprocess.Popen | None:
    """Compile functions in a separate process if they were wanted before; return the process.

    The first request only leaves a mark in the cache, because functions that are used once are not worth compiling. A later
    request, in this process or another, starts the compilation. Without a compiler or disk space nothing happens.
    """
    if compiler() is None or _is_endless(functions):
        return None
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        folder = trusted_folder(make=True)
        if not wanted_again(folder, key):
            return None
        work, lock = detached_work_folder(folder)
        try:
            record, command = _written(functions, work, key)
            (work / f"{key}.record").write_text(json.dumps(record), encoding="utf-8")
            # -P: Python does not import from the current folder.
            finish = [sys.executable, "-P", "-m", "linkplan.planner.transcription.finish_compiling"]
            nothing, passed = subprocess.DEVNULL, () if lock is None else (lock,)
            # A new session: an interrupt of the planner does not end it. It inherits the lock of the work folder.
            return _DetachedProcess(
                [*finish, str(folder), str(work), key, str(_COMPILER_TIMEOUT_S), *command],
                stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True, pass_fds=passed,
            )  # fmt: skip
        finally:
            if lock is not None:
                os.close(lock)
    return None


def _is_endless(functions: Code) -> bool:
    """Check whether functions are too long to compile within the timeout."""
    return sum(getattr(functions, name).n_instructions() for name in _names(functions)) > _MAX_INSTRUCTIONS


def _written(functions: Code, work: Path, key: str) -> tuple[dict, list[str]]:
    """Write the functions as C into a folder; return their record for the cache and the command that compiles them."""
    generator, names = ca.CodeGenerator(f"{key}.c"), _names(functions)
    for name in names:
        generator.add(getattr(functions, name))
    generator.generate(f"{work}{os.sep}")
    flags = _FLAGS if (work / f"{key}.c").stat().st_size <= _LARGE_BYTES else _LARGE_FLAGS
    command = [*(compiler() or ()), *flags, f"{key}.c", "-o", f"{key}.so", "-lm"]
    record: dict[str, object] = {"functions": list(names)}
    for field in fields(functions):
        value = getattr(functions, field.name)
        if field.name.endswith("pattern"):
            record[field.name] = [part.tolist() for part in value]
        elif field.name not in names and value is not None:
            record[field.name] = value
    return record, command
