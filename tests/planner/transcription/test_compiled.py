"""Compiled interval functions: the same numbers as interpreted ones, kept by content, and no compiler is no misfortune."""

import warnings
from dataclasses import fields, replace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.compiled import functions as module
from linkplan.models.compiled.cache import wanted_again
from linkplan.models.compiled.functions import cached, compiled, compiled_as_asked, compiler, over_columns
from linkplan.models.compiled.lanes import N_LANES
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.closed_chain.mechanics import NodeTerms, mechanism_system
from linkplan.planner.limits.actuators import PowerLimit
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.transcription import system as systems
from linkplan.planner.transcription.interval import ChainFunctions, IntervalRows, build_chain
from linkplan.planner.transcription.program import chain_key, node_key, without_numbers
from linkplan.planner.transcription.schemes import scheme
from linkplan.planner.transcription.system import NodeFunctions, System, build_node
from tests.support.fourbar_problems import random_case
from tests.support.tolerances_planner import COMPILED

# No multiple of the samples that one call evaluates.
SAMPLES = N_LANES + 3
needs_compiler = pytest.mark.skipif(compiler() is None, reason="this machine has no C compiler")


def built():
    return build_node(mechanism_system(load_mechanism("optimus-knee", payload="shank"), NodeTerms()))


def chained():
    system = mechanism_system(load_mechanism("optimus-knee", payload="shank"), NodeTerms())
    return build_chain(system, scheme("radau-2"), IntervalRows(costs=("effort",)), built())


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("LINKPLAN_CACHE", str(tmp_path))
    return tmp_path


@pytest.mark.slow
@needs_compiler
@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(("kind", "build"), [(NodeFunctions, built), (ChainFunctions, chained)])
def test_compiled_functions_give_the_interpreted_ones_numbers_to_the_last_bit(kind, build):
    interpreted, fast = build(), compiled("k1", kind, build)
    rng = np.random.default_rng(0)
    names = [field.name for field in fields(kind) if isinstance(getattr(interpreted, field.name), ca.Function)]
    assert len(names) == 5
    for name in names:
        slow = getattr(interpreted, name)
        assert "External" in getattr(fast, name).class_name()
        columns = [(slow.size1_in(i), SAMPLES * slow.size2_in(i)) for i in range(slow.n_in())]
        arguments = [ca.DM(rng.uniform(0.5, 1.5, size=size)) for size in columns]
        found = [over_columns(getattr(of, name), of.lanes, SAMPLES)(*arguments) for of in (interpreted, fast)]
        for a, b in zip(*(one if isinstance(one, tuple) else (one,) for one in found), strict=True):
            np.testing.assert_array_equal(np.array(b), np.array(a))


@pytest.mark.slow
@needs_compiler
def test_what_is_compiled_once_is_found_again_whole(folder):
    first = compiled("k1", ChainFunctions, chained)
    again = cached("k1", ChainFunctions)
    assert again is not None
    for name in ("jacobian_pattern", "hessian_pattern"):
        for a, b in zip(getattr(first, name), getattr(again, name), strict=True):
            np.testing.assert_array_equal(a, b)
    assert (again.n_own, again.own_kinds, again.own_items) == (first.n_own, first.own_kinds, first.own_items)
    assert sorted(path.name for path in folder.iterdir()) == ["k1.json", "k1.so"]


@needs_compiler
def test_auto_compiles_what_is_wanted_a_second_time(folder, monkeypatch):
    monkeypatch.setattr(module, "wanted_again", wanted_again)
    monkeypatch.setattr(module, "compiled", lambda key, *_: asked.append(key))
    asked, functions = [], built()
    for mode in ("never", "auto", "never"):
        assert compiled_as_asked("k1", NodeFunctions, lambda: functions, mode) is functions
    assert asked == []
    assert [path.name for path in folder.iterdir()] == ["k1.wanted"]
    compiled_as_asked("k1", NodeFunctions, lambda: functions, "auto")
    assert asked == ["k1"]


@pytest.mark.parametrize(("found", "said"), [(None, []), (("false",), ["compiling them failed"])], ids=["none", "one fails"])
def test_without_a_compiler_that_works_the_interpreter_serves(found, said, folder, monkeypatch, recwarn):
    monkeypatch.setattr(module, "compiler", lambda: found)
    functions = compiled("k1", NodeFunctions, built)
    assert [words in str(one.message) for words, one in zip(said, recwarn.list, strict=True)] == [True] * len(said)
    assert "External" not in functions.node_value.class_name()
    assert list(folder.iterdir()) == []


def keys(payload="shank", asked=None, name="radau-2", effort="polynomial", costs=("effort",)):
    """Return the keys of a node's functions and of the chain rule's."""
    system = mechanism_system(load_mechanism("optimus-knee", payload=payload), asked or NodeTerms())
    transcription, rows = scheme(name, effort), IntervalRows(costs=costs)
    return node_key(system), chain_key(system, transcription, rows, build_node(system))


def test_keys_of_nodes_follow_the_mechanism_and_not_the_transcription():
    lighter = {"body": "crank", "mass_kg": 1.0, "com_m": [0.1, 0.0, 0.0], "inertia_kgm2": [0.01, 0.01, 0.01]}
    assert len({keys()[0], keys(payload=None)[0], keys(asked=NodeTerms(limits=(PowerLimit(0),)))[0]}) == 3
    assert keys(name="radau-3")[0] == keys(effort="constant")[0] == keys(costs=())[0] == keys()[0]
    assert keys(payload=lighter) == keys()  # a payload's numbers are parameters of the same code


