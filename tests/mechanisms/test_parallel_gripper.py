"""The parallel gripper against its closed form: two parallelograms, whose fingers move on arcs without turning.

M q'' = -2 r pull - 2 k (q - q0) - 2 d q' - 2 g (m_c c + m_f c + m L) sin q,   M = 2 (I_c + m_c c^2 + I_f + m_f c^2 + m L^2)
"""

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from tests.support.gripper import DAMPING, INERTIA, PULLEY, REST, STIFFNESS, WEIGHT
from tests.support.mechanism_checks import acceleration, plan_of
from tests.support.tolerances import ANGLE_RAD, KNEE, relative_error
from tests.support.tolerances_planner import CLOSURE_M, SECOND_ROUTE_DEG

NAME, PROBLEM = "parallel-gripper", "gripper-close"
# MuJoCo's integrator and soft loops against the closed form over 0.2 s [rad]: first order in a step of 1e-5 s.
SIMULATED_RAD = 1e-3


def torque(q: float, v: float, pull: float) -> float:
    """Return the generalised force about the right crank."""
    return -2 * PULLEY * pull - 2 * STIFFNESS * (q - REST) - 2 * DAMPING * v - WEIGHT * np.sin(q)


def gripper():
    return load_mechanism(NAME, independent=["right_crank"])


def test_two_four_bars_geared_together_leave_one_freedom():
    mechanism = gripper()
    assert (mechanism.n_q, mechanism.dof, len(mechanism.closure_rows)) == (6, 1, 5)
    assert mechanism.home_gap_m < CLOSURE_M


@pytest.mark.parametrize("q_deg", [-8.0, 0.0, 20.0, 45.0, 65.0])
def test_fingers_stay_upright_and_the_hand_is_a_mirror(q_deg):
    q = np.radians(q_deg)
    pose = close_at(gripper(), np.array([q]))
    assert np.abs(pose - q * np.array([1, -1, 1, -1, 1, -1])).max() < ANGLE_RAD


@pytest.mark.parametrize("q_deg", [-8.0, 0.0, 20.0, 45.0, 65.0])
def test_acceleration_is_the_closed_form(q_deg):
    mechanism, q, v, pull = gripper(), np.radians(q_deg), 3.0, 7.0
    found = acceleration(mechanism, close_at(mechanism, np.array([q])), np.array([v]), np.array([pull]))
    assert relative_error(found, [torque(q, v, pull) / INERTIA]) < KNEE


def test_the_cable_pulls_both_cranks_and_never_pushes():
    mechanism = gripper()
    (cable,) = mechanism.actuators
    assert (cable.name, cable.unit, cable.lower, cable.upper) == ("pull", "N", 0.0, 20.0)
    for q in (0.0, 0.8):
        found = np.array(mechanism.dynamics.effort_map(close_at(mechanism, np.array([q]))))
        assert relative_error(found, [[-2 * PULLEY]]) < KNEE


def test_mujoco_s_own_simulation_of_the_file_is_the_closed_form():
    """Released open under a steady pull of 4 N: springs, cable, gearing and both loops at work."""
    model = mujoco.MjModel.__copy__(gripper().model)
    model.opt.timestep = 1e-5
    data, q0, pull = mujoco.MjData(model), np.radians(45.0), 4.0
    data.qpos[:] = q0 * np.array([1, -1, 1, -1, 1, -1])
    data.ctrl[:] = pull
    mujoco.mj_step(model, data, 20_000)
    closed = solve_ivp(lambda _, x: [x[1], torque(x[0], x[1], pull) / INERTIA], (0, 0.2), [q0, 0.0], rtol=1e-10, atol=1e-12)
    assert abs(closed.y[0, -1] - q0) > 0.3, "it moves"
    assert np.abs(data.qpos - closed.y[0, -1] * np.array([1, -1, 1, -1, 1, -1])).max() < SIMULATED_RAD


@pytest.mark.slow
def test_the_closed_form_integrated_under_the_planned_pull_ends_closed():
    trajectory = plan_of(PROBLEM).trajectory
    x = np.array([np.radians(45.0), 0.0])
    for begin, end in zip(trajectory.breaks_s[:-1], trajectory.breaks_s[1:], strict=True):
        middle = np.nextafter(end, begin)

        def rate(t: float, x: np.ndarray, middle=middle) -> list[float]:
            return [x[1], torque(x[0], x[1], float(trajectory.effort_at(np.array([min(t, middle)]))[0, 0])) / INERTIA]

        x = solve_ivp(rate, (begin, end), x, rtol=1e-9, atol=1e-11).y[:, -1]
    assert abs(np.degrees(x[0])) < SECOND_ROUTE_DEG
