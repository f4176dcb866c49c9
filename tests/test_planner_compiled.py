"""Compiled interval functions: the same numbers as interpreted ones, kept by content, and no compiler is no misfortune."""

import warnings

import numpy as np
import pytest

from models.mechanism import load_mechanism
from planner import compiled as module
from planner.compiled import cache_folder, cached, compiled, compiler, key_of
from planner.interval import NAMES, IntervalRows, build_interval
from planner.mechanics import Asked, mechanism_system
from planner.planning import plan_motion
from planner.problem_file import load_problem
from planner.schemes import scheme
from tests.tolerances_planner import ROUNDING

needs_compiler = pytest.mark.skipif(compiler() is None, reason="this machine has no C compiler")


def built():
    mechanism = load_mechanism("optimus-knee", payload="shank")
    return build_interval(mechanism_system(mechanism, Asked()), scheme("radau-2"), IntervalRows(costs=("effort",)))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("LINKPLAN_CACHE", str(tmp_path))
    return tmp_path


@needs_compiler
@pytest.mark.usefixtures("folder")
def test_compiled_functions_give_the_interpreted_ones_numbers():
    interpreted, fast = built(), compiled("k1", built)
    rng = np.random.default_rng(0)
    for name in NAMES:
        slow = getattr(interpreted, name)
        assert "External" in getattr(fast, name).class_name()
        arguments = [rng.uniform(0.5, 1.5, size=slow.size_in(i)) for i in range(slow.n_in())]
        for a, b in zip(slow.call(arguments), getattr(fast, name).call(arguments), strict=True):
            np.testing.assert_allclose(np.array(b), np.array(a), rtol=ROUNDING, atol=ROUNDING)


@needs_compiler
def test_what_is_compiled_once_is_found_again_whole(folder):
    first = compiled("k1", built)
    again = cached("k1")
    assert again is not None
    for name in ("jacobian_pattern", "hessian_pattern"):
        for a, b in zip(getattr(first, name), getattr(again, name), strict=True):
            np.testing.assert_array_equal(a, b)
    assert (again.n_rows, again.row_kinds) == (first.n_rows, first.row_kinds)
    assert sorted(path.name for path in folder.iterdir()) == ["k1.json", "k1.so"]


@needs_compiler
@pytest.mark.usefixtures("folder")
def test_a_cached_function_is_not_built_again():
    compiled("k1", built)
    compiled("k1", lambda: pytest.fail("built again"))


def test_without_a_compiler_the_interpreter_serves(folder, monkeypatch):
    monkeypatch.setattr(module, "compiler", lambda: None)
    functions = compiled("k1", built)
    assert "External" not in functions.node_value.class_name()
    assert list(folder.iterdir()) == []


def test_a_compiler_that_fails_is_said_and_costs_nothing_else(folder, monkeypatch):
    monkeypatch.setattr(module, "compiler", lambda: ("false",))
    with pytest.warns(RuntimeWarning, match="compiling them failed"):
        functions = compiled("k1", built)
    assert "External" not in functions.node_value.class_name()
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("content", [b"", b"{", b'{"n_own": 2}'])
def test_a_damaged_entry_counts_as_none(folder, content):
    (folder / "k1.json").write_bytes(content)
    (folder / "k1.so").write_bytes(b"not a library")
    assert cached("k1") is None


def test_keys_differ_where_contents_do():
    keys = {key_of("a", 1), key_of("a", 2), key_of("b", 1), key_of("a1"), key_of(np.ones(2)), key_of(np.ones(3))}
    assert len(keys) == 6
    assert key_of("a", 1) == key_of("a", 1)


def test_the_cache_lies_where_it_is_told_to(folder):
    assert cache_folder() == folder


@needs_compiler
def test_a_plan_is_the_same_compiled_and_interpreted(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plans = [plan_motion(load_problem("knee-reach", [f"solver.compile={mode}"])) for mode in ("never", "always")]
    assert list(folder.glob("*.so"))
    assert plans[1].objective == pytest.approx(plans[0].objective, rel=1e-10)


def test_payloads_have_functions_of_their_own():
    fingerprints = {load_mechanism("optimus-knee", payload=payload).fingerprint() for payload in (None, "shank")}
    assert len(fingerprints) == 2
