"""A mechanism's C code as a folder, with its cost: operations, error in float and, if compilers exist, flash and stack."""

import re
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import casadi as ca
import numpy as np
from msgspec import Struct

from linkplan.studies.handover.export.c_model import (
    DERIVATIVES,
    MAX_NEWTON_STEPS,
    ModelCode,
    header_text,
    random_states,
    source_text,
    test_text,
)
from linkplan.studies.handover.export.c_text import write_texts
from linkplan.studies.handover.export.exported import Exported
from linkplan.studies.output.document import Block, Text, table_of

_BINARY: dict[int, Callable] = {
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_FMIN: np.minimum,
    ca.OP_FMAX: np.maximum,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_HYPOT: np.hypot,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_LT: np.less,
    ca.OP_LE: np.less_equal,
    ca.OP_EQ: np.equal,
    ca.OP_NE: np.not_equal,
    ca.OP_AND: np.logical_and,
    ca.OP_OR: np.logical_or,
    ca.OP_IF_ELSE_ZERO: lambda condition, x: np.where(condition != 0, x, np.float32(0)),
}
_UNARY: dict[int, Callable] = {
    ca.OP_ASSIGN: np.array,
    ca.OP_NEG: np.negative,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda x: x + x,
    ca.OP_INV: lambda x: np.float32(1) / x,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_TANH: np.tanh,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_NOT: np.logical_not,
}
_KINDS = {
    ca.OP_ADD: "additions", ca.OP_SUB: "additions", ca.OP_NEG: "additions", ca.OP_TWICE: "additions",
    ca.OP_MUL: "multiplications", ca.OP_SQ: "multiplications", ca.OP_DIV: "divisions", ca.OP_INV: "divisions",
    ca.OP_SQRT: "square roots", ca.OP_SIN: "sines and cosines", ca.OP_COS: "sines and cosines",
}  # fmt: skip
_MOVES = (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_ASSIGN)


def operations(function: ca.Function) -> dict[str, int]:
    """Return the number of operations by kind."""
    ids = [function.instruction_id(k) for k in range(function.n_instructions())]
    return dict(Counter(_KINDS.get(op, "other") for op in ids if op not in _MOVES))


