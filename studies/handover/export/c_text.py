"""Pieces of C text: comments, arrays, test programs, CMake files."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from linkplan.studies.handover.export.c_source import CFunction

# How a source file calls the functions of <math.h> in its precision.
MATH = """#include <math.h>

#ifdef {upper}_FLOAT
#define MATH(name) name##f
#else
#define MATH(name) name
#endif
"""
_LINE_NUMBERS = 4
# The number for "no limit", within the range of single precision.
NO_LIMIT = 1e30


def block_comment(lines: Sequence[str]) -> str:
    """Return lines as a comment that names of models cannot end."""
    text = "\n".join(f"   {line.replace('*/', '* /')}".rstrip() for line in lines)
    return f"/* {text.strip()} */"


def header_of(prefix: str, about: Sequence[str], declared: Sequence[str]) -> str:
    """Return a header for C and C++: a comment, the type of numbers, and declarations."""
    upper, real, text = prefix.upper(), f"{prefix}_real", "\n".join(declared)
    return f"""{block_comment(about)}
#ifndef {upper}_H
#define {upper}_H

#ifdef __cplusplus
extern "C" {{
#endif

#ifdef {upper}_FLOAT
typedef float {real};
#else
typedef double {real};
#endif

{text}
#ifdef __cplusplus
}}
#endif

#endif /* {upper}_H */
"""


def limit_macros(prefix: str, kind: str, names: Sequence[str], limits: np.ndarray, unit: Sequence[str]) -> list[str]:
    """Return a macro for each end of limits (n, 2), such as PREFIX_Q0_MIN, with the name and unit behind it."""
    found = []
    for k, ((low, high), name, of) in enumerate(zip(bounded(limits), names, unit, strict=True)):
        note = block_comment([f"{name} [{of}]"])
        for end, value in (("MIN", low), ("MAX", high)):
            found.append(f"#define {prefix.upper()}_{kind}{k}_{end} ({float(value)!r}) {note}")
    return found


def bounded(limits: np.ndarray) -> np.ndarray:
    """Return limits with `NO_LIMIT` in place of infinity, for which C99 has no number."""
    return np.clip(limits, -NO_LIMIT, NO_LIMIT)


def declared_array(declaration: str, values: np.ndarray, real: str) -> str:
    """Return the definition of an array of numbers, exact to the last digit, each cast to the precision.

    Args:
        declaration: type and name, such as "const double x".
        values: (n,) or (n, m), stored row by row.
        real: the type of a number.
    """
    shape = "".join(f"[{size}]" for size in values.shape)
    flat = [f"({real}){float(x)!r}" for x in np.ravel(values)]
    rows = [", ".join(flat[k : k + _LINE_NUMBERS]) for k in range(0, len(flat), _LINE_NUMBERS)]
    if values.ndim == 2:
        width = values.shape[1]
        rows = ["{" + ", ".join(flat[k : k + width]) + "}" for k in range(0, len(flat), width)]
    return f"{declaration}{shape} = {{\n  " + ",\n  ".join(rows) + "};"


def tests_text(
    prefix: str, real: str, functions: Sequence[CFunction], independent: np.ndarray, states: Mapping[str, np.ndarray]
) -> str:
    """Return a C program that compares functions with their values in Python at states (n, ...)."""
    n, upper = len(states["q"]), prefix.upper()
    lines = [f'#include "{prefix}.h"', "", "#include <stdio.h>", ""]
    lines += [declared_array(f"static const {real} {name}", value, real) for name, value in states.items() if value.size]
    calls = []
    for one in functions:
        short = one.name.removeprefix(f"{prefix}_")
        wanted = [f"{short}_{name}" for name in one.outputs]
        for key, value in zip(wanted, one.values(states), strict=True):
            lines.append(declared_array(f"static const {real} {key}", value, real))
        call = ", ".join([*[f"{name}[k]" for name in one.inputs], *[f"found_{key}" for key in wanted]])
        calls += [f"    {real} found_{key}[{one.function.numel_out(k)}];" for k, key in enumerate(wanted)]
        calls += [f"    {one.name}({call});"]
        calls += [f'    check("{key}", found_{key}, {key}[k], {one.function.numel_out(k)});' for k, key in enumerate(wanted)]
    given = ", ".join(f"q[k][{int(i)}]" for i in independent)
    text = f"""
/* the bound on an error, relative to the largest value of a result */
#ifdef {upper}_FLOAT
#define BOUND 1e-3
#else
#define BOUND 1e-9
#endif

static int failed = 0;

static void check(const char *name, const {real} *found, const {real} *wanted, int n)
{{
  double off = 0, size = 1e-6;
  int i;
  for (i = 0; i < n; ++i) {{
    double d = (double)found[i] - (double)wanted[i], w = (double)wanted[i];
    off = (d < 0 ? -d : d) > off ? (d < 0 ? -d : d) : off;
    size = (w < 0 ? -w : w) > size ? (w < 0 ? -w : w) : size;
  }}
  if (!(off <= BOUND * size)) {{
    printf("%s is off by %g of %g\\n", name, off, size);
    failed = 1;
  }}
}}

int main(void)
{{
  int k, i;
  for (k = 0; k < {n}; ++k) {{
    {real} pose[{upper}_N_Q], s[{upper}_N_S] = {{{given}}};
    for (i = 0; i < {upper}_N_Q; ++i) pose[i] = q[k][i];
    if ({prefix}_close(s, pose)) {{
      printf("the loops do not close\\n");
      failed = 1;
    }}
"""
    return (
        "\n".join(lines)
        + text
        + "\n".join(calls)
        + '\n  }\n  if (!failed) printf("as in Python\\n");\n  return failed;\n}\n'
    )


def write_texts(place: Path, prefix: str, header: str, source: str, test: str) -> list[str]:
    """Write header, source, test and CMake file into a folder, and return the files' names."""
    texts = {f"{prefix}.h": header, f"{prefix}.c": source, f"{prefix}_test.c": test, "CMakeLists.txt": cmake_text(prefix)}
    for name, text in texts.items():
        (place / name).write_text(text, encoding="utf-8")
    return sorted(texts)


def cmake_text(prefix: str) -> str:
    """Return a CMakeLists.txt of a static library, one for float, and their tests."""
    # A C identifier has no "-", so a target with this suffix is never that of another model, such as NAME_test.
    upper = prefix.upper()
    lines = ["cmake_minimum_required(VERSION 3.10)", f"project({prefix} C)", "set(CMAKE_C_STANDARD 99)", "enable_testing()"]
    for suffix, flag in (("", None), ("-float", f"{upper}_FLOAT")):
        lines += ["", f"add_library({prefix}{suffix} STATIC {prefix}.c)"]
        lines += [f"target_include_directories({prefix}{suffix} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})"]
        lines += [f"target_compile_definitions({prefix}{suffix} PUBLIC {flag})"] if flag else []
        lines += ["if(UNIX)", f"  target_link_libraries({prefix}{suffix} PUBLIC m)", "endif()"]
        lines += [f"add_executable({prefix}{suffix}-test {prefix}_test.c)"]
        lines += [f"target_link_libraries({prefix}{suffix}-test {prefix}{suffix})"]
        lines += [f"add_test(NAME {prefix}{suffix} COMMAND {prefix}{suffix}-test)"]
    return "\n".join(lines) + "\n"
