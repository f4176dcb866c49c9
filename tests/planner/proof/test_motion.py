"""Enclosures of the planned curve, and of rates, efforts and forces along it."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy
from flint import arb, arb_series, ctx

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import demanded, joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.planner.problem.instant import Corner
from linkplan.planner.problem.table_reference import Spline
from linkplan.planner.proof.branch import newton
from linkplan.planner.proof.curve import enclosed
from linkplan.planner.proof.motion import Kinetics, Piece, _least, _squared
from linkplan.planner.proof.prove import TAYLOR_ORDER, states_of
from linkplan.planner.proof.taylor import TaylorForm
from linkplan.planner.proof.walk import blocks_of
from linkplan.planner.trajectory import Trajectory
from tests.support.motions import motion_along

CRANK = """<mujoco><worldbody>
<body><joint name="O" axis="0 1 0" damping="0.4"/><inertial pos="0.1 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
<body pos="0.3 0 0"><joint name="A" axis="0 1 0"/><inertial pos="0.4 0 0.1" mass="1" diaginertia="0.05 0.05 0.05"/>
<site name="tip" pos="0.8 0 0"/></body></body>
<body pos="1.1 0 0"><joint name="P" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<site name="pin"/></body></worldbody><equality><connect name="pin" site1="tip" site2="pin"/></equality>
<actuator>{actuators}</actuator></mujoco>"""
ONE = '<motor name="o" joint="A" gear="2" ctrlrange="-9 9"/>'
TWO = ONE + '<motor name="p" joint="P" gear="-3" ctrlrange="-9 9"/>'
TAU = 0.375


def motion(mechanism: Mechanism) -> Trajectory:
    """Return a cubic in 0.8 s, with linear efforts that are not its own."""
    position = np.array([0.4, 0.5, 0.9, 1.0])[:, None, None]
    efforts = np.array([[5.0, -1.0], [3.0, 2.0]])[:, None, : mechanism.n_u]
    start = follow(mechanism, np.linspace(0.0, 0.4, 5)[:, None], mechanism.home)[-1]
    return motion_along([1.0, 1.8], position, effort=efforts, start_pose=start)


def kinetics(mechanism: Mechanism) -> tuple[list[Kinetics], np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the series at a share of the interval, and pose, speed, acceleration and efforts there."""
    trajectory, blocks = motion(mechanism), blocks_of(mechanism)
    time = np.array([1.0 + TAU * 0.8])
    q = follow(mechanism, trajectory.position_at(np.linspace(1.0, time[0], 9)), trajectory.start_pose)[-1:]
    guess = newton(blocks, trajectory.position_at(time)[0], q[0, list(blocks.dependent)])
    middle, _, _ = states_of(blocks, Piece.of(trajectory, 0), (TAU, 2.0**-8), guess, [arb(0)], TAYLOR_ORDER)
    ctx.cap = TAYLOR_ORDER
    numbers = (f(time) for f in (trajectory.velocity_at, trajectory.acceleration_at, trajectory.effort_at))
    return [middle.of_position, middle.of_velocity], q, *numbers


def values(found) -> np.ndarray:
    return np.array([float((x if isinstance(x, arb) else x[0]).mid()) for x in found])


