"""Transcriptions: exactness on polynomials, known tableaux, guarded constants, and the order that each one claims."""

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from linkplan.models.errors import ProblemError
from linkplan.planner.transcription.bernstein import bernstein_matrix
from linkplan.planner.transcription.schemes import MAX_DEGREE, NAMES, Scheme, scheme
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, TURN, body_plan
from tests.support.tolerances_planner import EFFORT_JUMP, EXACT_EFFORT, UNIT, UNIT_VALUES

FIRST_ORDER = ("trapezoid", "hermite-simpson")
CONSISTENT = tuple(name for name in NAMES if name not in FIRST_ORDER)
TAU = np.linspace(0.0, 1.0, 41)


@pytest.mark.parametrize("name", NAMES)
def test_velocity_and_position_are_exact_for_every_polynomial_acceleration_below_the_number_of_nodes(name):
    constants = scheme(name)
    for power in range(constants.n_nodes):
        exact = constants.nodes ** (power + 1) / (power + 1)
        np.testing.assert_allclose(constants.velocity @ constants.nodes**power, exact, atol=UNIT)
        if name in CONSISTENT:
            exact = constants.nodes ** (power + 2) / ((power + 1) * (power + 2))
            np.testing.assert_allclose(constants.position @ constants.nodes**power, exact, atol=UNIT)


@pytest.mark.parametrize("name", CONSISTENT)
def test_interpolants_agree_with_the_polynomial_between_the_nodes(name):
    constants = scheme(name)
    m = constants.n_nodes
    acceleration = Polynomial(np.random.default_rng(m).normal(size=m))
    velocity, position = acceleration.integ(1), acceleration.integ(2)
    values = acceleration(constants.nodes)
    for degree, coefficients, exact in (
        (m, constants.velocity_coefficients, velocity),
        (m + 1, constants.position_coefficients, position),
    ):
        np.testing.assert_allclose(bernstein_matrix(degree, TAU) @ coefficients @ values, exact(TAU), atol=UNIT_VALUES)


@pytest.mark.parametrize("name", FIRST_ORDER)
def test_a_first_order_form_integrates_the_polynomial_through_its_nodal_velocities(name):
    """Its position is not the acceleration's second integral: that is what the consistent form mends."""
    constants, consistent = scheme(name), scheme(f"{name}-consistent")
    values = np.random.default_rng(1).normal(size=constants.n_nodes)
    nodal_velocity = constants.velocity @ values
    slope = np.diff(constants.position_coefficients @ values) * (len(constants.position_coefficients) - 1)
    at_nodes = bernstein_matrix(len(slope) - 1, constants.nodes) @ slope
    np.testing.assert_allclose(at_nodes, nodal_velocity, atol=UNIT)
    between = [
        bernstein_matrix(len(c) - 1, TAU) @ c for c in (constants.position_coefficients, consistent.position_coefficients)
    ]
    assert np.abs(between[0] - between[1]).max() > 1e-3


def test_radau_2_is_the_radau_iia_tableau():
    np.testing.assert_allclose(scheme("radau-2").velocity, [[5 / 12, -1 / 12], [3 / 4, 1 / 4]], atol=UNIT)


def test_hermite_simpson_is_the_lobatto_iiia_tableau():
    expected = [[0, 0, 0], [5 / 24, 1 / 3, -1 / 24], [1 / 6, 2 / 3, 1 / 6]]
    np.testing.assert_allclose(scheme("hermite-simpson").velocity, expected, atol=UNIT)


@pytest.mark.parametrize("field", [f.name for f in fields(scheme("radau-3")) if f.name != "name"])
@pytest.mark.parametrize("name", ["radau-3", "hermite-simpson"])
def test_a_constant_that_is_off_by_one_in_a_hundred_is_refused(name, field):
    with pytest.raises(ValueError, match="inconsistent"):
        replace(scheme(name), **{field: 1.01 * getattr(scheme(name), field)})


def test_nodes_out_of_order_are_refused():
    constants = scheme("radau-3")
    with pytest.raises(ValueError, match="inconsistent"):
        replace(constants, nodes=constants.nodes[::-1].copy())


@pytest.mark.parametrize("name", ["radau-0", "radau-10", "radau", "gauss-0", "Radau-3", "radau-3 ", "", "radau--3"])
def test_an_unknown_scheme_is_refused_with_the_legal_names(name):
    with pytest.raises(ProblemError, match=r"hermite-simpson-consistent, radau-1 to radau-9 and gauss-1 to gauss-9"):
        scheme(name)


