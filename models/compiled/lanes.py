"""C code that evaluates functions at several samples at once: a list of operations, and a loop that carries them out.

Straight-line code is long: compilers take seconds for what a solve evaluates in a millisecond. Here the operations of a
function are data, and each is carried out on `N_LANES` samples by one vector instruction. The loop compiles in a tenth of a
second whatever the function. It costs a few nanoseconds per operation, which the samples share, and its numbers are those of
CasADi's interpreter to the last bit.
"""

import math
from collections.abc import Sequence

import casadi as ca

# The samples of one call: eight numbers of double precision fill the longest vector registers.
N_LANES = 8
# The C expression of each operation on x, or on x and y, as CasADi's interpreter has it; the most frequent three are apart.
_EXPRESSIONS = {
    ca.OP_ASSIGN: "x", ca.OP_DIV: "x / y", ca.OP_NEG: "-x", ca.OP_EXP: "exp(x)", ca.OP_LOG: "log(x)",
    ca.OP_POW: "pow(x, y)", ca.OP_CONSTPOW: "pow(x, y)", ca.OP_SQRT: "sqrt(x)", ca.OP_SQ: "x * x", ca.OP_TWICE: "2. * x",
    ca.OP_SIN: "sin(x)", ca.OP_COS: "cos(x)", ca.OP_TAN: "tan(x)", ca.OP_ASIN: "asin(x)", ca.OP_ACOS: "acos(x)",
    ca.OP_ATAN: "atan(x)", ca.OP_LT: "x < y", ca.OP_LE: "x <= y", ca.OP_EQ: "x == y", ca.OP_NE: "x != y", ca.OP_NOT: "!x",
    ca.OP_AND: "x && y", ca.OP_OR: "x || y", ca.OP_FLOOR: "floor(x)", ca.OP_CEIL: "ceil(x)", ca.OP_FMOD: "fmod(x, y)",
    ca.OP_FABS: "fabs(x)", ca.OP_SIGN: "x < 0 ? -1 : x > 0 ? 1 : x", ca.OP_COPYSIGN: "copysign(x, y)",
    ca.OP_IF_ELSE_ZERO: "x ? y : 0", ca.OP_ERF: "erf(x)", ca.OP_FMIN: "fmin(x, y)", ca.OP_FMAX: "fmax(x, y)",
    ca.OP_INV: "1. / x", ca.OP_SINH: "sinh(x)", ca.OP_COSH: "cosh(x)", ca.OP_TANH: "tanh(x)", ca.OP_ASINH: "asinh(x)",
    ca.OP_ACOSH: "acosh(x)", ca.OP_ATANH: "atanh(x)", ca.OP_ATAN2: "atan2(x, y)", ca.OP_LOG1P: "log1p(x)",
    ca.OP_EXPM1: "expm1(x)", ca.OP_HYPOT: "hypot(x, y)",
}  # fmt: skip
_FREQUENT = (ca.OP_ADD, ca.OP_SUB, ca.OP_MUL)
_LOOP = r"""
#include <math.h>
#define N_LANES %(lanes)d
typedef double lanes_t __attribute__((vector_size(8 * N_LANES)));
typedef long long bits_t __attribute__((vector_size(8 * N_LANES)));
#define ALL(b) {%(all)s}
#if defined(__x86_64__) && defined(__GLIBC__) && !defined(__clang__)
#define FOR_EACH_MACHINE __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define FOR_EACH_MACHINE
#endif
#define EACH(value) \
    for (l = 0; l < N_LANES; ++l) { const double x = w[first][l], y = w[second][l]; (void) y; w[to][l] = value; } \
    break;
/* Sums, differences and products need no branch, which the processor would guess wrongly: a sign of b, and a choice. */
static const bits_t SIGN[3] = {ALL(0), ALL((long long) 0x8000000000000000ULL), ALL(0)};
static const bits_t IS_PRODUCT[3] = {ALL(0), ALL(0), ALL(-1LL)};

/* Carry out n operations {operation, place of the result, places of the operands} on the work vectors w. */
FOR_EACH_MACHINE
static void carry_out(const int (*operation)[4], int n, const double *constants, const int *n_in, const int *n_out,
                      const double **arg, double **res, lanes_t *w) {
    const int (*end)[4] = operation + n;
    for (; operation < end; ++operation) {
        const int code = (*operation)[0], to = (*operation)[1], first = (*operation)[2], second = (*operation)[3];
        int l;
        if (code >= %(add)d && code <= %(mul)d) {
            const bits_t sign = SIGN[code - %(add)d], is_product = IS_PRODUCT[code - %(add)d];
            const lanes_t a = w[first], b = w[second], product = a * b, sum = a + (lanes_t) ((bits_t) b ^ sign);
            w[to] = (lanes_t) (((bits_t) product & is_product) | ((bits_t) sum & ~is_product));
            continue;
        }
        switch (code) {
        case %(input)d:
            for (l = 0; l < N_LANES; ++l) w[to][l] = arg[first] ? arg[first][l * n_in[first] + second] : 0.;
            break;
        case %(output)d:
            for (l = 0; l < N_LANES; ++l) if (res[to]) res[to][l * n_out[to] + second] = w[first][l];
            break;
        case %(const)d:
            for (l = 0; l < N_LANES; ++l) w[to][l] = constants[first];
            break;
%(cases)s        }
    }
}
"""
_FUNCTION = """
static const double constants_%(name)s[] = {%(constants)s};
static const int operations_%(name)s[][4] = {%(operations)s};
static const int n_in_%(name)s[] = {%(n_in)s}, n_out_%(name)s[] = {%(n_out)s};
static const long long sizes_in_%(name)s[][3] = {%(sizes_in)s}, sizes_out_%(name)s[][3] = {%(sizes_out)s};

int %(name)s(const double **arg, double **res, long long *iw, double *w, int mem) {
    lanes_t *aligned = (lanes_t *) (((unsigned long long) w + sizeof(lanes_t) - 1) / sizeof(lanes_t) * sizeof(lanes_t));
    (void) iw; (void) mem;
    carry_out(operations_%(name)s, %(n)d, constants_%(name)s, n_in_%(name)s, n_out_%(name)s, arg, res, aligned);
    return 0;
}
long long %(name)s_n_in(void) { return %(inputs)d; }
long long %(name)s_n_out(void) { return %(outputs)d; }
const long long *%(name)s_sparsity_in(long long i) { return sizes_in_%(name)s[i]; }
const long long *%(name)s_sparsity_out(long long i) { return sizes_out_%(name)s[i]; }
int %(name)s_work(long long *sz_arg, long long *sz_res, long long *sz_iw, long long *sz_w) {
    *sz_arg = %(inputs)d; *sz_res = %(outputs)d; *sz_iw = 0; *sz_w = (%(work)d + 1) * N_LANES;
    return 0;
}
"""


