"""Tables that a motion follows: MuJoCo's inverse dynamics on the closed loop, least durations in closed form, proofs."""

import mujoco
import numpy as np
import pytest
import scipy

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.plan.folder import read_plan, write_plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import HINGE, HINGE_INERTIA, body_plan

PERIOD_S = 1.2
TIME_S = np.arange(24) / 24 * PERIOD_S
# The knee's rocker over a gait cycle, within its reach of -49.5 to 42.8 deg.
KNEE_DEG = -5 + 28 * np.sin(2 * np.pi * TIME_S / PERIOD_S) + 6 * np.sin(4 * np.pi * TIME_S / PERIOD_S + 0.5)
RISE = 'kind = "track"\n[reference]\ntime_s = [0.0, 1.0]\nposition_deg = { J = [0.0, 90.0] }\n'
EFFORT = 4.0  # [N.m] of the hinge's motor


def gait(**arguments) -> Problem:
    """Return the problem of the knee with its shank that follows 24 angles of its rocker C."""
    rows = {"time_s": TIME_S.tolist(), "position_deg": {"C": KNEE_DEG.tolist()}, "period_s": PERIOD_S}
    return Problem.track("optimus-knee", payload="shank", reference=rows, **arguments)


def closed_by_newton(model, data, angle: float) -> None:
    """Close the knee's loop in MuJoCo at an angle [rad] of C, by Newton's method on the distance of its two pins."""
    sites = [model.site(name).id for name in ("B_coupler", "B_rocker")]
    driven = model.joint("C").qposadr[0]
    others = [model.joint(name).qposadr[0] for name in ("O", "A")]
    data.qpos[driven] = angle
    for _ in range(30):
        mujoco.mj_kinematics(model, data)
        gap = (data.site_xpos[sites[0]] - data.site_xpos[sites[1]])[[0, 2]]
        data.qpos[others] -= np.linalg.solve(loop_jacobian(model, data)[:, others], gap)


def loop_jacobian(model, data) -> np.ndarray:
    """Return the Jacobian (2, n_v) of the distance of the loop's pins in its plane."""
    mujoco.mj_comPos(model, data)
    both = []
    for name in ("B_coupler", "B_rocker"):
        both.append(np.zeros((3, model.nv)))
        mujoco.mj_jacSite(model, data, both[-1], None, model.site(name).id)
    return (both[0] - both[1])[[0, 2]]


def torque_of_mujoco(model, data, angle: float, speed: float, acceleration: float) -> float:
    """Return the torque at O by MuJoCo's inverse dynamics of the open tree, projected on the loop's own null space."""
    closed_by_newton(model, data, angle)
    J, C = loop_jacobian(model, data), model.joint("C").dofadr[0]
    null = scipy.linalg.null_space(J)[:, 0]
    null /= null[C]  # rates of all joints for one of C
    data.qvel[:] = null * speed
    pose, step = data.qpos.copy(), 1e-6
    turned = []
    for sign in (1, -1):
        data.qpos[:] = pose + sign * step * data.qvel
        mujoco.mj_kinematics(model, data)
        turned.append(loop_jacobian(model, data))
    data.qpos[:] = pose
    J_dot = (turned[0] - turned[1]) / (2 * step)
    rows = np.vstack([J, np.eye(model.nv)[C]])
    data.qacc[:] = np.linalg.solve(rows, np.append(-J_dot @ data.qvel, acceleration))
    mujoco.mj_inverse(model, data)
    return float(null @ data.qfrc_inverse / null[model.joint("O").dofadr[0]])


def test_twenty_four_points_of_a_gait_need_the_torque_of_mujoco_s_inverse_dynamics():
    plan = plan_motion(gait())
    assert plan.status == "optimal", plan.message
    assert plan.trajectory.periodic
    assert plan.trajectory.duration_s == PERIOD_S
    rows = np.append(TIME_S, PERIOD_S)
    spline = scipy.interpolate.make_interp_spline(rows, np.radians(np.append(KNEE_DEG, KNEE_DEG[0])), bc_type="periodic")
    model = load_mechanism("optimus-knee", payload="shank").model
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    data = mujoco.MjData(model)
    data.qpos[:] = plan.problem.mechanism.qpos_of(plan.trajectory.start_pose)
    time = np.concatenate([TIME_S, TIME_S + 0.017])
    other = np.array([torque_of_mujoco(model, data, *(float(spline(t, order)) for order in range(3))) for t in time])
    planned = plan.trajectory.effort_at(time)[:, 0]
    assert np.ptp(other) > 5, "the torque changes over the cycle"
    np.testing.assert_allclose(planned, other, atol=1e-6 * np.abs(other).max())


def test_a_table_s_least_duration_is_that_of_its_largest_acceleration():
    """A cubic from rest to rest has its largest acceleration 6 d / T^2 at its ends."""
    plan = body_plan(HINGE, RISE.replace('"track"\n', '"track"\nduration_s = "free"\n'))
    least = np.sqrt(HINGE_INERTIA * 6 * np.radians(90) / EFFORT)
    assert plan.status == "optimal", plan.message
    assert plan.trajectory.duration_s == pytest.approx(least, rel=1e-6)
    assert plan.details["rate"] == pytest.approx(1 / least, rel=1e-6)
    assert "the limit on the effort of motor allows no more" in plan.message


