"""The five-bar against its closed form, from the published lengths and masses (Bordalba, Ros and Porta, T-RO 2022).

Elbows E_i = O_i + L e(th_i); the pin P is where the circles about them meet, below the line E1-E2; its velocity follows
from |P - E_i| = l. M(th) and V(th) are the bodies' energies, the equations of motion Lagrange's.
"""

import numpy as np
import pytest

from linkplan.models.poses.assembly import follow
from tests.support.fourbar import G
from tests.support.mechanism_checks import acceleration, lagrangian_acceleration, mechanism_of, rigid_acceleration
from tests.support.mechanisms import derivative
from tests.support.tolerances import ANGLE_RAD, DIFFERENCES, HELD_NM, relative_error

NAME = "five-bar"
BASE, PROXIMAL, DISTAL = np.array([[0.0, 0.0], [0.12, 0.0]]), 0.20, 0.15
PROXIMAL_MASS, PROXIMAL_CENTRE, PROXIMAL_MOMENT = 1.2093, 0.11, 7e-3
DISTAL_MASS, DISTAL_CENTRE, DISTAL_MOMENT = 0.8925, 0.0746, 2.3e-3
LOAD, DAMPING, TORQUE = 0.5, 0.0176, 1.4
# The load's own moment in the model [kg m2], which stands for none, moves with a distal link: relative to that link's.
NO_MOMENT = 1e-6
POSES_DEG = [(-90.0, -90.0), (-120.0, -70.0), (-60.0, -100.0), (-150.0, -140.0), (10.0, -20.0), (90.0, 90.0), (60.0, 130.0)]
at_every_pose = pytest.mark.parametrize("th", [np.radians(p) for p in POSES_DEG], ids=lambda th: str(np.degrees(th).round()))


def cross(a: np.ndarray, b: np.ndarray) -> float:
    """Return the plane's cross product."""
    return float(a[0] * b[1] - a[1] * b[0])


def points(th: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the elbows (2, 2) and the pin (2,), below the line from E1 to E2."""
    elbows = BASE + PROXIMAL * np.column_stack([np.cos(th), np.sin(th)])
    way = elbows[1] - elbows[0]
    across = np.array([way[1], -way[0]]) / np.linalg.norm(way)
    return elbows, elbows.mean(axis=0) + np.sqrt(DISTAL**2 - way @ way / 4) * across


def rates(th: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return d(elbow i)/d(th_j) (2, 2, 2), d(pin)/d(th_j) (2, 2) and the distal links' rates per th_j (2, 2)."""
    elbows, pin = points(th)
    moving = np.zeros((2, 2, 2))
    for i in range(2):
        moving[i, :, i] = PROXIMAL * np.array([-np.sin(th[i]), np.cos(th[i])])
    arms = pin - elbows
    by_pin = np.linalg.solve(arms, np.array([arms[i] @ moving[i] for i in range(2)]))
    turning = np.array([[cross(arms[i], by_pin[:, j] - moving[i, :, j]) for j in range(2)] for i in range(2)]) / DISTAL**2
    return moving, by_pin, turning


def inertia(th: np.ndarray) -> np.ndarray:
    """Return the reduced inertia (2, 2)."""
    moving, pin, turning = rates(th)
    M = (PROXIMAL_MOMENT + PROXIMAL_MASS * PROXIMAL_CENTRE**2) * np.eye(2) + LOAD * pin.T @ pin
    share = DISTAL_CENTRE / DISTAL
    for i in range(2):
        centre = moving[i] + share * (pin - moving[i])
        M += DISTAL_MASS * centre.T @ centre + DISTAL_MOMENT * np.outer(turning[i], turning[i])
    return M


def potential(th: np.ndarray) -> float:
    """Return the potential energy."""
    elbows, pin = points(th)
    share = DISTAL_CENTRE / DISTAL
    proximal = PROXIMAL_MASS * PROXIMAL_CENTRE * np.sin(th).sum()
    distal = DISTAL_MASS * ((1 - share) * elbows[:, 1] + share * pin[1]).sum()
    return float(G * (proximal + distal + LOAD * pin[1]))


def slope(th: np.ndarray) -> np.ndarray:
    """Return dV/dth (2,), the torques that hold the weight."""
    return np.array([derivative(lambda h, k=k: potential(th + h * np.eye(2)[k]), 1e-3) for k in range(2)])


def pose(th: np.ndarray) -> np.ndarray:
    """Return the closed pose, reached by turning both motors together first, which keeps the linkage's shape."""
    return follow(mechanism_of(NAME), np.array([[th.mean(), th.mean()], th]))[1]


@at_every_pose
def test_elbow_and_pin_angles_follow_the_motors_as_the_closed_form_says(th):
    elbows, pin = points(th)
    arms = pin - elbows
    elbow = np.arctan2(arms[0, 1], arms[0, 0]) - th[0]
    apex = np.arccos(arms[0] @ arms[1] / DISTAL**2)
    q = pose(th)
    assert abs(np.angle(np.exp(1j * (q[1] - elbow)))) < ANGLE_RAD
    assert abs(q[2] - apex) < 100 * ANGLE_RAD  # the arc cosine of a shallow angle
    assert np.abs(q[[0, 3]] - th).max() == 0.0


@at_every_pose
def test_reduced_inertia_is_the_closed_form(th):
    assert relative_error(np.array(mechanism_of(NAME).dynamics.reduced_inertia(pose(th))), inertia(th)) < NO_MOMENT


@at_every_pose
def test_the_torques_that_hold_the_weight_are_the_potential_s_slope(th):
    found = np.array(mechanism_of(NAME).dynamics.gravity_effort(pose(th))).ravel()
    assert np.abs(found - slope(th)).max() < DIFFERENCES * G * PROXIMAL


@at_every_pose
def test_acceleration_is_lagrange_s_with_the_motors_damping_and_that_of_mujocos_masses_forces_and_rows(th):
    mechanism, v, u = mechanism_of(NAME), np.array([6.0, -4.0]), np.array([1.1, -0.7])
    found = acceleration(mechanism, pose(th), v, u)
    assert relative_error(found, lagrangian_acceleration(inertia, potential, th, v, u - DAMPING * v)) < NO_MOMENT
    assert relative_error(found, rigid_acceleration(mechanism, pose(th), v, u)) < DIFFERENCES


def test_the_motors_hold_both_ends_of_the_swing_up_and_cannot_hold_what_lies_between():
    for end in (-90.0, 90.0):
        assert np.abs(slope(np.radians([end, end]))).max() < TORQUE
    between = np.abs([slope(np.radians([a, a])) for a in np.linspace(-45.0, 45.0, 19)])
    assert between.min() > 1.3 * TORQUE
    assert between.max() == pytest.approx(3.6, abs=HELD_NM)