def in_lanes(functions: Sequence[ca.Function]) -> str | None:
    """Return C code of functions, each at `N_LANES` samples whose columns stand side by side.

    None where one has operations of matrices, calls of other functions, or sparse inputs or outputs.
    """
    parts = [_part(function) for function in functions]
    if None in parts:
        return None
    used = {function.instruction_id(k) for function in functions for k in range(function.n_instructions())}
    cases = "".join(f"        case {op}: EACH({_EXPRESSIONS[op]})\n" for op in sorted(used & _EXPRESSIONS.keys()))
    codes = {"add": ca.OP_ADD, "mul": ca.OP_MUL, "input": ca.OP_INPUT, "output": ca.OP_OUTPUT, "const": ca.OP_CONST}
    loop = _LOOP % {"lanes": N_LANES, "all": ", ".join(["b"] * N_LANES), "cases": cases, **codes}
    return loop + "".join(part for part in parts if part is not None)


def _c_number(value: float) -> str:
    return value.hex() if math.isfinite(value) else "NAN" if math.isnan(value) else f"{'-' * (value < 0)}INFINITY"


def _part(function: ca.Function) -> str | None:
    """Return one function's operations and its entries; None where these are not of scalars, or call another function."""
    ends = [function.sparsity_in(i) for i in range(function.n_in())] + [
        function.sparsity_out(i) for i in range(function.n_out())
    ]
    if not (function.is_a("SXFunction") and all(pattern.is_dense() for pattern in ends)):
        return None
    operations, constants = [], []
    for k in range(function.n_instructions()):
        op, out, into = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if op == ca.OP_CONST:
            operations.append((op, out[0], len(constants), 0))
            constants.append(_c_number(function.instruction_constant(k)))
        elif op == ca.OP_OUTPUT:
            operations.append((op, out[0], into[0], out[1]))
        elif op == ca.OP_INPUT or op in _EXPRESSIONS or op in _FREQUENT:
            operations.append((op, out[0], into[0], into[-1]))
        else:
            return None
    sizes_in = [function.size_in(i) for i in range(function.n_in())]
    sizes_out = [function.size_out(i) for i in range(function.n_out())]
    return _FUNCTION % {
        "name": function.name(),
        "constants": ", ".join(constants or ["0"]),
        "operations": str(operations or [(ca.OP_CONST, 0, 0, 0)])[1:-1].replace("(", "{").replace(")", "}"),
        "n": len(operations),
        "n_in": ", ".join(str(rows * columns) for rows, columns in sizes_in),
        "n_out": ", ".join(str(rows * columns) for rows, columns in sizes_out),
        "sizes_in": ", ".join(f"{{{rows}, {columns} * N_LANES, 1}}" for rows, columns in sizes_in),
        "sizes_out": ", ".join(f"{{{rows}, {columns} * N_LANES, 1}}" for rows, columns in sizes_out),
        "inputs": len(sizes_in),
        "outputs": len(sizes_out),
        "work": function.sz_w(),
    }
