"""Loop closure and the reduced dynamics: against MuJoCo's constrained dynamics, null spaces, energy and differences."""

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

from linkplan.models.closure import newton
from linkplan.models.closure.rank import dependent_columns
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import joint_rates, needed_effort, sampled
from linkplan.models.poses.assembly import close_at
from linkplan.models.reduction.reduced import linearised
from tests.support.closures import FOUR_BARS, N_POSES, Case, case
from tests.support.mechanisms import CHAINS, derivative, random_four_bar, second_derivative, simulated
from tests.support.tolerances import CLOSURE, DIFFERENCES, MOTION_FROM_EFFORT, REDUCED, SOFT_LIMIT, relative_error

NAMES = (*FOUR_BARS, *CHAINS)
on_every_mechanism = pytest.mark.parametrize("name", NAMES)


def null_space_map(mechanism: Mechanism, rows: np.ndarray) -> np.ndarray:
    """Return Gamma from a basis of the null space of all constraint rows, scaled to the independent joints' rates."""
    basis = scipy.linalg.null_space(rows, rcond=1e-9)
    assert basis.shape == (mechanism.n_q, mechanism.dof)
    return basis @ np.linalg.inv(basis[mechanism.independent])


@on_every_mechanism
def test_the_closure_equations_and_their_jacobian_are_mujocos_where_the_loop_is_open(name):
    mechanism = case(name).mechanism
    for q in np.random.default_rng(0).uniform(-1, 1, (N_POSES, mechanism.n_q)):
        expected = simulated(mechanism.model, q, np.zeros_like(q))
        assert np.abs(expected.residual).max() > 1e-3, "the loop is open"
        assert np.abs(np.array(mechanism.dynamics.closure(q)).ravel() - expected.residual).max() < CLOSURE
        assert np.abs(np.array(mechanism.dynamics.closure_jacobian(q)) - expected.rows).max() < CLOSURE


@on_every_mechanism
def test_reduced_inertia_and_gravity_effort_are_the_mass_matrix_and_the_weight_projected_on_the_motion(name):
    c = case(name)
    dynamics = c.mechanism.dynamics
    for k, q in enumerate(c.q):
        s, weight = c.simulated(k), simulated(c.mechanism.model, q, np.zeros_like(q)).bias
        basis = null_space_map(c.mechanism, s.rows)
        assert relative_error(np.array(dynamics.reduced_inertia(q)), basis.T @ s.mass_matrix @ basis) < REDUCED
        assert relative_error(np.array(dynamics.gravity_effort(q)).ravel(), basis.T @ weight) < REDUCED


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("anchor_form", [False, True])
def test_the_pin_force_of_an_upright_four_bar_is_mujocos_efc_force(seed, anchor_form):
    rng = np.random.default_rng(seed)
    bar = random_four_bar(rng)
    turn = rng.uniform(-np.pi, np.pi)
    about_y = np.array([np.cos(turn / 2), 0, np.sin(turn / 2), 0])
    mechanism = load_mechanism(bar.mjcf(rng, quaternion=about_y, anchor_form=anchor_form))
    q, v, u = bar.samples(rng, 1), rng.normal(size=(1, 1)), rng.normal(size=(1, 1))
    expected = Case(mechanism=mechanism, q=q, v=v, a=v, u=u).limit(0, "row_force")
    assert np.abs(expected).max() > 1e-3, "the pin carries load"
    a = mechanism.dynamics.acceleration(q[0], v[0], u[0])
    force = np.array(mechanism.dynamics.closure_force(q[0], v[0], a, u[0])).ravel()
    assert relative_error(force, expected) < SOFT_LIMIT


def path_derivatives(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, a: np.ndarray, h: float):
    """Return q' and q'' at q of the motion s = s0 + v t + a t^2 / 2, by differences of assembled poses."""
    s = q[mechanism.independent]

    def pose(t: float) -> np.ndarray:
        return close_at(mechanism, s + v * t + a * t**2 / 2, start=q)

    return derivative(pose, h), second_derivative(pose, h)


