"""The expressions that every mechanism builds grow with the square of its degrees of freedom at most."""

from dataclasses import fields

import casadi as ca
import numpy as np

from linkplan.models.mechanism import load_mechanism
from linkplan.models.reduction.reduced import acceleration_at


def chain(n: int) -> str:
    opened = "".join(
        f'<body pos="0.1 0 0"><joint name="j{k}" axis="0 {1 - k % 2} {k % 2}"/><geom size="0.01" pos="0.05 0 0"/>'
        for k in range(n)
    )
    return f"<mujoco><worldbody>{opened}{'</body>' * n}</worldbody><actuator><motor joint='j0'/></actuator></mujoco>"


def test_twice_the_freedoms_have_at_most_four_times_the_instructions():
    """The symbolic solution of M a = b has eight times as many."""
    totals = []
    for n in (20, 40):
        dynamics = load_mechanism(chain(n)).dynamics
        built = [getattr(dynamics, field.name) for field in fields(dynamics)]
        totals.append(sum(one.n_instructions() for one in built if isinstance(one, ca.Function)))
    assert totals[0] > 10_000
    assert totals[1] < 4.5 * totals[0], totals


def test_the_acceleration_in_numbers_is_that_of_the_expressions():
    mechanism = load_mechanism("five-bar")
    random = np.random.default_rng(2)
    v, u = random.normal(size=mechanism.dof), random.normal(size=mechanism.n_u)
    exact = np.array(mechanism.dynamics.acceleration(mechanism.home, v, u)).ravel()
    np.testing.assert_allclose(acceleration_at(mechanism.dynamics, mechanism.home, v, u), exact, rtol=1e-10)
