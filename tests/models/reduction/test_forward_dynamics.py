"""Accelerations of many joints: the mass matrix is factorised in numbers, and not in formulas."""

import mujoco
import numpy as np
import pytest

from linkplan.models.mechanism import Mechanism, load_mechanism

_LINK = '<body pos="0.1 0 0"><joint name="j{k}" axis="0 {c} {s}"/><geom type="capsule" size="0.01" fromto="0 0 0 0.1 0 0"/>'


@pytest.fixture(scope="module", name="chain")
def _chain() -> Mechanism:
    links = "".join(_LINK.format(k=k, c=np.cos(k), s=np.sin(k)) for k in range(24))
    motors = "".join(f'<motor joint="j{k}"/>' for k in range(24))
    world = f"<worldbody>{links}{'</body>' * 24}</worldbody>"
    return load_mechanism(f"<mujoco>{world}<actuator>{motors}</actuator></mujoco>")


def test_the_accelerations_of_a_long_chain_are_those_of_mujoco(chain: Mechanism):
    rng = np.random.default_rng(3)
    q, v, u = rng.uniform(-1, 1, (3, chain.dof))
    data = mujoco.MjData(chain.model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
    mujoco.mj_forward(chain.model, data)
    rates, a = (np.array(one).ravel() for one in chain.dynamics.flow(q, v, u))
    np.testing.assert_array_equal(rates, v)
    np.testing.assert_allclose(a, data.qacc, rtol=1e-7, atol=1e-7 * np.abs(data.qacc).max())


def test_the_solution_adds_no_formulas_to_those_of_a_long_chain(chain: Mechanism):
    dynamics = chain.dynamics
    parts = (dynamics.reduced_inertia, dynamics.inverse_dynamics, dynamics.velocity_map, dynamics.effort_map)
    assert len(dynamics.flow.serialize()) < sum(len(part.serialize()) for part in parts)


def test_the_linearisation_of_a_long_chain_is_the_derivative_of_its_accelerations(chain: Mechanism):
    rng = np.random.default_rng(4)
    q, v, u, along = rng.uniform(-1, 1, (4, chain.dof))
    by_s, by_v, by_u = (np.array(one) for one in chain.dynamics.linearisation(q, v, u))
    h = 1e-5
    for by, place in ((by_s, 0), (by_v, 1), (by_u, 2)):
        ahead, back = [q, v, u], [q, v, u]
        ahead[place], back[place] = ahead[place] + h * along, back[place] - h * along
        a, b = (np.array(chain.dynamics.acceleration(*at)).ravel() for at in (ahead, back))
        slope = (a - b) / (2 * h)
        np.testing.assert_allclose(by @ along, slope, atol=1e-6 * np.abs(slope).max())
