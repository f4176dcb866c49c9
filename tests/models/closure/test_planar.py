"""Random planar mechanisms of one to three loops against MuJoCo: tree, actuators, constrained motion, forces.

Thirty seeds by default; LINKPLAN_PLANAR=200 in the environment runs two hundred.
"""

import os
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import close_at
from tests.support.mechanisms import simulated
from tests.support.planar import Planar, random_planar
from tests.support.servos import controls
from tests.support.tolerances import GAP_M, MOMENT, RANDOM_LIMIT, relative_error

N_SEEDS = int(os.environ.get("LINKPLAN_PLANAR", "30"))
# Of these, so many are in the quick set.
N_QUICK = 8
N_POSES = 2
SOFTNESS = (1e-5, 1e-6)
on_every_seed = pytest.mark.parametrize(
    "seed", [seed if seed < N_QUICK else pytest.param(seed, marks=pytest.mark.slow) for seed in range(N_SEEDS)]
)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Case:
    """A generated mechanism with closed poses q (n, n_q), and speeds v and efforts u to go with them."""

    planar: Planar
    mechanism: Mechanism
    q: np.ndarray
    v: np.ndarray
    u: np.ndarray

    def samples(self):
        return zip(self.q, self.v, joint_rates(self.mechanism, self.q, self.v), self.u, strict=True)


@cache
def case(seed: int) -> Case:
    planar = random_planar(seed)
    mechanism = load_mechanism(planar.text)
    rng = np.random.default_rng(seed)
    centre, poses = mechanism.home[mechanism.independent], []
    while len(poses) < N_POSES:
        try:
            poses.append(close_at(mechanism, centre + rng.uniform(-0.2, 0.2, mechanism.dof)))
        except AssemblyError:  # beyond the reach: elsewhere then
            continue
    shape = (N_POSES, mechanism.dof)
    u = rng.uniform(-1, 1, (N_POSES, mechanism.n_u))
    return Case(planar=planar, mechanism=mechanism, q=np.array(poses), v=rng.normal(size=shape), u=u)


def limit(c: Case, k: int, quantity: str) -> np.ndarray:
    """Return MuJoCo's quantity for a constraint of no softness, extrapolated from two small softnesses."""
    q, _, rates, u = list(c.samples())[k]
    ctrl = controls(c.mechanism, q, rates, u)
    first, second = (getattr(simulated(c.mechanism.model, q, rates, ctrl, softness=s), quantity) for s in SOFTNESS)
    return (SOFTNESS[0] * second - SOFTNESS[1] * first) / (SOFTNESS[0] - SOFTNESS[1])


@pytest.mark.slow
def test_the_generator_makes_mechanisms_of_every_kind():
    made = [random_planar(seed) for seed in range(30)]
    assert {planar.n_loops for planar in made} == {1, 2, 3}
    assert {kind for planar in made for kind in planar.closures} == {"connect", "fork", "weld"}
    assert {planar.rides for planar in made} == {True, False}
    assert {a.is_servo for seed in range(30) for a in case(seed).mechanism.actuators} == {True, False}
    targets = {a.target.split()[0] for seed in range(30) for a in case(seed).mechanism.actuators}
    assert targets == {"joint", "tendon", "site", "slider-crank"}
    assert any(case(seed).mechanism.model.body_mass.min() < 2e-4 for seed in range(30))


@pytest.mark.slow
@on_every_seed
def test_each_loop_takes_its_own_freedom_and_leaves_that_of_the_crank(seed):
    c = case(seed)
    assert c.mechanism.dof == c.planar.dof
    assert max(c.mechanism.gap_m(q) for q in c.q) < GAP_M


@on_every_seed
def test_actuator_moments_are_mujocos_through_every_transmission(seed):
    c = case(seed)
    for q, _, rates, _ in c.samples():
        expected = simulated(c.mechanism.model, q, rates).moment
        gamma = np.array(c.mechanism.dynamics.velocity_map(q))
        assert relative_error(np.array(c.mechanism.dynamics.effort_matrix(q)), expected.T) < MOMENT
        assert relative_error(np.array(c.mechanism.dynamics.effort_map(q)), gamma.T @ expected.T) < MOMENT


@on_every_seed
def test_acceleration_is_the_limit_of_mujocos_as_the_loops_harden(seed):
    c = case(seed)
    for k, (q, v, _, u) in enumerate(c.samples()):
        expected = limit(c, k, "acceleration")[c.mechanism.independent]
        actual = np.array(c.mechanism.dynamics.acceleration(q, v, u)).ravel()
        assert relative_error(actual, expected) < RANDOM_LIMIT


@pytest.mark.slow
@on_every_seed
def test_closure_forces_act_on_the_joints_as_mujocos_constraints_do(seed):
    c = case(seed)
    for k, (q, v, _, u) in enumerate(c.samples()):
        expected = limit(c, k, "constraint_force")
        assert np.abs(expected).max() > 1e-3, "the pins carry load"
        a = c.mechanism.dynamics.acceleration(q, v, u)
        force = np.array(c.mechanism.dynamics.closure_force(q, v, a, u)).ravel()
        jacobian = np.array(c.mechanism.dynamics.closure_jacobian(q))
        assert relative_error(jacobian.T @ force, expected) < RANDOM_LIMIT
