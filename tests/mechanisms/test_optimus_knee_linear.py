"""The knee driven by a linear actuator between D and B, against the four-bar's closed form and the same knee driven at O.

With l(q_O) = |DB| from the closed form, virtual work gives F l' = tau, and the kinetic and potential energies of barrel and
rod, rigid bodies on the line from D to B, are written out here.
"""

import numpy as np
import pytest

from linkplan.models.library import built_in_text
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.poses.reach import reach
from tests.support.drive import line, line_rates
from tests.support.fourbar import SHANK, FourBar, G, knee
from tests.support.mechanism_checks import mechanism_of
from tests.support.mechanisms import derivative, replaced
from tests.support.tolerances import (
    ANGLE_RAD,
    BRACKET_RAD,
    DIFFERENCES,
    KNEE,
    PRINTED_DEG,
    PRINTED_M,
    PRINTED_N,
    relative_error,
)
from tests.support.tolerances_planner import CLOSURE_M

NAME, PROBLEM = "optimus-knee-linear", "knee-linear-reach"
BENT, STRAIGHT = np.radians([-49.07, 56.27])
# Barrel and rod as cylinders [kg, m], and what of rotor and screw is felt along the slide [kg].
BARREL = {"mass": 0.75, "length": 0.165, "radius": 0.02}
ROD = {"mass": 0.15, "length": 0.15, "radius": 0.006}
ARMATURE = 3.95
DEAD_CENTRE_DEG = 61.43327954622908
at_every_angle = pytest.mark.parametrize("q_O", np.radians([-75.0, -49.07, -20.0, 0.0, 25.0, 45.0, 56.27]))


def cylinder_moment(part: dict[str, float]) -> float:
    """Return a cylinder's moment of inertia across its axis about its middle."""
    return part["mass"] * (3 * part["radius"] ** 2 + part["length"] ** 2) / 12


def drive_inertia(fourbar: FourBar, q_O: float) -> float:
    """Return what barrel, rod and armature add to the reduced inertia about O."""
    length, _ = line(fourbar, q_O)
    out, turn = line_rates(fourbar, q_O)
    barrel = (cylinder_moment(BARREL) + BARREL["mass"] * (BARREL["length"] / 2) ** 2) * turn**2
    middle = length - ROD["length"] / 2
    rod = cylinder_moment(ROD) * turn**2 + ROD["mass"] * (out**2 + (middle * turn) ** 2)
    return barrel + rod + ARMATURE * out**2


def drive_potential(fourbar: FourBar, q_O: float) -> float:
    """Return the potential energy of barrel and rod."""
    length, angle = line(fourbar, q_O)
    return G * np.cos(angle) * (BARREL["mass"] * BARREL["length"] / 2 + ROD["mass"] * (length - ROD["length"] / 2))


def pose(q_O: float, payload: str | None = None) -> np.ndarray:
    """Return the linear knee's closed pose at a knee angle."""
    return close_at(mechanism_of(NAME, payload), np.array([line(knee(), q_O)[0]]))


def test_two_loops_on_one_pin_leave_one_freedom_the_slide():
    mechanism = mechanism_of(NAME)
    assert (mechanism.n_q, mechanism.dof, len(mechanism.closure_rows)) == (5, 1, 4)
    assert [joint.name for joint in mechanism.independent_joints] == ["DB"]
    assert mechanism.home_gap_m < CLOSURE_M


@at_every_angle
def test_all_joints_follow_from_the_slide_as_the_closed_form_says(q_O):
    crank, coupler, rocker = knee().angles(np.array([q_O]))[:, 0]
    length, angle = line(knee(), q_O)
    # 1 mm of slide is as little as 1 deg of knee near straight: the loop's rounding grows by the ratio.
    assert np.abs(pose(q_O) - [crank, coupler - crank, rocker, angle, length]).max() < 100 * ANGLE_RAD


def sweep(fourbar: FourBar, step: float) -> tuple[np.ndarray, ...]:
    """Return knee angles, speeds and accelerations (n,) of a sweep, and the slide's from the closed form."""
    time = np.linspace(0.0, 0.4, 81)
    rate, middle, half = 2 * np.pi / 0.4, 0.5 * (BENT + STRAIGHT), 0.49 * (STRAIGHT - BENT)
    q_O = middle + half * np.sin(rate * time)
    v_O, a_O = half * rate * np.cos(rate * time), -half * rate**2 * np.sin(rate * time)
    length = np.array([line(fourbar, q)[0] for q in q_O])
    ratio = np.array([line_rates(fourbar, q)[0] for q in q_O])
    ratio_rate = np.array([derivative(lambda h, q=q: line_rates(fourbar, q + h)[0], step) for q in q_O])
    return q_O, v_O, a_O, length, ratio * v_O, ratio * a_O + ratio_rate * v_O**2


