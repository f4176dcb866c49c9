"""Functions that are wanted again are compiled by a process of its own, for which nobody waits."""

import gc
import os
import time
import warnings

import numpy as np
import pytest

from linkplan.models.compiled.cache import wanted_again
from linkplan.models.compiled.functions import cached, compile_in_background, compiled_as_asked, compiler
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.closed_chain.mechanics import NodeTerms, mechanism_system
from linkplan.planner.transcription.system import NodeFunctions, build_node
from tests.support.tolerances_planner import ROUNDING

pytestmark = pytest.mark.skipif(compiler() is None, reason="this machine has no C compiler")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("LINKPLAN_CACHE", str(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def functions():
    system = mechanism_system(load_mechanism("slider-crank"), NodeTerms())
    return build_node(system)


def test_what_is_wanted_once_is_not_compiled(folder, functions):
    assert compile_in_background("k1", functions) is None
    assert [path.name for path in folder.iterdir()] == ["k1.wanted"]


def test_only_auto_compiles_in_the_background(functions, monkeypatch):
    asked = []
    monkeypatch.setattr("linkplan.models.compiled.functions.compile_in_background", lambda key, _: asked.append(key))
    for mode in ("never", "auto"):
        assert compiled_as_asked("k1", NodeFunctions, lambda: functions, mode) is functions
    assert asked == ["k1"]


def test_what_is_wanted_again_is_compiled_kept_and_nothing_else_is_left(folder, functions):
    compile_in_background("k1", functions)
    process = compile_in_background("k1", functions)
    assert process.wait() == 0
    assert sorted(path.name for path in folder.iterdir()) == ["k1.json", "k1.so"]
    fast = cached("k1", NodeFunctions).node_value
    assert "External" in fast.class_name()
    arguments = [np.full(fast.size_in(i), 0.7) for i in range(fast.n_in())]
    for a, b in zip(functions.node_value.call(arguments), fast.call(arguments), strict=True):
        np.testing.assert_allclose(np.array(b), np.array(a), rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.usefixtures("folder")
def test_one_process_at_a_time_compiles_a_key(functions):
    compile_in_background("k1", functions)
    process = compile_in_background("k1", functions)
    assert compile_in_background("k1", functions) is None
    process.wait()


@pytest.mark.usefixtures("folder")
def test_nobody_is_warned_of_a_process_that_is_left_to_itself(functions, monkeypatch):
    monkeypatch.setattr("linkplan.models.compiled.functions.compiler", lambda: ("sleep", "1", ";"))
    compile_in_background("k1", functions)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        assert compile_in_background("k1", functions).poll() is None  # at work, and held by nothing
        gc.collect()
    assert [str(one.message) for one in said] == []


@pytest.mark.usefixtures("folder")
def test_a_compiler_that_fails_leaves_no_litter(folder, functions, monkeypatch):
    monkeypatch.setattr("linkplan.models.compiled.functions.compiler", lambda: ("false",))
    compile_in_background("k1", functions)
    assert compile_in_background("k1", functions).wait() == 1
    assert sorted(path.name for path in folder.iterdir()) == ["k1.begun", "k1.wanted"]
    assert cached("k1", NodeFunctions) is None


@pytest.mark.parametrize(("age_s", "again"), [(300.0, False), (900.0, True)])
def test_a_compilation_that_was_begun_more_than_ten_minutes_ago_is_begun_again(tmp_path, age_s, again):
    assert not wanted_again(tmp_path, "k1"), "wanted for the first time"
    assert wanted_again(tmp_path, "k1"), "wanted again and not begun"
    ago = time.time() - age_s
    os.utime(tmp_path / "k1.begun", (ago, ago))
    assert wanted_again(tmp_path, "k1") is again
