"""Compiled interval functions: C made by CasADi, built by the machine's compiler, kept by the hash of what went in.

CasADi's interpreter takes about ten times as long on these functions as compiled code. The functions are small (one node,
one interval) and serve a mesh of any size. They are two libraries: the node's, which hang on the structure of mechanism and
objective, on none of their numbers (`numbers.py`) and on no transcription, and the chain rule's, which hang on the
transcription and on no mechanism. So one compilation of half a second serves every later solve of mechanisms of one
structure, whatever their lengths and masses, and another one every mechanism of the same sizes. A cached result is
found before derivatives are built: the key hashes the node's own expressions, or the sizes, the sources that write C from
them, CasADi and the compiler. Where the cache (`cache.py`) cannot be used, or there is no compiler, the interpreter serves.
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
    evict,
    find,
    handed_over,
    keep,
    sweep,
    trusted_folder,
    used,
    wanted_again,
    work_folder,
)  # fmt: skip
from linkplan.planner.transcription.finish_compiling import run_with_children
from linkplan.planner.transcription.interval import ChainFunctions, IntervalRows, open_end_path
from linkplan.planner.transcription.node import NodeFunctions
from linkplan.planner.transcription.schemes import Scheme
from linkplan.planner.transcription.system import System

# What is kept in one library: a node's functions, or the chain rule's.
Code = NodeFunctions | ChainFunctions
CodeT = TypeVar("CodeT", NodeFunctions, ChainFunctions)
# -O1 takes half of -O2's time, and its straight-line code is as fast. Products and sums are not fused: compiled functions
# give the interpreter's numbers to the last bit, and a plan does not hang on what is in the cache.
_FLAGS = ("-O1", "-ffp-contract=off", "-fPIC", "-shared")
# Sources beyond this many bytes (a leg of thirteen joints makes seven million) take -O2 minutes, and -O0 seconds: their
# code is then three times as fast as the interpreter's in place of ten.
_LARGE_BYTES, _LARGE_FLAGS = 2_000_000, ("-O0", "-ffp-contract=off", "-fPIC", "-shared")
# A compiler that hangs must not hang the planner; these functions take seconds.
_TIMEOUT_S = 120.0
# ... in which none ends functions of more instructions: to write three million takes 27 s.
_ENDLESS = 2_000_000
# The share of the time left until a deadline that compiling may take: what it does not finish in, the interpreter serves.
_SHARE_OF_TIME = 0.5
# The sources that write an interval's functions from those of a node: this room's.
_SOURCES = sorted(Path(__file__).parent.glob("*.py"))


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
    digest.update(repr((ca.__version__, command, _FLAGS, os.uname().machine if hasattr(os, "uname") else "")).encode())
    for word in command:  # another version is another file: to ask it takes a process
        with contextlib.suppress(OSError):
            program = Path(shutil.which(word) or "").resolve()
            if program.is_file():
                found = program.stat()
                digest.update(repr((str(program), found.st_size, found.st_mtime_ns)).encode())
    return digest.digest()


@functools.lru_cache(maxsize=32)
def node_key(system: System, at_open_ends: tuple[int, ...] = ()) -> str:
    """Return the cache key of a node's functions: a hash of its expressions and of what makes C of them."""
    digest = hashlib.sha256(_common_key())
    digest.update(system.node.serialize().encode())
    digest.update(repr(("node", *_sizes(system), system.n_theta, system.kinds, at_open_ends)).encode())
    return f"k{digest.hexdigest()[:32]}"  # a letter first: CasADi makes an identifier of it


def chain_key(system: System, scheme: Scheme, rows: IntervalRows, node: NodeFunctions) -> str:
    """Return the cache key of the chain rule's functions: a hash of sizes, patterns and constants, and of no expression."""
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
    """Return the compiled functions of a kind kept under a key, or None where there are none that can be loaded."""
    try:
        folder = trusted_folder(make=False)
        sweep(folder)
        found = (folder / f"{key}.so").stat()
        return _loaded(folder, key, kind, (found.st_ino, found.st_size, found.st_mtime_ns))
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, AttributeError):
        return None


@functools.lru_cache(maxsize=64)
def _loaded(folder: Path, key: str, kind: type[CodeT], file: tuple[int, ...]) -> CodeT | None:
    """Return the functions of a library, loaded once for as long as its file is the same one."""
    del file
    entry = find(folder, key)
    if entry is None:
        return None
    used(folder, key)
    library, said = entry
    functions = {name: ca.external(name, str(library)) for name in said.pop("functions")}
    return kind(**functions, **said)