def test_force_times_slide_speed_is_torque_times_knee_speed_along_a_sweep():
    """The same bodies, moved alike once by a motor on O and once by the slide: F l' = tau q_O'."""
    motor = '<motor name="act_B_to_D" joint="DB" ctrlrange="-2000 2000"/>'
    at_O = load_mechanism(replaced(built_in_text(NAME), motor, '<motor name="act_B_to_D" joint="O"/>'), payload="shank")
    linear = mechanism_of(NAME, "shank")
    q_O, v_O, a_O, length, speed, acceleration_DB = sweep(knee(), 2e-4)
    by_crank = follow(at_O, q_O[:, None])
    by_slide = follow(linear, length[:, None], by_crank[0])
    assert np.abs(by_slide - by_crank).max() < 100 * ANGLE_RAD
    tau = needed_effort(at_O, by_crank, v_O[:, None], a_O[:, None])[0][:, 0]
    force = needed_effort(linear, by_slide, speed[:, None], acceleration_DB[:, None])[0][:, 0]
    assert np.abs(tau * v_O).max() > 100.0, "the sweep takes a hundred watts and more"
    assert relative_error(force * speed, tau * v_O) < KNEE


def test_the_torque_of_the_same_sweep_is_the_driven_knee_s_and_the_drive_s_own():
    """Against the knee driven at O, which knows nothing of the drive, and the drive's share from its energies."""
    driven, linear, fourbar, step = mechanism_of("optimus-knee", "shank"), mechanism_of(NAME, "shank"), knee(), 1e-3
    q_O, v_O, a_O, length, speed, acceleration_DB = sweep(fourbar, step)
    tau = needed_effort(driven, follow(driven, q_O[:, None]), v_O[:, None], a_O[:, None])[0][:, 0]
    inertia = np.array([drive_inertia(fourbar, q) for q in q_O])
    inertia_rate = np.array([derivative(lambda h, q=q: drive_inertia(fourbar, q + h), step) for q in q_O])
    weight = np.array([derivative(lambda h, q=q: drive_potential(fourbar, q + h), step) for q in q_O])
    tau_drive = inertia * a_O + 0.5 * inertia_rate * v_O**2 + weight
    assert np.abs(tau_drive).max() > 1.0, "the drive's own masses are felt"
    poses = follow(linear, length[:, None], pose(q_O[0], "shank"))
    force = needed_effort(linear, poses, speed[:, None], acceleration_DB[:, None])[0][:, 0]
    assert relative_error(force * speed, (tau + tau_drive) * v_O) < DIFFERENCES


@at_every_angle
@pytest.mark.parametrize("payload", [None, "shank"])
def test_reduced_inertia_is_the_driven_knee_s_and_the_drive_s_over_the_ratio_squared(q_O, payload):
    fourbar = knee() if payload is None else knee().carrying("crank", SHANK)
    expected = (float(fourbar.inertia(np.array([q_O]))[0]) + drive_inertia(fourbar, q_O)) / line_rates(fourbar, q_O)[0] ** 2
    found = float(mechanism_of(NAME, payload).dynamics.reduced_inertia(pose(q_O, payload)))
    assert relative_error(found, expected) < 100 * KNEE


@at_every_angle
@pytest.mark.parametrize("payload", [None, "shank"])
def test_the_force_that_holds_the_weight_is_the_potential_s_slope_along_the_slide(q_O, payload):
    fourbar = knee() if payload is None else knee().carrying("crank", SHANK)

    def potential(h: float) -> float:
        return float(fourbar.potential(np.array([q_O + h]))[0]) + drive_potential(fourbar, q_O + h)

    expected = derivative(potential, 1e-3) / line_rates(fourbar, q_O)[0]
    found = float(mechanism_of(NAME, payload).dynamics.gravity_effort(pose(q_O, payload)))
    assert relative_error(found, expected) < DIFFERENCES


def test_the_slide_stops_short_of_the_dead_centre_where_it_no_longer_moves_the_knee():
    mechanism = mechanism_of(NAME)
    can = reach(mechanism)
    assert (can.lower.reason, can.upper.reason) == ("range of DB", "range of DB")
    assert abs(can.lower.position - 0.1815) < BRACKET_RAD
    assert np.degrees(can.poses[0, 0]) == pytest.approx(58.08, abs=PRINTED_DEG)
    assert line(knee(), np.radians(DEAD_CENTRE_DEG))[0] == pytest.approx(0.181059, abs=PRINTED_M)
    assert abs(line_rates(knee(), np.radians(DEAD_CENTRE_DEG))[0]) < KNEE


def test_the_force_limit_does_the_work_of_100_newton_metres_over_the_swing():
    stroke = line(knee(), BENT)[0] - line(knee(), STRAIGHT)[0]
    force = 100.0 * (STRAIGHT - BENT) / stroke
    assert force == pytest.approx(1950, abs=PRINTED_N)
    (actuator,) = mechanism_of(NAME).actuators
    assert (actuator.name, actuator.unit, actuator.lower, actuator.upper) == ("act_B_to_D", "N", -2000.0, 2000.0)
    assert 1.0 < actuator.upper / force < 1.05
