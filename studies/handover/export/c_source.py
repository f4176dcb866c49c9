"""C99 functions from CasADi's: CasADi generates the arithmetic; this file adds readable arguments and a precision.

CasADi's CodeGenerator writes a function of pointers to pointers with a work vector. An SX function needs neither: its body
is assignments to local variables. The body is kept, `arg[i][k]` and `res[i][k]` become elements of named arrays. Constants
are cast to the precision, and mathematical functions are called as MATH(sin)(x), so one text serves double and float.
"""

import re
import unicodedata
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
