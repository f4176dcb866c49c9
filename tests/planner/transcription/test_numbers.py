"""A system without its numbers: the same values, one structure for mechanisms of one kind."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.closed_chain.mechanics import NodeTerms, mechanism_system
from linkplan.planner.transcription.program import node_key, without_numbers
from linkplan.planner.transcription.system import System
from tests.support.fourbar_problems import random_case

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
    xi, theta = rng.uniform(0.2, 1.2, system.n_xi), rng.uniform(0.5, 2.0, system.n_theta)
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