def compiled(key: str, kind: type[CodeT], build: Callable[[], CodeT], deadline: Deadline = NO_DEADLINE) -> CodeT:
    """Return functions from the cache, or built and compiled now, or built and interpreted where that cannot be done.

    The compiler has a share of the time left until a `deadline`, and is ended then.
    """
    found = cached(key, kind)
    if found is not None:
        return found
    functions = build()
    left = _SHARE_OF_TIME * deadline.left_s
    if compiler() is None or left <= 0 or _is_endless(functions):
        return functions
    try:
        folder = trusted_folder(make=True)
        with work_folder(folder) as work:
            said, command = _written(functions, work, key)
            _run(command, work, min(_TIMEOUT_S, left))
            library = keep(work / f"{key}.so", said, folder, key)
        evict(folder, key)
        return replace(functions, **{name: ca.external(name, str(library)) for name in _names(functions)})
    except (OSError, subprocess.SubprocessError, RuntimeError) as error:
        if isinstance(error, subprocess.TimeoutExpired) and left < _TIMEOUT_S:  # as was asked
            return functions
        # A full disk or a broken compiler costs speed and nothing else, but it is said.
        warnings.warn(f"functions are interpreted, compiling them failed: {one_line(error)}", RuntimeWarning, stacklevel=2)
        return functions


def _names(functions: Code) -> tuple[str, ...]:
    return tuple(field.name for field in fields(functions) if isinstance(getattr(functions, field.name), ca.Function))


class _LeftAlone(subprocess.Popen):
    """A process that nobody waits for: Python collects it when it begins another, and warns of none that is at work."""

    def __del__(self) -> None:
        super().__del__(_warn=lambda *_, **__: None)


def compile_beside(key: str, functions: Code) -> subprocess.Popen | None:
    """Have functions compiled by a process of its own, once they were wanted before; return it, for nobody to wait for.

    What is wanted once is worth no compilation: the first time leaves a mark in the cache, a later one, in this process or
    another, begins the work. A full disk, or no compiler, costs nothing but that.
    """
    if compiler() is None or _is_endless(functions):
        return None
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        folder = trusted_folder(make=True)
        if not wanted_again(folder, key):
            return None
        work, lock = handed_over(folder)
        try:
            said, command = _written(functions, work, key)
            (work / f"{key}.said").write_text(json.dumps(said), encoding="utf-8")
            # -P: nothing in the folder where the planner runs is imported.
            finish = [sys.executable, "-P", "-m", "linkplan.planner.transcription.finish_compiling"]
            nothing, passed = subprocess.DEVNULL, () if lock is None else (lock,)
            # Its own session: an interrupt that ends the planner does not end it. It holds the folder's lock.
            return _LeftAlone(
                [*finish, str(folder), str(work), key, str(_TIMEOUT_S), *command],
                stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True, pass_fds=passed,
            )  # fmt: skip
        finally:
            if lock is not None:
                os.close(lock)
    return None


def _is_endless(functions: Code) -> bool:
    """Return whether no compiler ends functions in the time that it has."""
    return sum(getattr(functions, name).n_instructions() for name in _names(functions)) > _ENDLESS


def _written(functions: Code, work: Path, key: str) -> tuple[dict, list[str]]:
    """Write functions' C into a folder; return what else there is to know of them, and the command that compiles it."""
    generator, names = ca.CodeGenerator(f"{key}.c"), _names(functions)
    for name in names:
        generator.add(getattr(functions, name))
    generator.generate(f"{work}{os.sep}")
    flags = _FLAGS if (work / f"{key}.c").stat().st_size <= _LARGE_BYTES else _LARGE_FLAGS
    command = [*(compiler() or ()), *flags, f"{key}.c", "-o", f"{key}.so", "-lm"]
    said: dict[str, object] = {"functions": list(names)}
    for field in fields(functions):
        value = getattr(functions, field.name)
        if field.name.endswith("pattern"):
            said[field.name] = [part.tolist() for part in value]
        elif field.name not in names and value is not None:
            said[field.name] = value
    return said, command


def _run(command: list[str], work: Path, timeout_s: float) -> None:
    """Run a compiler in a folder; as of `run_with_children`.

    Raises:
        OSError: where it cannot be started.
        subprocess.SubprocessError: where it fails, or takes too long.
    """
    with waiting_for_child():
        run_with_children(command, work, timeout_s)