def test_keys_of_the_chain_rule_follow_the_transcription_and_not_the_mechanism():
    assert len({keys()[1], keys(name="radau-3")[1], keys(effort="constant")[1], keys(costs=())[1]}) == 4
    heavier = keys(payload={"body": "crank", "mass_kg": 2.0, "com_m": [0.1, 0.0, 0.0], "inertia_kgm2": [0.1, 0.1, 0.1]})
    assert heavier[1] == keys()[1]


def test_keys_follow_the_expressions_and_not_their_sources():
    def otherwise(*arguments):
        system = mechanism_system(*arguments)
        doubled = ca.Function("node", system.node.sx_in(), [2 * system.node(*system.node.sx_in())])
        return replace(system, node=doubled)

    system = otherwise(load_mechanism("optimus-knee", payload="shank"), NodeTerms())
    transcription, rows = scheme("radau-2"), IntervalRows(costs=("effort",))
    assert node_key(system) != keys()[0]
    assert chain_key(system, transcription, rows, build_node(system)) == keys()[1]


@pytest.mark.slow
@needs_compiler
def test_a_plan_is_the_same_compiled_and_interpreted(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plans = [plan_motion(load_problem("knee-reach", [f"solver.compile={mode}"])) for mode in ("never", "always")]
    assert list(folder.glob("*.so"))
    assert plans[1].objective == pytest.approx(plans[0].objective, rel=COMPILED)


# A mechanism's rows, in its own scales, with a constant that is one but for rounding taken as one.
ROUNDED = 1e-13


def system_of(number: int) -> System:
    """Return the system of a random four-bar."""
    mechanism = random_case(0, number).tables["mechanism"]
    return mechanism_system(load_mechanism(mechanism["model"], independent=mechanism.get("independent")), NodeTerms())


def plain(function) -> System:
    """Return a system whose one equation and cost are functions of a position."""
    xi, theta = ca.SX.sym("xi", 4), ca.SX.sym("theta", 0)
    node = ca.Function("node", [xi, theta], [ca.vertcat(function(xi[0]), xi[3] ** 2)])
    return System(n_s=1, n_x=0, n_z=0, n_u=1, node=node, n_equations=1, n_path=0, kinds=("dynamics",))


@pytest.mark.parametrize("payload", [None, "shank"])
def test_a_system_without_its_numbers_gives_the_same_values_with_them(payload):
    system = mechanism_system(load_mechanism("optimus-knee", payload=payload), NodeTerms())
    bare, numbers = without_numbers(system)
    assert len(numbers) > 10
    rng = np.random.default_rng(3)
    xi, theta = rng.uniform(0.2, 1.2, system.node.size1_in(0)), rng.uniform(0.5, 2.0, system.n_theta)
    expected = np.array(system.node(xi, theta))
    assert np.abs(expected).max() > 0
    got = np.array(bare.node(xi, np.concatenate([theta, numbers])))
    np.testing.assert_allclose(got, expected, rtol=ROUNDED, atol=ROUNDED * np.abs(expected).max())


def test_four_bars_of_other_lengths_and_masses_have_one_structure():
    one, other = (system_of(number) for number in (7, 11))
    assert node_key(one) != node_key(other)
    (bare, numbers), (others_bare, others_numbers) = without_numbers(one), without_numbers(other)
    assert node_key(bare) == node_key(others_bare)
    assert not np.allclose(numbers, others_numbers)


@pytest.mark.parametrize(
    ("function", "numbers"),
    [
        (lambda x: 0.3 * x + 7.1, [0.3, 7.1]),
        (lambda x: x**2.7 + ca.fmax(x, 0.31), []),  # an exponent, and what is compared with, are of the equations
        (lambda x: 2 * x - 1, []),
        (lambda x: (1 - 1e-16) * x + 0.7, [0.7]),  # one, but for rounding
    ],
)
def test_factors_and_summands_of_a_model_are_its_numbers(function, numbers):
    bare, taken = without_numbers(plain(function))
    assert sorted(taken) == pytest.approx(numbers)
    xi = np.array([0.6, 0.0, 0.0, 0.2])
    expected = [float(function(ca.DM(0.6))), 0.04]
    np.testing.assert_allclose(np.array(bare.node(xi, taken)).ravel(), expected, rtol=ROUNDED)


def test_expressions_that_call_functions_of_their_own_keep_their_numbers():
    angle = ca.SX.sym("angle")
    called = ca.Function("called", [angle], [ca.sin(3.3 * angle)], {"never_inline": True})
    system = plain(lambda x: called(x) + 0.7)
    bare, numbers = without_numbers(system)
    assert bare is system
    assert len(numbers) == 0


def test_a_user_s_differential_equation_keeps_its_numbers():
    system = replace(plain(lambda x: x + 0.7), n_s=0, n_x=1)
    assert without_numbers(system)[0] is system


@pytest.mark.parametrize(("operations", "is_shared"), [(10_000, True), (100_000, False)])
def test_common_terms_are_sought_in_short_functions(monkeypatch, operations, is_shared):
    """In long ones it takes longer than it saves."""
    x = ca.SX.sym("x")
    rows = ca.vertcat(ca.sin(x) * x, ca.sin(x) + x)
    monkeypatch.setattr(ca, "n_nodes", lambda _: operations)
    found = systems._function("rows", [x], [rows])
    assert (found.n_instructions() < ca.Function("rows", [x], [rows]).n_instructions()) is is_shared
