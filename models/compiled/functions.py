"""Compiled functions: C code, the machine's compiler that builds it, and a cache that keeps the library by a key.

CasADi's interpreter is about ten times slower on long expressions than compiled code. The functions of one library are the
fields of a dataclass, whose other fields are kept with them. If it has a field `lanes`, its functions are evaluated at many
samples, and each call takes several of them (`lanes.py`); CasADi writes the code of others. The key hashes what the
functions compute and the tools that compile them (`tools_hash`), so a cached library is found before the functions are
built. Without a usable cache (`cache.py`) or a compiler, the functions are interpreted.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import shlex
import shutil
import signal
import subprocess
import warnings
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import casadi as ca
import numpy as np

from linkplan.models.compiled.cache import (
    evict,
    find_entry,
    keep_entry,
    mark_used,
    trusted_folder,
    wanted_again,
)  # fmt: skip
from linkplan.models.compiled.lanes import N_LANES, in_lanes
from linkplan.models.deadline import NO_DEADLINE, Deadline, waiting_for_child
from linkplan.models.errors import one_line
from linkplan.models.work_folders import sweep, work_folder

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def on_arrays(function: ca.Function, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray]) -> Callable[[], None]:
    """Return a call that evaluates a function from the values in some arrays, and writes its outputs to others.

    Args:
        function: to evaluate.
        inputs: contiguous arrays of floats with the nonzeros of each input, in column order; the call keeps them alive.
        outputs: the same for the first outputs.
    """
    buffer, evaluate = function.buffer()
    for put, arrays in ((buffer.set_arg, inputs), (buffer.set_res, outputs)):
        for k, array in enumerate(arrays):
            if array.size:
                put(k, memoryview(array))  # pyright: ignore[reportCallIssue, reportArgumentType]  a memoryview has its size

    def call(kept: object = (function, buffer, inputs, outputs)) -> None:  # CasADi keeps addresses only
        del kept
        evaluate()

    return call


def evaluated(function: ca.Function, *arguments: np.ndarray, outputs: int | None = None) -> list[np.ndarray]:
    """Return a function's first outputs (all by default), each (rows, columns); inputs and outputs are dense."""
    given = [np.asarray(a, dtype=float).ravel(order="F") for a in arguments]
    found = [np.empty(function.numel_out(k)) for k in range(function.n_out() if outputs is None else outputs)]
    on_arrays(function, given, found)()
    return [array.reshape(function.size_out(k), order="F") for k, array in enumerate(found)]


@functools.lru_cache(maxsize=64)
def mapped(function: ca.Function, n: int) -> ca.Function:
    """Return a function mapped over n samples, cached because motions on the same mesh need the same ones."""
    return function if n == 1 else function.map(n)


