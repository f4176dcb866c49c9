"""Loops closed by welds, couplings, ball joints and on moving bodies: against MuJoCo, plainer models and energy."""

import copy
from functools import cache

import numpy as np
import pytest
import scipy.integrate

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.reach import reach
from tests.support.linkages import COUNTS, LEG, LINKAGES, loaded
from tests.support.mechanisms import Simulated, derivative, replaced, simulated
from tests.support.servos import controls
from tests.support.tolerances import GAP_M, INTEGRATED_GAP, POWER, RANDOM_LIMIT, REACH_END, REDUCED, TREE, relative_error

N_POSES = 3
SOFTNESS = (1e-5, 1e-6)
on_every_linkage = pytest.mark.parametrize("name", LINKAGES)


@cache
def samples(name: str) -> list[tuple[np.ndarray, ...]]:
    """Return closed poses with speeds, all joints' rates and efforts: (q, v, q', u)."""
    mechanism, rng = loaded(name), np.random.default_rng(5)
    s = mechanism.home[mechanism.independent] + rng.uniform(-0.2, 0.2, (N_POSES, mechanism.dof))
    q, v = np.array([close_at(mechanism, x) for x in s]), rng.normal(size=s.shape)
    return list(zip(q, v, joint_rates(mechanism, q, v), rng.uniform(-1, 1, (N_POSES, mechanism.n_u)), strict=True))


def in_mujoco(
    mechanism: Mechanism, q: np.ndarray, rates: np.ndarray, u: np.ndarray | None = None, softness: float = 1.0
) -> Simulated:
    """Return MuJoCo's quantities at internal coordinates and rates under efforts u, its constraints made harder."""
    model = copy.copy(mechanism.model)
    for array in (model.actuator_ctrllimited, model.actuator_forcelimited):
        array[:] = False
    state = mechanism.qpos_of(q), mechanism.qvel_of(q, rates)
    return simulated(model, *state, None if u is None else controls(mechanism, *state, u), softness=softness)


@on_every_linkage
def test_freedom_rows_and_rank_are_those_counted_by_hand(name):
    mechanism = loaded(name)
    assert (mechanism.dof, mechanism.n_closure_rows, len(mechanism.closure_rows)) == COUNTS[name]
    assert mechanism.gap_m(mechanism.home) < GAP_M


@on_every_linkage
def test_the_velocity_map_is_within_the_null_space_of_mujocos_rows(name):
    mechanism = loaded(name)
    for q, v, rates, _ in samples(name):
        rows = in_mujoco(mechanism, q, rates).rows
        assert np.abs(rows).max() > 0.01, "the loop is closed in MuJoCo"
        assert np.abs(rows @ mechanism.qvel_of(q, rates)).max() < REDUCED * np.abs(v).max()
        assert np.linalg.matrix_rank(rows, tol=1e-9) == mechanism.n_q - mechanism.dof


@on_every_linkage
def test_acceleration_is_the_limit_of_mujocos_as_the_loop_hardens(name):
    mechanism = loaded(name)
    for q, v, rates, u in samples(name):
        first, second = (in_mujoco(mechanism, q, rates, u, s).acceleration for s in SOFTNESS)
        hard = (SOFTNESS[0] * second - SOFTNESS[1] * first) / (SOFTNESS[0] - SOFTNESS[1])
        assert relative_error(chart_acceleration(mechanism, q, v, u), hard) < RANDOM_LIMIT


def chart_acceleration(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the derivative of MuJoCo's qvel along the reduced flow, by central differences of qvel(q, q')."""
    a = np.array(mechanism.dynamics.acceleration(q, v, u)).ravel()

    def qvel(t: float) -> np.ndarray:
        s = q[mechanism.independent] + v * t + a * t**2 / 2
        pose = close_at(mechanism, s, start=q)
        rates = np.array(mechanism.dynamics.velocity_map(pose)) @ (v + a * t)
        return mechanism.qvel_of(pose, rates)

    return derivative(qvel, 1e-4)


@on_every_linkage
def test_closure_forces_act_on_the_joints_as_mujocos_constraints_do(name):
    mechanism = loaded(name)
    for q, v, rates, u in samples(name):
        first, second = (in_mujoco(mechanism, q, rates, u, s).constraint_force for s in SOFTNESS)
        hard = (SOFTNESS[0] * second - SOFTNESS[1] * first) / (SOFTNESS[0] - SOFTNESS[1])
        assert np.abs(hard).max() > 1e-4, "the loop carries load"
        a = mechanism.dynamics.acceleration(q, v, u)
        force = np.array(mechanism.dynamics.closure_force(q, v, a, u)).ravel()
        jacobian = np.array(mechanism.dynamics.closure_jacobian(q))
        expected = np.array([mechanism.qvel_of(q, rate) for rate in np.eye(mechanism.n_q)]) @ hard
        assert relative_error(jacobian.T @ force, expected) < RANDOM_LIMIT


@on_every_linkage
def test_energy_gained_is_work_less_dissipation_and_the_loop_stays_closed(name):
    mechanism = loaded(name)
    dynamics, n_q, n_s = mechanism.dynamics, mechanism.n_q, mechanism.dof

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        q, v = y[:n_q], y[n_q : n_q + n_s]
        u = np.full(mechanism.n_u, 0.05 * np.cos(20 * t))
        dq, dv = (np.array(x).ravel() for x in dynamics.flow(q, v, u))
        damper = np.array(dynamics.passive(q, dq) - dynamics.passive(q, np.zeros(n_q))).ravel()
        return np.concatenate([dq, dv, [v @ np.array(dynamics.effort_map(q)) @ u, -damper @ dq]])

    start = np.concatenate([mechanism.home, np.zeros(n_s), [0.0, 0.0]])
    end = scipy.integrate.solve_ivp(rates, (0, 0.05), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    first, last = (sum(float(e) for e in dynamics.energy(y[:n_q], y[n_q : n_q + n_s])) for y in (start, end))
    work, dissipated = end[-2:]
    kinetic = float(dynamics.energy(end[:n_q], end[n_q : n_q + n_s])[0])
    assert min(abs(work), dissipated, kinetic) > 0, "it moves, driven and damped"
    assert abs(last - first - work + dissipated) < POWER * max(abs(work), dissipated, kinetic)
    assert mechanism.gap_m(end[:n_q]) < INTEGRATED_GAP


# Loops that ride


def test_a_loop_on_a_turning_leg_is_as_regular_at_a_quarter_turn_as_at_none():
    mechanism = loaded("leg")
    s = np.array(mechanism.home[mechanism.independent])
    turned = s.copy()
    turned[0] = np.pi / 2
    straight, across = (abs(float(mechanism.dynamics.block_singularity(close_at(mechanism, x)))) for x in (s, turned))
    assert straight > 1e-4, "the loop is regular"
    assert abs(across / straight - 1) < TREE


def test_the_closure_of_a_leg_depends_on_no_joint_above_it():
    mechanism = loaded("leg")
    jacobian = np.array(mechanism.dynamics.closure_jacobian(np.ones(mechanism.n_q)))
    assert np.abs(jacobian).max() > 0.01
    assert not np.any(jacobian[:, :2])


@pytest.mark.slow
def test_a_reach_of_a_leg_ends_where_its_own_loop_does():
    turned = replaced(LEG, '<body name="hip" pos="0 0 1">', '<body name="hip" pos="0 0 1" quat="0.3 0.8 -0.1 0.5">')
    first, second = (reach(load_mechanism(text), 2) for text in (LEG, turned))
    assert first.upper.reason == second.upper.reason
    assert abs(first.upper.position - second.upper.position) < REACH_END
