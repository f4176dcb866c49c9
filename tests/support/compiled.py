"""Exported C code, compiled by gcc and called from Python; tests of it are skipped where there is no gcc."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wdouble-promotion", "-O1"]


def library(folder: Path, prefix: str, *, single: bool = False) -> ctypes.CDLL:
    """Return a folder's source file compiled without a warning, in double or float."""
    flags = [f"-D{prefix.upper()}_FLOAT"] if single else []
    target = folder / f"{'single' if single else 'double'}.so"
    words = ["gcc", *STRICT, *flags, "-shared", "-fPIC", str(folder / f"{prefix}.c"), "-lm", "-o", str(target)]
    subprocess.run(words, check=True)
    return ctypes.CDLL(str(target))


def called(function, inputs: list[np.ndarray], sizes: list[int], *, single: bool = False) -> list[np.ndarray]:
    """Return the outputs (n, size) of a C function over samples of its inputs (n, ...)."""
    dtype = np.float32 if single else np.float64
    given = [np.ascontiguousarray(x, dtype=dtype) for x in inputs]
    found = [np.full((len(given[0]), size), np.nan, dtype=dtype) for size in sizes]
    arrays = [*given, *found]
    strides = [array.strides[0] for array in arrays]
    starts = [array.ctypes.data for array in arrays]
    function.restype = None
    for k in range(len(given[0])):
        function(*[ctypes.c_void_p(start + k * stride) for start, stride in zip(starts, strides, strict=True)])
    return found


def symbols(folder: Path, prefix: str) -> str:
    """Return the names that a source file's object code calls and does not define."""
    target = folder / "object.o"
    subprocess.run(["gcc", "-std=c99", "-O2", "-c", str(folder / f"{prefix}.c"), "-o", str(target)], check=True)
    return subprocess.run(["nm", "-u", str(target)], check=True, capture_output=True, text=True).stdout
