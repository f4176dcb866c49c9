"""Transfer between motors and joints against closed forms, and the polytope of efforts."""

import functools

import mujoco
import numpy as np
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.transfer.output_map import OutputMap, output_map, transmission
from linkplan.models.transfer.polytope import effort_box, effort_corners, joint_gains, motor_gains, speed_alone, speed_box
from tests.support import parallel_ankle, slider_crank
from tests.support.data import KNEE_TABLE
from tests.support.tolerances import KNEE, relative_error

# Motor power against joint power, relative to the largest: rounding of MuJoCo's actuator velocity. Measured 2e-15.
POWER_BALANCE = 1e-12
OUTPUTS = ["ankle_pitch", "ankle_roll"]
rng = np.random.default_rng(29)
ANKLE_POSES = np.column_stack([rng.uniform(-0.7, 0.5, 40), rng.uniform(-0.35, 0.35, 40)])


@functools.cache
def ankle() -> OutputMap:
    return output_map(load_mechanism(parallel_ankle.ankle_text(), independent=OUTPUTS), OUTPUTS)


@functools.cache
def crank_slider() -> OutputMap:
    """Return the slider-crank with its slide as the output."""
    return output_map(load_mechanism("slider-crank", home={"O": 1.0}, independent=["B"]), ["B"])


@functools.cache
def knee() -> OutputMap:
    return output_map(load_mechanism("optimus-knee", independent=["C"]), ["C"])


def poses(outputs: OutputMap, s: np.ndarray) -> np.ndarray:
    return np.array([follow(outputs.mechanism, outputs.independent(x[None]))[0] for x in s])


def test_the_ankle_s_motors_and_rates_are_the_closed_form_s():
    found = transmission(ankle(), poses(ankle(), ANKLE_POSES))
    angles = [[parallel_ankle.motor_angle(side, *s) for side in range(2)] for s in ANKLE_POSES]
    assert np.ptp(angles) > 1.0
    assert np.abs(found.motor_position - angles).max() < 1e-9
    assert relative_error(found.ratio, [parallel_ankle.ratio(*s) for s in ANKLE_POSES]) < 1e-9


def test_the_ankle_s_slopes_are_the_differences_of_the_closed_form():
    found, step = transmission(ankle(), poses(ankle(), ANKLE_POSES)).ratio_slope, 1e-3
    for k, way in enumerate(np.eye(2)):
        at = [np.array([parallel_ankle.ratio(*(s + n * step * way)) for s in ANKLE_POSES]) for n in (-2, -1, 1, 2)]
        slope = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * step)  # exact to the fourth order
        assert relative_error(found[..., k], slope) < 1e-8


def test_armature_damping_and_friction_are_carried_by_the_closed_form():
    found = transmission(ankle(), poses(ankle(), ANKLE_POSES))
    G = np.array([parallel_ankle.ratio(*s) for s in ANKLE_POSES])
    squared = np.einsum("nmi,nmj->nij", G, G)
    assert relative_error(found.armature, parallel_ankle.ARMATURE * squared) < 1e-9
    assert relative_error(found.damping, parallel_ankle.DAMPING * squared) < 1e-9
    assert relative_error(found.friction, parallel_ankle.FRICTION * np.abs(G).sum(axis=1)) < 1e-9


def test_the_slider_s_crank_angle_rate_and_inertia_are_the_closed_form_s():
    angles = np.radians([15.0, 40.0, 80.0, 120.0, 165.0])
    places = np.array([slider_crank.slider(th) for th in angles])
    found = transmission(crank_slider(), poses(crank_slider(), places[:, :1]))
    assert np.abs(found.motor_position[:, 0] - angles).max() < 1e-9
    assert relative_error(found.ratio[:, 0, 0], 1 / places[:, 1]) < 1e-9
    inertia = [slider_crank.inertia(np.array([th]))[0, 0] for th in angles] / places[:, 1] ** 2
    assert relative_error(found.inertia[:, 0, 0], inertia) < 1e-9


def test_the_knee_s_map_is_the_table_worked_out_apart_from_this_project():
    # at the toggle of the output (54.5 deg) the map ends: rows beyond it lie on the other side
    rows = [row for row in KNEE_TABLE["configurations"] if -50 < row["q_O_deg"] < 51]
    assert len(rows) > 5
    found = transmission(knee(), poses(knee(), np.radians([[row["q_C_deg"]] for row in rows])))
    rate = np.array([row["dqC_dqO"] for row in rows])
    assert np.abs(np.degrees(found.motor_position[:, 0]) - [row["q_O_deg"] for row in rows]).max() < 1e-7
    assert relative_error(found.ratio[:, 0, 0], 1 / rate) < KNEE
    assert relative_error(found.inertia[:, 0, 0], [row["reduced_inertia_kgm2"] for row in rows] / rate**2) < KNEE
    assert relative_error(found.gravity[:, 0], [row["gravity_torque_Nm"] for row in rows] / rate) < KNEE


@pytest.mark.parametrize("of", [ankle, crank_slider, knee], ids=lambda of: of.__name__)
def test_motor_power_is_joint_power_along_random_motions(of):
    outputs = of()
    mechanism, n_o = outputs.mechanism, len(outputs.columns)
    random = np.random.default_rng(7)
    home = mechanism.home[mechanism.independent[list(outputs.columns)]]
    scale = 0.15 * (0.02 if outputs is crank_slider() else 1.0)
    s = home + scale * random.uniform(-1, 1, (20, n_o))
    q, v = poses(outputs, s), random.normal(size=(20, n_o))
    G = transmission(outputs, q).ratio
    effort = random.normal(size=(20, len(outputs.motors)))
    joint_power = np.einsum("nmo,nm,no->n", G, effort, v)
    motor_power = np.zeros(20)
    data = mujoco.MjData(mechanism.model)
    for k in range(20):  # MuJoCo's own actuator velocity, at joint rates that keep the closure by its own Jacobian
        data.qpos[:] = mechanism.qpos_of(q[k])
        data.qvel[:] = closed_rates(outputs, q[k], v[k])
        mujoco.mj_forward(mechanism.model, data)
        motor_power[k] = effort[k] @ data.actuator_velocity[list(outputs.motors)]
    assert np.abs(joint_power).max() > 0.1
    assert relative_error(joint_power, motor_power) < POWER_BALANCE


def closed_rates(outputs: OutputMap, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the joint rates (n_q,) with output rates v, others from the closure's null space by least squares."""
    mechanism = outputs.mechanism
    columns = mechanism.independent[list(outputs.columns)]
    J = np.array(mechanism.dynamics.closure_jacobian(q))
    chosen = np.zeros((len(columns), mechanism.n_q))
    chosen[np.arange(len(columns)), columns] = 1.0
    right = np.concatenate([np.zeros(len(J)), v])
    return np.linalg.lstsq(np.vstack([J, chosen]), right, rcond=1e-14)[0]


def test_outputs_that_are_no_coordinates_or_that_nothing_drives_are_refused():
    with pytest.raises(ModelError, match="not an independent coordinate; those are C"):
        output_map(knee().mechanism, ["O"])
    undriven = load_mechanism("cart-pole")
    pole = [joint.name for joint in undriven.joints if joint.kind == "hinge"]
    with pytest.raises(ModelError, match="nothing to transfer"):
        output_map(undriven, pole)


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
