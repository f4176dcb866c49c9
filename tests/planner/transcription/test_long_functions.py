"""Functions of millions of operations: nothing that takes minutes is looked for in them, no compiler is begun on them."""

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.compiled import functions as compiled
from linkplan.models.compiled.functions import compile_in_background  # itself: tests compile nothing in the background
from linkplan.planner.transcription import system
from tests.support.tolerances_planner import ROUNDING


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Code:
    """One function, as collocation keeps them."""

    value: ca.Function


AT = (np.array([0.3, -0.4, 0.7]), np.array([0.2]))


def functions_of(monkeypatch, long: float, shared: float) -> dict[str, ca.Function]:
    """Return the functions of rows in which one term comes again and again, by other bounds of length."""
    monkeypatch.setattr(system, "_MAX_UNSHARED_OPERATIONS", long)
    monkeypatch.setattr(system, "_MAX_SHARED_OPERATIONS", shared)
    xi, theta = ca.SX.sym("xi", 3), ca.SX.sym("theta", 1)
    terms = [ca.sin(xi[0]) * ca.exp(xi[1]) for _ in range(4)]
    at = ca.Function("rows", [xi, theta], [ca.vertcat(terms[0] * xi[2], terms[1] + theta[0], terms[2] * terms[3])])
    return system._functions(SimpleNamespace(n_xi=3, n_theta=1), "node", at, 2)[0]


@pytest.mark.parametrize("bounds", [(0, np.inf), (0, 0), (np.inf, 0)])
def test_what_is_shared_and_when_changes_no_value(monkeypatch, bounds):
    short, other = functions_of(monkeypatch, np.inf, np.inf), functions_of(monkeypatch, *bounds)
    for name, function in short.items():
        given = (*AT, np.array([0.5, -1.0, 2.0]))[: function.n_in()]
        for expected, found in zip(function.call(given), other[name].call(given), strict=True):
            assert np.abs(np.array(expected - found)).max() < ROUNDING


def test_a_long_function_is_shared_before_it_is_differentiated(monkeypatch):
    apart = functions_of(monkeypatch, np.inf, 0)["node_jacobian"]
    shared = functions_of(monkeypatch, 0, 0)["node_jacobian"]
    assert shared.n_instructions() < apart.n_instructions()


@pytest.mark.parametrize(("operations", "is_shared"), [(340_000, True), (3_400_000, False)])
def test_a_common_term_is_sought_in_a_function_of_less_than_millions_of_operations(monkeypatch, operations, is_shared):
    """A platform on six legs has 3.4 million: there it takes minutes and saves a thousandth."""
    x = ca.SX.sym("x")
    rows = ca.vertcat(ca.sin(x) * x, ca.sin(x) + x)
    monkeypatch.setattr(ca, "n_nodes", lambda _: operations)
    found = system._function("rows", [x], [rows])
    assert (found.n_instructions() < ca.Function("rows", [x], [rows]).n_instructions()) is is_shared


def test_no_compiler_is_begun_on_what_none_ends(monkeypatch, tmp_path):
    monkeypatch.setenv("LINKPLAN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(compiled, "compiler", lambda: ("cc",))
    monkeypatch.setattr(compiled, "_written", lambda *_: pytest.fail("it was written"))
    x = ca.SX.sym("x")
    long = _Code(value=ca.Function("value", [x], [ca.sin(x)]))
    monkeypatch.setattr(compiled, "_MAX_INSTRUCTIONS", 0)
    assert compiled.compiled("key", _Code, lambda: long) is long
    assert [compile_in_background("key", long) for _ in range(2)] == [None, None]
