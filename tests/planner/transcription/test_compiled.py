"""Compiled interval functions: the same numbers as interpreted ones, kept by content, and no compiler is no misfortune."""

import warnings
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.closed_chain.mechanics import NodeTerms, mechanism_system
from linkplan.planner.files.problem_file import load_problem
from linkplan.planner.planning import plan_motion
from linkplan.planner.transcription import compiled as module
from linkplan.planner.transcription.cache import cache_folder
from linkplan.planner.transcription.compiled import cached, compiled, compiler, key_of
from linkplan.planner.transcription.interval import NAMES, IntervalRows, build_interval
from linkplan.planner.transcription.schemes import scheme
from tests.support.tolerances_planner import COMPILED, ROUNDING

needs_compiler = pytest.mark.skipif(compiler() is None, reason="this machine has no C compiler")


def built():
    mechanism = load_mechanism("optimus-knee", payload="shank")
    return build_interval(mechanism_system(mechanism, NodeTerms()), scheme("radau-2"), IntervalRows(costs=("effort",)))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("LINKPLAN_CACHE", str(tmp_path))
    return tmp_path


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


def key(payload="shank", asked=None, name="radau-2", effort="polynomial", costs=("effort",)):
    system = mechanism_system(load_mechanism("optimus-knee", payload=payload), asked or NodeTerms())
    return key_of(system, scheme(name, effort), IntervalRows(costs=costs))


def test_keys_differ_where_the_generated_code_does():
    lighter = {"body": "crank", "mass_kg": 1.0, "com_m": [0.1, 0.0, 0.0], "inertia_kgm2": [0.01, 0.01, 0.01]}
    others = (
        key(payload=None),
        key(asked=NodeTerms(powers=(0,))),
        key(name="radau-3"),
        key(effort="constant"),
        key(costs=()),
    )
    assert len({key(), *others}) == 6
    assert key() == key()
    assert key(payload=lighter) == key()  # a payload's numbers are parameters of the same code


def test_keys_follow_the_expressions_and_not_their_sources():
    before = key()

    def otherwise(*arguments):
        system = mechanism_system(*arguments)
        doubled = ca.Function("node", system.node.sx_in(), [2 * system.node(*system.node.sx_in())])
        return replace(system, node=doubled)

    system = otherwise(load_mechanism("optimus-knee", payload="shank"), NodeTerms())
    assert key_of(system, scheme("radau-2"), IntervalRows(costs=("effort",))) != before


def test_the_cache_lies_where_it_is_told_to(folder):
    assert cache_folder() == folder


@pytest.mark.slow
@needs_compiler
def test_a_plan_is_the_same_compiled_and_interpreted(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plans = [plan_motion(load_problem("knee-reach", [f"solver.compile={mode}"])) for mode in ("never", "always")]
    assert list(folder.glob("*.so"))
    assert plans[1].objective == pytest.approx(plans[0].objective, rel=COMPILED)


def test_payloads_have_functions_of_their_own():
    fingerprints = {load_mechanism("optimus-knee", payload=payload).fingerprint() for payload in (None, "shank")}
    assert len(fingerprints) == 2
