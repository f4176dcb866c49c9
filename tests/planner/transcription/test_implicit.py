"""Unknowns that a node's equations determine: values, derivatives, and the motion of a mechanism's dependent joints."""

import casadi as ca
import numpy as np
import pytest

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import accelerations, joint_jerk, joint_rates
from linkplan.planner.closed_chain.mechanics import NodeTerms, closure_jerk, mechanism_system
from linkplan.planner.limits.joints import SpeedLimit
from linkplan.planner.limits.pins import ClosureForceLimit
from linkplan.planner.problem.instant import unit_scales
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.transcription.implicit import Implicit
from linkplan.planner.transcription.system import System, build_node
from tests.support.hexapod import hexapod
from tests.support.tolerances_planner import ROWS

# Derivatives of two forms of one function.
ROUNDED = 1e-11


def dense(values: ca.DM, pattern: tuple[np.ndarray, np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """Return a matrix from its nonzeros."""
    matrix = np.zeros(shape)
    matrix[pattern] = np.array(values).ravel()
    return matrix


def test_derivatives_are_those_of_the_solution_inserted():
    """The second block has the first one's matrix and the third one its transpose, as rates, accelerations and forces."""
    w, y = ca.SX.sym("w", 3), ca.SX.sym("y", 6)
    first, second, third = ca.vertsplit(y, 2)
    A = ca.blockcat([[2 + ca.sin(w[0]), w[1]], [w[2] ** 2, 3 + ca.cos(w[1])]])
    G = ca.vertcat(A @ first + 9 * w[:2] ** 2, A @ second + first**2 * w[2], A.T @ third - second * first * ca.exp(w[0]))
    F = ca.vertcat(w[0] * third[0] + second[1] ** 2, ca.sin(first[0]) * third[1] * w[1], w[2])
    implicit, lam = Implicit(w, y, G, (2, 2, 2)), ca.DM([0.3, -1.7, 0.4])
    inserted = implicit.inserted([F])[0]
    f = ca.dot(lam, F)
    found = implicit.inserted([ca.densify(implicit.jacobian(F)), *map(ca.densify, implicit.hessian(f))])
    hessian, gradient = ca.hessian(ca.dot(lam, inserted), w)
    expected = [ca.densify(ca.jacobian(inserted, w)), ca.densify(hessian), gradient]
    at = np.random.default_rng(0).uniform(0.2, 0.9, 3)
    values = ca.Function("values", [w], [*found, *expected, *implicit.inserted([G])])(at)
    for one, other in zip(values[:3], values[3:6], strict=True):
        assert np.abs(np.array(other)).max() > 0.1
        np.testing.assert_allclose(np.array(one), np.array(other), rtol=ROUNDED, atol=ROUNDED)
    assert np.abs(np.array(values[6])).max() < ROUNDED


def node_of(mechanism: Mechanism, rng: np.random.Generator, *, wrong: float = 0.0) -> tuple[np.ndarray, ...]:
    """Return a closed pose q, random v and u, and the accelerations that these efforts give, with a relative error."""
    v, u = rng.normal(size=mechanism.dof), rng.normal(size=mechanism.n_u)
    a = np.array(mechanism.dynamics.acceleration(mechanism.home, v, u)).ravel() * (1 + wrong)
    return mechanism.home, v, a, u


def stacked(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, a: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return a node's unknowns in SI."""
    return np.concatenate([q[mechanism.independent], v, a, q[mechanism.dependent], u])


MODELS = ["five-bar", "andrews-squeezer", hexapod()]
NAMES = ["five-bar", "squeezer", "hexapod"]


@pytest.mark.parametrize("model", MODELS, ids=NAMES)
def test_motions_of_the_reduced_dynamics_satisfy_the_equations_of_a_node(model):
    mechanism, rng = load_mechanism(model), np.random.default_rng(3)
    system, theta = mechanism_system(mechanism, NodeTerms()), unit_scales(mechanism).vector()
    value = build_node(system).node_value
    assert system.n_xi == 3 * mechanism.dof + len(mechanism.dependent) + mechanism.n_u  # nothing else is an unknown
    rows = np.array(value(stacked(mechanism, *node_of(mechanism, rng)), theta))
    wrong = np.array(value(stacked(mechanism, *node_of(mechanism, rng, wrong=1e-3)), theta))
    assert np.abs(rows).max() < ROWS
    assert np.abs(wrong).max() > 100 * ROWS


def reduced(mechanism: Mechanism, system: System) -> System:
    """Return the same system by the reduced residual, whose expressions contain the solution with J_z."""
    xi, theta = ca.SX.sym("xi", system.n_xi), ca.SX.sym("theta", system.n_theta)
    n_s, n_z = mechanism.dof, len(mechanism.dependent)
    s, v, a, z, u = ca.vertsplit(xi, [0, n_s, 2 * n_s, 3 * n_s, 3 * n_s + n_z, system.n_xi])
    order = np.argsort(np.concatenate([mechanism.independent, mechanism.dependent])).tolist()
    q, dynamics = ca.vertcat(s, z)[order], mechanism.dynamics
    column = ca.vertcat(dynamics.independent_closure(q), dynamics.residual(q, v, a, u), 0)
    node = ca.Function("node", [xi, theta], [ca.densify(column)])
    return System(
        n_s=n_s, n_z=n_z, n_x=0, n_u=system.n_u, node=node, n_equations=system.n_equations, n_path=0, kinds=system.kinds
    )  # fmt: skip


@pytest.mark.parametrize("model", MODELS[:2], ids=NAMES[:2])
def test_a_node_has_the_derivatives_of_the_reduced_equations_at_poses_that_are_not_closed(model):
    mechanism, rng = load_mechanism(model), np.random.default_rng(1)
    system = mechanism_system(mechanism, NodeTerms())
    xi = stacked(mechanism, *node_of(mechanism, rng)) + 0.01 * rng.normal(size=system.n_xi)
    theta, lam = unit_scales(mechanism).vector(), rng.normal(size=system.n_equations + 1)
    size, found = system.n_xi, []
    for one in (system, reduced(mechanism, system)):
        node = build_node(one)
        gradient, hessian = node.node_hessian(xi, theta, lam)
        jacobian = dense(node.node_jacobian(xi, theta), node.jacobian_pattern, (system.n_equations, size))
        found.append((jacobian, np.array(gradient).ravel(), dense(hessian, node.hessian_pattern, (size, size))))
    for ours, expected in zip(*found, strict=True):
        np.testing.assert_allclose(ours, expected, rtol=0, atol=ROUNDED * np.abs(expected).max())


@pytest.mark.parametrize("model", MODELS[:2], ids=NAMES[:2])
def test_limits_read_the_rates_and_pin_forces_of_the_solution(model):
    mechanism, rng = load_mechanism(model), np.random.default_rng(2)
    q, v, a, u = node_of(mechanism, rng)
    joint = int(mechanism.dependent[-1])
    limits = (SpeedLimit(joint), ClosureForceLimit(0))
    system = mechanism_system(mechanism, NodeTerms(limits=limits))
    speed, squared = np.array(
        build_node(system).node_value(stacked(mechanism, q, v, a, u), np.append(unit_scales(mechanism).vector(), 1.0))
    ).ravel()[system.n_equations :]
    assert speed == pytest.approx(joint_rates(mechanism, q[None], v[None])[0, joint], rel=ROUNDED)
    force = np.array(mechanism.dynamics.closure_force(q, v, a, u)).ravel()[mechanism.closure_slice(0)]
    assert squared == pytest.approx(force @ force, rel=1e-8)


@pytest.mark.parametrize("model", MODELS, ids=NAMES)
def test_jerks_that_keep_the_loops_closed_satisfy_the_equations_of_a_node(model):
    mechanism, rng = load_mechanism(model), np.random.default_rng(4)
    q, v, a, _ = node_of(mechanism, rng)
    jerk = rng.normal(size=mechanism.dof)
    of_joints = joint_rates(mechanism, q[None], v[None])[0], accelerations(mechanism, q[None], v[None], a[None])[0]
    jerks = np.array(joint_jerk(mechanism)(q, v, a, jerk)).ravel()
    size = np.abs(jerks).max()
    assert np.abs(np.array(closure_jerk(mechanism)(q, *of_joints, jerks))).max() < ROWS * size
    jerks[mechanism.dependent[0]] += 1e-3 * size
    assert np.abs(np.array(closure_jerk(mechanism)(q, *of_joints, jerks))).max() > 100 * ROWS * size


@pytest.mark.hardest
def test_a_platform_on_six_rods_is_raised_and_turned():
    goal = {f"s{k}": 0.03 + 0.02 * (-1) ** k for k in range(6)}
    ends = {"start_m": {f"s{k}": 0.0 for k in range(6)}, "goal_m": goal}
    plan = plan_motion(Problem.reach(hexapod(), **ends, duration_s=0.5, mesh={"intervals": 10}))
    assert plan.status == "optimal", plan.message