@on_every_mechanism
def test_joint_rates_are_the_derivative_of_the_assembled_pose(name):
    c = case(name)
    rates = joint_rates(c.mechanism, c.q, c.v)
    for k, (q, v, a, _) in enumerate(c.samples()):
        assert relative_error(rates[k], path_derivatives(c.mechanism, q, v, a, 1e-3)[0]) < DIFFERENCES


@on_every_mechanism
def test_acceleration_undoes_inverse_dynamics(name):
    c = case(name)
    dynamics = c.mechanism.dynamics
    for q, v, _, u in c.samples():
        needed = np.array(dynamics.inverse_dynamics(q, v, dynamics.acceleration(q, v, u))).ravel()
        assert relative_error(needed, np.array(dynamics.effort_map(q) @ u).ravel()) < REDUCED


@on_every_mechanism
def test_linearisation_by_position_speed_and_effort_is_the_difference_along_the_closed_chain(name):
    c = case(name)
    mechanism, dynamics = c.mechanism, c.mechanism.dynamics
    for q, v, _, u in c.samples():

        def acceleration(h: float, k: int, i: int, q=q, at=(q[mechanism.independent], v, u)) -> np.ndarray:
            s, *others = (x + h * (j == k) * (np.arange(len(x)) == i) for j, x in enumerate(at))
            return np.array(dynamics.acceleration(close_at(mechanism, s, start=q), *others)).ravel()

        for k, found in enumerate(map(np.array, dynamics.linearisation(q, v, u))):
            expected = [derivative(lambda h, k=k, i=i: acceleration(h, k, i), 1e-3) for i in range(found.shape[1])]
            assert relative_error(found, np.transpose(expected)) < DIFFERENCES


@on_every_mechanism
def test_linearised_at_a_pose_is_the_linearisation_there(name):
    c = case(name)
    for q, v, _, u in c.samples():
        both = zip(linearised(c.mechanism.dynamics, q, v, u), c.mechanism.dynamics.linearisation(q, v, u), strict=True)
        for actual, expected in both:
            assert relative_error(actual, np.array(expected)) < REDUCED


@on_every_mechanism
def test_needed_efforts_produce_the_motion(name):
    c = case(name)
    effort, missed = needed_effort(c.mechanism, c.q, c.v, c.a)
    assert np.abs(missed).max() < REDUCED * np.abs(sampled(c.mechanism.dynamics.inverse_dynamics, c.q, c.v, c.a)).max()
    actual = sampled(c.mechanism.dynamics.acceleration, c.q, c.v, effort)[:, :, 0]
    assert relative_error(actual, c.a) < MOTION_FROM_EFFORT


def test_needed_efforts_are_the_least_that_do():
    c = case("four-bar 0")
    assert c.mechanism.n_u == 3, "there are more motors than degrees of freedom"
    effort, _ = needed_effort(c.mechanism, c.q, c.v, c.a)
    for q, u in zip(c.q, effort, strict=True):
        spare = scipy.linalg.null_space(np.array(c.mechanism.dynamics.effort_map(q)))
        assert np.abs(spare.T @ u).max() < REDUCED * np.abs(u).max()


@pytest.mark.parametrize("gap_m", [0.0, 5e-10])
def test_newton_ends_where_only_rounding_can_be_reduced(gap_m):
    """cos(q) = 0.8 from q = 0.6: quadratic convergence takes four steps; the second row is a gap that no pose closes."""
    evaluated = []

    def residual(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        evaluated.append(float(q[0]))
        return np.array([np.cos(q[0]) - 0.8, gap_m]), np.array([[-np.sin(q[0])], [0.0]])

    q, phi = newton.root_by_newton(residual, np.array([0.6]), [0])
    assert abs(q[0] - np.arccos(0.8)) < 1e-15
    assert phi[1] == gap_m
    assert len(evaluated) <= 6


def test_a_column_of_rounding_errors_is_not_chosen_as_a_dependent_one():
    jacobian = np.array([[1e-14, 1.0, 0.5], [0.0, 0.0, 1.0]])
    assert dependent_columns(jacobian, 2, [[0], [1, 2]]).tolist() == [1, 2]
    jacobian[0, 0] = 1e-3
    assert dependent_columns(jacobian, 2, [[0], [1, 2]]).tolist() == [0, 2]