def in_single_precision(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    """Return the outputs (n, numel) of a function over samples (n, numel) in float32, operation by operation."""
    given = [np.asarray(a, dtype=np.float32) for a in arguments]
    n = len(given[0])
    work: list = [None] * function.sz_w()
    found = [np.zeros((n, function.numel_out(k)), dtype=np.float32) for k in range(function.n_out())]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for k in range(function.n_instructions()):
            op, into, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
            if op == ca.OP_CONST:
                work[into[0]] = np.full(n, function.instruction_constant(k), dtype=np.float32)
            elif op == ca.OP_INPUT:
                work[into[0]] = given[of[0]][:, of[1]]
            elif op == ca.OP_OUTPUT:
                found[into[0]][:, into[1]] = work[of[0]]
            elif op in _UNARY:
                work[into[0]] = _UNARY[op](work[of[0]]).astype(np.float32)
            else:
                work[into[0]] = _BINARY[op](work[of[0]], work[of[1]]).astype(np.float32)
    return found


# Number of states at which the error of single precision is measured, and the factor from the measured to the stated error.
_FLOAT_STATES, _FLOAT_MARGIN = 2000, 4.0
# The compilers (names and options) for measuring flash and stack, if they are installed.
COMPILERS = {
    "gcc": ["-O2"],
    "arm-none-eabi-gcc": ["-O2", "-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"],
}
# A compiler needs a second for a linkage, ten for the 30,000 operations of two legs, and minutes for a whole robot. Longer
# code is measured only on request. If only the derivatives make it longer, it is measured without them.
_COMPILE_SECONDS, MOST_MEASURED_OPERATIONS = 120, 8_000


class FunctionCost(Struct, frozen=True, kw_only=True):
    """Operations of one call by kind, and the bound on its error in float as a share of its largest value, or None."""

    function: str
    operations: dict[str, int]
    float_error: float | None


class ObjectSize(Struct, frozen=True, kw_only=True):
    """Flash, RAM and largest stack frame of one compiler's object code, for "double" or "float" numbers."""

    compiler: str
    real: str
    flash_bytes: int
    ram_bytes: int
    stack_bytes: int


class ModelRecord(Exported, frozen=True, kw_only=True):
    """The record of a model in C. `sizes` is empty if nothing was measured; it may exclude some functions."""

    mechanism: str
    format: str = "c"
    files: list[str]
    model_hash: str
    max_newton_steps: int
    functions: list[FunctionCost]
    sizes: list[ObjectSize]
    sizes_without: list[str]

    def blocks(self) -> list[Block]:
        """Return the record of the files in a folder as a document's blocks."""
        kinds = list(dict.fromkeys(kind for row in self.functions for kind in row.operations))
        rows = [[row.function, *(row.operations.get(kind, 0) for kind in kinds), row.float_error] for row in self.functions]
        heads = ["operations of one call", *kinds, "error in float, share of the largest value"]
        written = Text(text=f"{self.path}: {', '.join(self.files)}", tone="good")
        return [written, table_of("", heads, rows, digits=2), *size_blocks(self.sizes, self.sizes_without)]


def costs(code: ModelCode) -> list[FunctionCost]:
    """Return each function's operations by kind, and the bound on its error in float as a share of its largest value.

    Functions of more than 10,000 operations are evaluated at fewer states, at least at a quarter of them.
    """
    every = random_states(code.mechanism, _FLOAT_STATES, seed=2)
    found = []
    for one in code.interface:
        n = int(_FLOAT_STATES * np.clip(1e4 / max(1, one.function.n_instructions()), 0.25, 1.0))
        states = {name: values[:n] for name, values in every.items()}
        rounded = in_single_precision(one.function, *[states[name] for name in one.inputs])
        worst = 0.0
        for single, wanted in zip(rounded, one.values(states), strict=True):
            worst = max(worst, float(np.abs(single - wanted).max(initial=0.0) / (np.abs(wanted).max(initial=0.0) or 1.0)))
        error = _FLOAT_MARGIN * worst
        found.append(FunctionCost(function=one.name, operations=operations(one.function), float_error=error))
    for one in code.inner:
        name = f"{one.name} (in close)"
        found.append(FunctionCost(function=name, operations=operations(one.function), float_error=None))
    return found


def write_model(code: ModelCode, place: Path, *, compiled: bool | None = None) -> ModelRecord:
    """Write header, source, test and CMake file into a folder, and return the cost of the code.

    `compiled` says whether sizes are measured; by default those of code that compiles within seconds.
    """
    cost = costs(code)
    lengths = {row.function: sum(row.operations.values()) for row in cost}
    whole = compiled or sum(lengths.values()) <= MOST_MEASURED_OPERATIONS
    if compiled is None:
        compiled = sum(lengths.values()) - lengths[f"{code.prefix}_{DERIVATIVES}"] <= MOST_MEASURED_OPERATIONS
    flags = [] if whole else [f"-D{code.prefix.upper()}_WITHOUT_DERIVATIVES"]
    lines = [
        "Operations of a call, and the bound on the error in float (share of the largest value, at 500 to 2000 states):"
    ]
    for row in cost:
        said = ", ".join(f"{n} {kind}" for kind, n in row.operations.items()) or "none"
        error = "" if row.float_error is None else f"; float {row.float_error:.1e}"
        lines.append(f"  {row.function}: {said}{error}")
    files = write_texts(place, code.prefix, header_text(code, lines), source_text(code), test_text(code))
    return ModelRecord(
        mechanism=code.mechanism.name,
        files=files,
        model_hash=code.mechanism.fingerprint(),
        max_newton_steps=MAX_NEWTON_STEPS,
        functions=cost,
        sizes=sizes(place, f"{code.prefix}.c", code.prefix.upper(), flags) if compiled else [],
        sizes_without=[] if whole else [f"{code.prefix}_{DERIVATIVES}"],
    )


def sizes(place: Path, source: str, upper: str, flags: Sequence[str] = ()) -> list[ObjectSize]:
    """Return flash and largest stack frame [bytes] of a source file, by compiler and precision; empty without a compiler.

    `flags` are additional compiler options.
    """
    found = []
    for compiler, options in COMPILERS.items():
        if shutil.which(compiler) is None:
            continue
        for real, chosen in (("double", []), ("float", [f"-D{upper}_FLOAT"])):
            measured = _size(place, source, [compiler, *options, *flags, *chosen])
            if measured is not None:
                found.append(ObjectSize(compiler=" ".join([compiler, *options]), real=real, **measured))
    return found


def _size(place: Path, source: str, command: Sequence[str]) -> dict[str, int] | None:
    """Return text and data, and the largest stack frame, of an object file; None where the compiler fails."""
    size = command[0].removesuffix("gcc") + "size"
    with tempfile.TemporaryDirectory() as folder:
        words = [*command, "-std=c99", "-c", "-fstack-usage", f"-I{place.resolve()}", str((place / source).resolve())]
        try:
            subprocess.run(words, check=True, capture_output=True, timeout=_COMPILE_SECONDS, cwd=folder)
            target = str(Path(folder) / source.replace(".c", ".o"))
            said = subprocess.run([size, target], check=True, capture_output=True, text=True, timeout=60).stdout
        except (OSError, subprocess.SubprocessError):
            return None
        text, data, bss = (int(word) for word in said.splitlines()[1].split()[:3])
        frames = [int(n) for use in Path(folder).glob("*.su") for n in re.findall(r"\t(\d+)\t", use.read_text())]
    return {"flash_bytes": text + data, "ram_bytes": data + bss, "stack_bytes": max(frames, default=0)}


def size_blocks(measured: Sequence[ObjectSize], without: Sequence[str] = ()) -> list[Block]:
    """Return the sizes of object code `without` some functions, or a note that there are none, as blocks."""
    if not measured:
        text = "flash and stack are not measured: neither gcc nor arm-none-eabi-gcc is installed, or the code is too long"
        return [Text(text=f"{text} (use the option sizes to measure it, which may take minutes)", tone="note")]
    rows = [[row.compiler, row.real, row.flash_bytes, row.stack_bytes] for row in measured]
    title = f"Object code, without {', '.join(without)}" if without else "Object code"
    return [table_of(title, ["compiler", "numbers", "flash [byte]", "largest stack frame [byte]"], rows)]
