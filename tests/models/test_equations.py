"""The equations of a mechanism for arrays and as CasADi functions: they agree with one another and with MuJoCo."""

import casadi as ca
import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.models.errors import AssemblyError, ModelError, ProblemError
from tests.support.refusals import assert_refused

# Rounding of double precision, relative to values of about one.
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def knee():
    return linkplan.load_mechanism("optimus-knee", payload="shank")


@pytest.fixture(scope="module")
def poses(knee):
    """Return three closed poses (3, n_q) [rad]."""
    return np.stack([knee.equations.closed_pose(at_deg={"O": angle}) for angle in (-40.0, 0.0, 30.0)])


def test_a_closed_pose_has_the_angle_and_closed_loops(knee, poses):
    np.testing.assert_allclose(poses[:, 0], np.radians([-40.0, 0.0, 30.0]), atol=ROUNDING)
    assert np.abs(knee.equations.closure(poses)).max() < ROUNDING
    np.testing.assert_allclose(knee.equations.closed_pose(at_rad={"O": np.radians(30.0)}), poses[2], atol=ROUNDING)


def test_mass_and_bias_make_the_inverse_dynamics(knee, poses):
    of, v, a = knee.equations, np.array([[1.0], [-2.0], [0.5]]), np.array([[3.0], [0.0], [-40.0]])
    expected = (of.mass_matrix(poses) @ a[..., None])[..., 0] + of.bias(poses, v)
    np.testing.assert_allclose(of.inverse_dynamics(poses, v, a), expected, rtol=ROUNDING)


def test_forward_dynamics_undo_the_actuators_efforts(knee, poses):
    of, v, a = knee.equations, np.array([1.5]), np.array([[3.0], [0.0], [-40.0]])
    found = of.forward_dynamics(poses, v, of.actuator_efforts(poses, v, a))
    np.testing.assert_allclose(found, a, atol=1e-7)


def test_a_pose_out_of_reach_and_an_unknown_joint_are_refused(knee):
    assert_refused(lambda: knee.equations.closed_pose(at_deg={"O": 120.0}), "loop opens", kind=AssemblyError)
    assert_refused(lambda: knee.equations.closed_pose(at_deg={"A": 0.0}), "unknown independent joint 'A'", kind=ModelError)


def test_velocity_map_is_the_slope_of_closed_poses(knee):
    step = 1e-5
    after, before = (knee.equations.closed_pose(at_rad={"O": 0.2 + sign * step}) for sign in (1, -1))
    slope = (after - before) / (2 * step)
    np.testing.assert_allclose(
        knee.equations.velocity_map(knee.equations.closed_pose(at_rad={"O": 0.2}))[:, 0], slope, atol=1e-8
    )


def test_an_open_tree_has_mujocos_mass_matrix_and_bias():
    pole = linkplan.load_mechanism("cart-pole")
    q, v = np.array([0.3, 0.7]), np.array([0.5, -1.0])
    data = mujoco.MjData(pole.model)
    data.qpos[:], data.qvel[:] = pole.qpos_of(q), v
    mujoco.mj_forward(pole.model, data)
    mass = np.zeros((2, 2))
    mujoco.mj_fullM(pole.model, data, mass)
    np.testing.assert_allclose(pole.equations.mass_matrix(q), mass, atol=ROUNDING)
    np.testing.assert_allclose(pole.equations.bias(q, v), data.qfrc_bias - data.qfrc_passive, atol=1e-6)


def test_a_function_has_names_with_units_and_takes_symbols(knee, poses):
    function = knee.equations.function("inverse_dynamics")
    assert [function.name_in(k) for k in range(3)] == ["pose_rad", "velocity_rad_s", "acceleration_rad_s2"]
    x = ca.MX.sym("q", 3)
    value = ca.Function("f", [x], [function(x, 1.0, 2.0)])(poses[1])
    assert float(value) == pytest.approx(knee.equations.inverse_dynamics(poses[1], [1.0], [2.0])[0])
    assert_refused(lambda: knee.equations.function("inverse_dynamic"), "unknown equation", kind=ProblemError)


def test_leading_axes_broadcast_and_wrong_shapes_are_refused(knee, poses):
    assert knee.equations.bias(poses[:, None], np.ones((4, 1))).shape == (3, 4, 1)
    assert knee.equations.closure_force(poses, [0.0], [0.0], [0.0]).shape == (3, 3)
    assert knee.equations.mass_matrix(np.zeros((0, 3))).shape == (0, 1, 1)
    with pytest.raises(ProblemError, match=r"takes pose_rad of shape \(\.\.\., 3\), got \(2,\)"):
        knee.equations.mass_matrix([0.0, 0.0])


def test_a_mechanism_is_a_table_in_notebooks():
    text = linkplan.load_mechanism("five-bar")._repr_html_()
    assert "2 degrees of freedom" in text
    for part in ("O1", "act_O2", "E2", "-1.4 to 1.4 N.m"):
        assert part in text