@pytest.mark.parametrize(
    ("asked", "status", "words"),
    [
        ("min_duration_s = 2.0", "optimal", "the shortest that motion.min_duration_s allows"),
        ("max_duration_s = 0.5", "infeasible", "even in 0.5 s, on the reference the effort of motor comes to"),
    ],
)
def test_bounds_on_a_free_duration_of_a_table_are_kept(asked, status, words):
    plan = body_plan(HINGE, RISE.replace('"track"\n', f'"track"\nduration_s = "free"\n{asked}\n'))
    assert plan.status == status
    assert words in plan.message


@pytest.mark.parametrize(
    ("asked", "strength", "status", "words"),
    [
        ({"duration_s": "free"}, 20.0, "optimal", "the reference in 0.50000"),
        (
            {"duration_s": "free"},
            0.1,
            "infeasible",
            " s, in which all joints can follow the reference, the effort of F comes to",
        ),
        ({"duration_s": "free", "min_duration_s": 0.7}, 20.0, "infeasible", "needed on joint z at t = "),
        ({"duration_s": "free", "max_duration_s": 0.5}, 20.0, "optimal", "the reference in 0.5 s"),
        ({"duration_s": "free", "max_duration_s": 0.4}, 20.0, "infeasible", " of 0.4 s, nor in another allowed duration"),
        ({}, 20.0, "infeasible", "needed on joint z at t = "),
    ],
)
def test_a_joint_without_a_motor_follows_a_table_in_its_own_period_only(asked, strength, status, words):
    """A mass of 0.2 kg on a spring of 0.2 (4 pi)^2 N/m oscillates in 0.5 s; the table has a period of 1 s."""
    body = '<body pos="0 {0} 0"><joint name="{1}" type="slide" stiffness="{2}"/><geom size="0.05" mass="0.2"/></body>'
    text = (
        '<mujoco><option gravity="0 0 0"/><default><geom contype="0" conaffinity="0"/></default><worldbody>'
        f"{body.format(0, 'x', 0)}{body.format(1, 'z', 0.2 * (4 * np.pi) ** 2)}</worldbody><actuator>"
        f'<motor name="F" joint="x" ctrlrange="-{strength} {strength}"/></actuator></mujoco>'
    )
    time = np.linspace(0, 1, 201)
    wave = (0.1 * np.cos(2 * np.pi * np.mod(time, 1.0))).tolist()
    table = {"time_s": time.tolist(), "position_m": {"x": wave, "z": wave}}
    plan = plan_motion(Problem.track(load_mechanism(text), reference=table, **asked))
    assert plan.status == status, plan.message
    assert words in plan.message


def test_a_table_that_is_too_fast_is_answered_with_the_least_duration():
    plan = body_plan(HINGE, RISE.replace("1.0]", "0.5]"))
    assert plan.status == "infeasible"
    assert plan.details["least_duration_s"] == pytest.approx(np.sqrt(HINGE_INERTIA * 6 * np.radians(90) / EFFORT), rel=1e-6)
    assert 'motion.kind = "reach" plans the nearest motion' in plan.message


def test_a_broken_limit_on_acceleration_is_an_infeasible_reference():
    plan = body_plan(HINGE, RISE, "limits.acceleration_deg_s2.J=400")
    assert plan.status == "infeasible"
    assert plan.details["least_duration_s"] == pytest.approx(np.sqrt(6 * 90 / 400), rel=1e-6)


def test_the_nearest_motion_to_a_table_is_that_of_an_independent_least_squares_problem():
    plan = body_plan(HINGE, RISE.replace("1.0]", "0.7]").replace("track", "reach"))
    assert plan.status == "optimal", plan.message
    n, T = 120, 0.7
    h = T / n
    k = np.arange(1, n + 1)
    speed = h * np.tril(np.ones((n, n)))
    place = h * h * np.tril(k[:, None] - k + 0.5)
    t = k * h / T
    wanted = np.radians(90) * (3 * t**2 - 2 * t**3)
    ends = 1e4 * np.vstack([place[-1], speed[-1]])
    most = EFFORT / HINGE_INERTIA
    found = scipy.optimize.lsq_linear(
        np.vstack([place, ends]),
        np.append(wanted, [1e4 * np.radians(90), 0.0]),
        bounds=(-most, most),
        method="bvls",
        tol=1e-14,
    )
    rms = np.degrees(np.sqrt(np.mean((place @ found.x - wanted) ** 2)))
    assert rms > 0.1, "the effort limit binds"
    assert plan.details["tracking_rms_deg"] == pytest.approx(rms, rel=1e-4)


def test_a_followed_table_is_proved_and_a_motion_beside_it_refuted():
    plan = plan_motion(gait(duration_s="free"))
    proof = prove(plan.problem, plan.trajectory, existence=False)
    (finding,) = [one for one in proof.findings if one.name == "distance of C from its reference"]
    assert finding.answer == "proved"
    other = gait()
    (finding,) = [one for one in prove(other, plan.trajectory).findings if one.name == finding.name]
    assert finding.answer == "refuted", "at another speed it is another motion"


def test_a_saved_motion_at_the_highest_speed_is_read_back_as_the_one_asked_for(tmp_path):
    plan = plan_motion(gait(duration_s="free"))
    (tmp_path / "gait").mkdir()
    write_plan(plan, tmp_path / "gait")
    again = read_plan(tmp_path / "gait")
    assert again.status == "optimal", again.message
    assert again.trajectory.duration_s == plan.trajectory.duration_s < 0.5 * PERIOD_S
    np.testing.assert_array_equal(again.problem.reference.knots_s, plan.problem.reference.knots_s)
