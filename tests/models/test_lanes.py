"""C code over several samples at once: every operation as CasADi's interpreter has it, over any number of samples."""

import subprocess

import casadi as ca
import numpy as np
import pytest

from linkplan.models.compiled.functions import compiler, over_columns
from linkplan.models.compiled.lanes import N_LANES, in_lanes

needs_compiler = pytest.mark.skipif(compiler() is None, reason="this machine has no C compiler")
# Values of both signs, in and out of the domains of roots and inverse functions, and the exceptions of floating point.
VALUES = [-2.5, -1.0, -0.3, -0.0, 0.0, 0.2, 0.7, 1.0, 1.5, 30.0, np.inf, -np.inf, np.nan]
x, y = ca.SX.sym("x"), ca.SX.sym("y")
OPERATIONS = {
    "binary": [x + y, x - y, x * y, x / y, x**y, ca.atan2(x, y), ca.fmod(x, y), ca.hypot(x, y)],
    "compared": [x < y, x <= y, x == y, x != y, ca.logic_and(x, y), ca.logic_or(x, y), ca.logic_not(x)],
    "chosen": [ca.if_else(x < y, x, y), ca.fmin(x, y), ca.fmax(x, y), ca.sign(x), ca.copysign(x, y)],
    "rounded": [ca.floor(x), ca.ceil(x), ca.fabs(x), -x, 2 * x, x * x, 1 / x, x**3, ca.sqrt(x)],
    "circular": [ca.sin(x), ca.cos(x), ca.tan(x), ca.asin(x), ca.acos(x), ca.atan(x)],
    "hyperbolic": [ca.sinh(x), ca.cosh(x), ca.tanh(x), ca.asinh(x), ca.acosh(x), ca.atanh(x)],
    "exponential": [ca.exp(x), ca.log(x), ca.log1p(x), ca.expm1(x), ca.erf(x)],
    "constants": [x + np.inf, y * 0.1, ca.SX(np.nan), x - 1e-300, ca.SX(3)],
}  # fmt: skip


def compiled(folder, function: ca.Function) -> ca.Function:
    code = in_lanes([function])
    assert code is not None
    (folder / "code.c").write_text(code)
    command = [*compiler(), "-O1", "-ffp-contract=off", "-fPIC", "-shared", "code.c", "-o", "code.so", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    return ca.external(function.name(), str(folder / "code.so"))


@needs_compiler
@pytest.mark.parametrize("name", OPERATIONS)
def test_operations_have_the_interpreters_values_to_the_last_bit(tmp_path, name):
    function = ca.Function("rows", [x, y], [ca.vertcat(*OPERATIONS[name])])
    samples = np.array([[a, b] for a in VALUES for b in VALUES]).T
    at = ca.DM(samples[:1]), ca.DM(samples[1:])
    found = np.array(over_columns(compiled(tmp_path, function), N_LANES, samples.shape[1])(*at))
    expected = np.array(over_columns(function, 1, samples.shape[1])(*at))
    np.testing.assert_array_equal(found, expected)


@needs_compiler
@pytest.mark.parametrize("n", [1, N_LANES - 1, N_LANES, 2 * N_LANES + 1])
def test_samples_of_several_columns_keep_their_order(tmp_path, n):
    pair, none, weight = ca.SX.sym("pair", 2, 3), ca.SX.sym("none", 0, 0), ca.SX.sym("weight")
    function = ca.Function("rows", [pair, none, weight], [weight * pair, ca.sum2(pair)])
    rng = np.random.default_rng(n)
    given, weights = rng.normal(size=(2, 3 * n)), rng.normal(size=(1, n))
    arguments = ca.DM(given), ca.DM(0, 0), ca.DM(weights)
    columns, sums = over_columns(compiled(tmp_path, function), N_LANES, n)(*arguments)
    np.testing.assert_array_equal(np.array(columns), np.repeat(weights, 3, axis=1) * given)
    np.testing.assert_array_equal(np.array(sums), np.array(over_columns(function, 1, n)(*arguments)[1]))


def test_a_function_that_calls_another_one_is_left_to_casadi():
    doubled = ca.Function("doubled", [x], [2 * x], {"never_inline": True})
    assert in_lanes([ca.Function("caller", [x], [doubled(x)])]) is None


def test_operations_of_matrices_and_sparse_values_are_left_to_casadi():
    vector = ca.MX.sym("vector", 2)
    assert in_lanes([ca.Function("rows", [vector], [vector + vector])]) is None
    assert in_lanes([ca.Function("rows", [x], [ca.SX(ca.diag(ca.vertcat(x, x)))])]) is None
