"""Functions of millions of operations: nothing that takes minutes is looked for in them, no compiler is begun on them."""

from dataclasses import dataclass

import casadi as ca
import pytest

from linkplan.models.compiled import functions as compiled
from linkplan.planner.transcription import system


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Code:
    """One function, as collocation keeps them."""

    value: ca.Function


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