# A single body: its optimum has a closed form.


TURN_MOTION = QUARTER_TURN + "duration_s = 1.5\n"


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("radau-1", "gauss-1", "trapezoid")])
def test_a_pure_inertia_is_turned_with_twelve_inertia_squared_angle_squared_over_time_cubed(name):
    plan = body_plan(HINGE, TURN_MOTION, f"mesh.scheme={name}", "mesh.intervals=4").require()
    assert plan.objective == pytest.approx(12 * HINGE_INERTIA**2 * TURN**2 / 1.5**3, rel=EXACT_EFFORT)


def test_the_least_effort_of_a_pure_inertia_is_a_straight_line():
    plan = body_plan(HINGE, TURN_MOTION).require()
    time = np.linspace(0, 1.5, 301)[:-1]
    line = 6 * HINGE_INERTIA * TURN / 1.5**2 * (1 - 2 * time / 1.5)
    np.testing.assert_allclose(plan.trajectory.effort_at(time)[:, 0], line, atol=EFFORT_JUMP)


@pytest.mark.parametrize(
    ("name", "effort", "coefficients"),
    [
        ("radau-3", "constant", 1),
        ("radau-3", "linear", 2),
        ("radau-3", "polynomial", 3),
        ("radau-1", "linear", 1),
        ("gauss-5", "polynomial", 5),
        ("trapezoid", "linear", 2),
    ],
)
def test_efforts_have_the_degree_asked_for_up_to_that_through_all_nodes(name, effort, coefficients):
    chosen = scheme(name, effort)
    assert chosen.effort_at.shape == (chosen.n_nodes, coefficients)


@pytest.mark.parametrize("family", ["radau", "gauss"])
def test_schemes_have_degrees_from_one_to_nine(family):
    for degree in range(1, 10):
        assert scheme(f"{family}-{degree}").n_nodes == degree
    for degree in (0, 10):
        with pytest.raises(ProblemError, match="radau-1 to radau-9"):
            scheme(f"{family}-{degree}")


# Over this time [rad of phase] the error of the coarsest meshes is large enough for nine nodes to leave rounding alone.
PHASE = 20.0
# Between these errors a scheme is neither too coarse to show its order nor at the machine's rounding.
WINDOW = (3e-11, 3e-3)
# Orders are measured on three meshes or more; what is left of the next terms keeps them this close [1]; from order ten on,
# where rounding leaves meshes of a radian or two an interval only, this close relative to the order.
MEASURED, MEASURED_HIGH = 0.35, 0.09
CLAIMED = {"trapezoid": 2, "trapezoid-consistent": 2, "hermite-simpson": 4, "hermite-simpson-consistent": 4}
CLAIMED |= {f"radau-{m}": 2 * m - 1 for m in range(1, MAX_DEGREE + 1)}
CLAIMED |= {f"gauss-{m}": 2 * m for m in range(1, MAX_DEGREE + 1)}


def error_after(constants: Scheme, steps: int) -> float:
    """Return how far s and v are from cos and -sin after `steps` equal intervals, each collocated: a_i = -s_i."""
    h, m = PHASE / steps, constants.n_nodes
    a = np.linalg.solve(np.eye(m) + h**2 * constants.position, -np.column_stack([np.ones(m), h * constants.nodes]))
    interval = np.vstack([[1.0, h] + h**2 * constants.position_end @ a, [0.0, 1.0] + h * constants.velocity_end @ a])
    s, v = np.linalg.matrix_power(interval, steps) @ [1.0, 0.0]
    return float(np.hypot(s - np.cos(PHASE), v + np.sin(PHASE)))


@pytest.mark.parametrize("name", NAMES)
def test_every_scheme_has_the_order_that_it_claims(name):
    constants = scheme(name)
    order = CLAIMED[name]
    steps = np.unique(np.round(np.geomspace(3, 60_000 if order < 3 else 3000, 60)).astype(int))
    errors = np.array([error_after(constants, int(n)) for n in steps if n * order < 120_000])
    steps = steps[: len(errors)]
    inside = (errors > WINDOW[0]) & (errors < WINDOW[1])
    assert inside.sum() >= 3
    slope = -np.polyfit(np.log(steps[inside]), np.log(errors[inside]), 1)[0]
    assert slope == pytest.approx(order, abs=max(MEASURED, MEASURED_HIGH * order))


def test_no_scheme_is_without_a_claim():
    assert set(CLAIMED) == set(NAMES)