@pytest.mark.parametrize("actuators", [ONE, TWO], ids=["one motor", "two motors"])
def test_rates_efforts_and_forces_are_those_of_numbers(actuators):
    mechanism = load_mechanism(CRANK.format(actuators=actuators))
    both, q, v, a, u = kinetics(mechanism)
    tau, maps = demanded(mechanism, q, v, a)
    lacking = tau[0] - maps[0] @ u[0]
    forces = np.array(mechanism.dynamics.closure_force(q[0], v[0], a[0], u[0])).ravel()
    for one in both:  # from the positions, and from the velocities
        np.testing.assert_allclose(values(one.rates), joint_rates(mechanism, q, v)[0], rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(values(one.tau[0]), tau[0], rtol=1e-10)
        np.testing.assert_allclose(values(one.residual), lacking, rtol=1e-9)
        np.testing.assert_allclose(values(one.efforts()), u[0] + np.linalg.pinv(maps[0]) @ lacking, rtol=1e-9)
        np.testing.assert_allclose(values(one.closure_forces), forces, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(values(one.actuator_speeds), maps[0].T @ v[0], rtol=1e-10)


@pytest.mark.parametrize("actuators", [ONE, TWO], ids=["one motor", "two motors"])
def test_a_corner_s_machine_has_other_friction_and_weaker_motors(actuators):
    """Friction of 0.7 v + 0.2 on the slider, and nine tenths of the torque."""
    mechanism = load_mechanism(CRANK.format(actuators=actuators))
    (one, _), q, v, a, u = kinetics(mechanism)
    slide = [joint.name for joint in mechanism.joints].index("P")
    corner = Corner(payload_factor=1.0, torque_factor=0.9, friction=(("P", 0.7, 0.2),))
    tau, maps = demanded(mechanism, q, v, a)
    ratio = np.array(mechanism.dynamics.velocity_map(q[0]))[slide]
    needed = (tau[0] + ratio * (0.7 * (ratio @ v[0]) + 0.2)) / 0.9
    expected = u[0] + np.linalg.pinv(maps[0]) @ (needed - maps[0] @ u[0])
    np.testing.assert_allclose(values(one.efforts(corner)), expected, rtol=1e-9)


@pytest.mark.parametrize("shape", [(2, 3), (3, 2), (3, 3), (1, 4)])
def test_the_least_solution_is_that_of_the_pseudoinverse(shape):
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=shape), rng.normal(size=shape[0])
    entries = {(i, k): arb(float(x)) for (i, k), x in np.ndenumerate(A)}
    found = values(_least(entries, [arb(float(x)) for x in b], shape[1]))
    np.testing.assert_allclose(found, np.linalg.pinv(A) @ b, rtol=1e-9)
    square = _squared(entries, shape[0])
    np.testing.assert_allclose([[float(square[i, j].mid()) for j in range(shape[0])] for i in range(shape[0])], A @ A.T)


def test_a_piece_knows_its_width_and_when_it_begins_in_the_motion():
    mechanism = load_mechanism(CRANK.format(actuators=ONE))
    one = motion(mechanism)
    two = replace(
        one,
        breaks_s=np.array([1.0, 1.8, 2.1]),
        **{name: np.repeat(getattr(one, name), 2, axis=1) for name in ("position", "velocity", "effort")},
    )
    piece = Piece.of(two, 1)
    assert (piece.begin_s, float(piece.since), float(piece.width)) == pytest.approx((1.8, 0.8, 0.3))
    for share in (0.0, 0.3, 1.0):
        exact = two.position_at(np.array([1.8 + share * 0.3 - 1e-12 * share]))[0, 0]
        assert float(piece.position[0](arb(share)).mid()) == pytest.approx(exact, abs=1e-10)
    # The second interval is shorter than the first, whose speeds it has.
    assert Piece.of(two, 0).kinetics == ("of_position",)
    assert piece.kinetics == ("of_position", "of_velocity")


KNOTS = np.array([0.0, 0.2, 0.25, 0.6, 1.0])
ROWS = np.array([1.0, 4.0, -2.0, 3.0, 1.0])
ORDER = 6


def curve_of(kind: str, *, periodic: bool) -> tuple[Spline, object]:
    """Return a table's curve and the same function by numpy or scipy."""
    if kind == "cubic":
        through = scipy.interpolate.CubicSpline(KNOTS, ROWS, bc_type="periodic")
        known, c = through, through.c
    else:
        slope = np.diff(ROWS) / np.diff(KNOTS)
        known, c = (lambda t: np.interp(t, KNOTS, ROWS)), np.stack([0 * slope, 0 * slope, slope, ROWS[:-1]])
    return Spline(knots_s=KNOTS, coefficients=c[:, :, None], periodic=periodic), known


def form_on(curve: Spline, middle: float, radius: float) -> TaylorForm:
    """Return the Taylor form of a curve over times middle + radius x, with x in [-1, 1]."""
    ctx.prec, both = 80, []
    for at in (arb(0), arb(0, 1)):
        ctx.cap = ORDER + 2
        both.append(enclosed(curve, 0, arb_series([middle + radius * at, radius], prec=ORDER + 2)))
    return TaylorForm.of(*both, ORDER)


@pytest.mark.parametrize("kind", ["linear", "cubic"])
@pytest.mark.parametrize("periodic", [True, False])
def test_forms_contain_the_curve_on_every_box(kind, periodic):
    curve, known = curve_of(kind, periodic=periodic)
    rng, crossing = np.random.default_rng(1), 0
    for _ in range(300):
        radius = 10.0 ** rng.uniform(-4, -0.8)
        middle = rng.uniform(radius, (3.0 if periodic else 1.0) - radius)
        form, x = form_on(curve, middle, radius), np.linspace(-1.0, 1.0, 41)
        crossing += len(form.coefficients) < 4
        exact = known((middle + radius * x) % 1.0)
        for at, value in zip(x, exact, strict=True):
            ball = sum((c * float(at) ** k for k, c in enumerate(form.coefficients)), arb(0)) + arb(0, form.remainder)
            assert ball.overlaps(arb(float(value), 1e-12)), (middle, radius, at)
    assert crossing > 20, "boxes meet several pieces"


@pytest.mark.parametrize("kind", ["linear", "cubic"])
@pytest.mark.parametrize("periodic", [True, False])
def test_a_box_within_a_piece_is_enclosed_almost_exactly(kind, periodic):
    curve, _ = curve_of(kind, periodic=periodic)
    for begin, end in itertools.pairwise(KNOTS):
        form = form_on(curve, float(periodic) + 0.5 * (begin + end), 0.5 * (end - begin))
        assert float(form.remainder) < 1e-12
        assert float(form.coefficients[0].rad()) < 1e-6


@pytest.mark.parametrize("kind", ["linear", "cubic"])
def test_boxes_across_a_knot_shrink_with_their_width(kind):
    curve, _ = curve_of(kind, periodic=True)
    widths = [float(form_on(curve, 0.2, radius).remainder) for radius in (1e-2, 1e-3)]
    assert 0 < widths[1] < 0.11 * widths[0]


@pytest.mark.parametrize("kind", ["linear", "cubic"])
def test_the_end_of_a_table_belongs_to_its_last_piece(kind):
    curve, known = curve_of(kind, periodic=False)
    form = form_on(curve, 1.0, 1e-12)
    assert float(form.coefficients[0].mid()) == pytest.approx(float(known(1.0)), abs=1e-9)
