"""Efforts, speeds and gains across a transmission, against their definitions."""

import numpy as np

from linkplan.models.transfer.polytope import effort_box, effort_corners, joint_gains, motor_gains, speed_alone, speed_box

G = np.array([[[0.9, 0.7], [1.1, -0.6]], [[1.2, 0.5], [0.8, -0.9]]])
LIMIT = np.array([[-40.0, 30.0], [-20.0, 25.0]])


def test_every_effort_of_the_motors_lies_in_the_box_and_the_box_is_touched():
    u = np.random.default_rng(0).uniform(LIMIT[:, 0], LIMIT[:, 1], (500, 2))
    box = effort_box(G, LIMIT)
    for ratio, (low, high), corners in zip(G, box.transpose(0, 2, 1), effort_corners(G, LIMIT), strict=True):
        effort = u @ ratio
        assert np.all((effort >= low) & (effort <= high))
        np.testing.assert_allclose(corners.min(axis=0), low)
        np.testing.assert_allclose(corners.max(axis=0), high)


def test_a_motor_without_limits_leaves_joints_without_an_arm_alone():
    box = effort_box(np.array([[[1.0, 0.0]]]), np.array([[-np.inf, np.inf]]))
    np.testing.assert_array_equal(box[0], [[-np.inf, np.inf], [0.0, 0.0]])


def test_speeds_are_those_at_which_the_first_motor_reaches_its_own():
    speed = np.array([10.0, 8.0])
    alone, box = speed_alone(G, speed), speed_box(G, speed)
    for k in range(2):
        np.testing.assert_allclose(np.max(np.abs(G[:, :, k]) * alone[:, k, None] / speed, axis=1), 1.0)
    corners = np.array([[a, b] for a in (-10.0, 10.0) for b in (-8.0, 8.0)])
    reached = np.array([np.linalg.solve(ratio, corners.T).T for ratio in G])
    np.testing.assert_allclose(box, np.abs(reached).max(axis=1))


def test_gains_of_motors_and_joints_carry_the_same_stiffness_there_and_back():
    wanted = np.diag([100.0, 60.0])
    at_motors = motor_gains(G, wanted)
    assert np.abs(at_motors[0][0, 1]) > 1  # a stiffness of each joint alone couples the motors
    for ratio, gain, back in zip(G, at_motors, joint_gains(G, at_motors[0]), strict=True):
        np.testing.assert_allclose(ratio.T @ gain @ ratio, wanted, atol=1e-10)
        np.testing.assert_allclose(back, ratio.T @ at_motors[0] @ ratio, atol=1e-10)


def test_at_a_dead_centre_no_gains_are_given():
    assert np.isnan(motor_gains(np.array([[[0.0]]]), np.eye(1))).all()
