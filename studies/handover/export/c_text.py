"""C text: functions from CasADi's, comments, arrays, test programs, CMake files.

CasADi's CodeGenerator writes a function of pointers to pointers with a work vector. An SX function needs neither: its body
is assignments to local variables. The body is kept, `arg[i][k]` and `res[i][k]` become elements of named arrays. Constants
are cast to the precision, and mathematical functions are called as MATH(sin)(x), so one text serves double and float.
"""

import re
import unicodedata
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

# CasADi's helpers that a body may call, as C functions of the chosen precision.
_HELPERS = {
    "casadi_sq": "static inline {real} casadi_sq({real} x) {{ return x * x; }}",
    "casadi_sign": "static inline {real} casadi_sign({real} x) {{ return ({real})((x > 0) - (x < 0)); }}",
}
# CasADi's helpers that C99 has itself.
_OF_C99 = re.compile(r"\bcasadi_(fabs|fmin|fmax|log1p|expm1|hypot)\b")
_CALL = re.compile(r"\b(a?(?:sin|cos|tan)h?|atan2|sqrt|fabs|fmin|fmax|exp|expm1|log|log1p|hypot|pow|floor|ceil|erf)\(")
_BODY = re.compile(r"static int casadi_f\d+\([^)]*\) \{\n(.*?)  return 0;\n\}", re.DOTALL)
_NUMBER = re.compile(r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?)(?![\w.])")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class CFunction:
    """A C function: its CasADi function, name, and the names of its arguments; outputs are dense, matrices row by row."""

    name: str
    about: str
    function: ca.Function
    inputs: Sequence[str]
    outputs: Sequence[str]

    def values(self, states: Mapping[str, np.ndarray]) -> list[np.ndarray]:
        """Return the outputs (n, numel), matrices row by row, at states (n, ...) by the arguments' names."""
        n, of = len(states["q"]), self.function
        found = of.map(n).call([states[name].T for name in self.inputs])
        return [np.array(x).reshape(of.size1_out(k), n, -1).transpose(1, 2, 0).reshape(n, -1) for k, x in enumerate(found)]

    def prototype(self, real: str) -> str:
        """Return the C declaration without its semicolon."""
        of = self.function
        arguments = [f"const {real} {name}[{of.numel_in(k)}]" for k, name in enumerate(self.inputs)]
        arguments += [f"{real} {name}[{of.numel_out(k)}]" for k, name in enumerate(self.outputs)]
        return f"void {self.name}({', '.join(arguments)})"

    def definition(self, real: str) -> str:
        """Return the C definition."""
        options = {"with_header": False, "verbose": False, "casadi_int": "int", "casadi_real": real}
        generator = ca.CodeGenerator("body.c", options)
        generator.add(self.function)
        (body,) = _BODY.findall(generator.dump())
        for k, name in enumerate(self.inputs):
            body = body.replace(f"arg[{k}]? arg[{k}]", name)
        for k, name in enumerate(self.outputs):
            body = body.replace(f"if (res[{k}]!=0) res[{k}]", name)
        body = re.sub(r"(\[\d+\]) : 0;", r"\1;", body).replace("casadi_real ", f"{real} ")
        body = _CALL.sub(r"MATH(\1)(", _OF_C99.sub(r"\1", body))
        body = _NUMBER.sub(rf"({real})\1", body)
        unused = [f"  (void){name};\n" for name in self.inputs if f"{name}[" not in body]
        return f"{self.prototype(real)}\n{{\n{''.join(unused)}{body}}}\n"


def function_of(
    name: str, about: str, inputs: Sequence[tuple[str, ca.SX]], outputs: Sequence[tuple[str, ca.SX]]
) -> CFunction:
    """Return the C function of named expressions; it computes common parts once and stores matrices row by row."""
    arguments, results = [x for _, x in inputs], [ca.densify(y).T for _, y in outputs]
    function = ca.Function(name, arguments, ca.cse(results))
    return CFunction(
        name=name, about=about, function=function, inputs=[key for key, _ in inputs], outputs=[key for key, _ in outputs]
    )


def helpers(text: str, real: str) -> str:
    """Return the definitions of CasADi's helpers that a text calls."""
    called = sorted(set(re.findall(r"\bcasadi_\w+", text)))
    return "".join(_HELPERS[name].format(real=real) + "\n" for name in called)


def identifier(name: str, first: str = "linkplan") -> str:
    """Return a name as a C identifier after a first word, which is the prefix of identifiers, files and CMake targets.

    With the first word "linkplan", the identifier is not a CMake target (test, all, install), a C header (math.h) or a
    keyword. A checksum of the name replaces letters that ASCII lacks.
    """
    letters = unicodedata.normalize("NFKD", name)
    plain = [letter for letter in letters if letter.isascii()]
    lost = any(not letter.isascii() and not unicodedata.combining(letter) for letter in letters)
    words = [*re.findall(r"[A-Za-z0-9]+", "".join(plain)), *([f"{zlib.crc32(name.encode()):08x}"] if lost else [])]
    return "_".join([first, *words])


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