def over_columns(function: ca.Function, lanes: int, n: int) -> Callable:
    """Return a call of a function at n samples; its inputs and outputs stack the samples' columns side by side.

    Args:
        function: of as many samples as `lanes`.
        lanes: 1, or `N_LANES`; the last sample is repeated where n is no multiple.
        n: the number of samples.
    """
    calls = -(-n // lanes)
    mapped, missing = function.map(calls), calls * lanes - n

    def call(*arguments: ca.MX) -> ca.MX | tuple[ca.MX, ...]:
        if not missing:
            return mapped(*arguments)
        found = mapped(*(ca.horzcat(x, ca.repmat(x[:, x.shape[1] - x.shape[1] // n :], 1, missing)) for x in arguments))
        cut = [x[:, : x.shape[1] // (calls * lanes) * n] for x in (found if isinstance(found, tuple) else (found,))]
        return cut[0] if len(cut) == 1 else tuple(cut)

    return call


# The functions of one library.
CodeT = TypeVar("CodeT", bound="DataclassInstance")
# -O1 compiles in half the time of -O2, and its straight-line code is as fast. Products and sums are not fused, so compiled
# functions give exactly the interpreter's numbers, and a plan does not depend on the state of the cache.
_FLAGS = ("-O1", "-ffp-contract=off", "-fPIC", "-shared")
# Larger sources of straight-line code take seconds to minutes with optimisation, and a fifth of that with -O0.
_LARGE_BYTES, _LARGE_FLAGS = 90_000, ("-O0", "-ffp-contract=off", "-fPIC", "-shared")
# Time after which a hanging compiler is ended; these functions compile in seconds.
_COMPILER_TIMEOUT_S = 120.0
# Functions with more instructions do not compile within that time: CasADi writes three million in 27 s.
_MAX_INSTRUCTIONS = 2_000_000
# The sources that write the C code: this package.
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
def tools_hash(folder: Path) -> bytes:
    """Return a hash of what compiled functions depend on: CasADi, the compiler and its flags, and the sources.

    The sources are those that write C and those of `folder`, which determine the expressions.
    """
    digest = hashlib.sha256()
    for path in (*_SOURCES, *sorted(folder.glob("*.py"))):
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


def cached(key: str, kind: type[CodeT]) -> CodeT | None:
    """Return the compiled functions kept under a key, or None if they are missing or cannot be loaded."""
    try:
        folder = trusted_folder(make=False)
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
    return _opened(library, record, kind)


def _opened(library: Path, record: dict, kind: type[CodeT]) -> CodeT:
    """Return the functions of a library with the entries of its record."""
    functions = {name: ca.external(name, str(library)) for name in record["functions"]}
    return kind(**functions, **{name: value for name, value in record.items() if name != "functions"})


def compiled(key: str, kind: type[CodeT], build: Callable[[], CodeT], deadline: Deadline = NO_DEADLINE) -> CodeT:
    """Return functions from the cache or compile them; if that fails, return interpreted functions.

    The compiler may use half of the time until `deadline`.
    """
    found = cached(key, kind)
    if found is not None:
        return found
    functions = build()
    left = 0.5 * deadline.left_s
    length = sum(getattr(functions, name).n_instructions() for name in _names(functions))
    if compiler() is None or left <= 0 or length > _MAX_INSTRUCTIONS:
        return functions
    try:
        folder = trusted_folder(make=True)
        sweep(folder)
        with work_folder(folder) as work:
            record, command = _written(functions, work, key)
            with waiting_for_child():
                run_with_children(command, work, min(_COMPILER_TIMEOUT_S, left))
            library = keep_entry(work / f"{key}.so", record, folder, key)
        evict(folder, key)
        return _opened(library, record, kind)
    except (OSError, subprocess.SubprocessError, RuntimeError) as error:
        if isinstance(error, subprocess.TimeoutExpired) and left < _COMPILER_TIMEOUT_S:  # the deadline ended it
            return functions
        # A full disk or a broken compiler makes the functions slower but not wrong.
        why = one_line(error)
        if isinstance(error, subprocess.CalledProcessError):
            why = f"'{error.cmd[0]}' returned {error.returncode}; the variable CC names another compiler"
        warnings.warn(f"functions are interpreted, compiling them failed: {why}", RuntimeWarning, stacklevel=2)
        return functions


def compiled_as_asked(
    key: str, kind: type[CodeT], build: Callable[[], CodeT], mode: str, deadline: Deadline = NO_DEADLINE
) -> CodeT:
    """Return functions compiled as a mode asks for: "always", "never", or "auto".

    "auto" takes them from the cache, or interpreted at the first wish and compiled at the second: functions that are used
    once are not worth compiling.
    """
    found = None if mode == "never" else cached(key, kind)
    if found is not None:
        return found
    if mode == "always" or (mode == "auto" and _wanted_again(key)):
        return compiled(key, kind, build, deadline)
    return build()


def _wanted_again(key: str) -> bool:
    """Leave a mark of a key in the cache; return True if there was one."""
    with contextlib.suppress(OSError):
        return compiler() is not None and wanted_again(trusted_folder(make=True), key)
    return False


def _names(functions: DataclassInstance) -> tuple[str, ...]:
    return tuple(field.name for field in fields(functions) if isinstance(getattr(functions, field.name), ca.Function))


def run_with_children(command: list[str], work: Path, timeout_s: float) -> None:
    """Run a program in a folder; kill it with its children when it exceeds the timeout or is interrupted.

    Raises:
        OSError: when it cannot be started.
        subprocess.SubprocessError: when it fails or exceeds the timeout.
    """
    nothing = subprocess.DEVNULL
    with subprocess.Popen(
        command, cwd=work, stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True
    ) as process:
        try:
            code = process.wait(timeout_s)
        except BaseException:
            with contextlib.suppress(OSError):
                if hasattr(os, "killpg"):
                    os.killpg(process.pid, signal.SIGKILL)
                else:
                    process.kill()
            raise
    if code:
        raise subprocess.CalledProcessError(code, command)


def _written(functions: DataclassInstance, work: Path, key: str) -> tuple[dict, list[str]]:
    """Write the functions as C into a folder; return their record for the cache and the command that compiles them."""
    names, flags = _names(functions), _FLAGS
    code = in_lanes([getattr(functions, name) for name in names]) if hasattr(functions, "lanes") else None
    if code is not None:
        (work / f"{key}.c").write_text(code, encoding="ascii")
        functions = replace(functions, lanes=N_LANES)
    else:
        generator = ca.CodeGenerator(f"{key}.c")
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
